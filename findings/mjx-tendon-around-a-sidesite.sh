#!/bin/sh
# mujoco==4.0.0, mujoco-mjx==3.17.0, jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Python 3.11, seen 2026-11-28.
# A tendon from one site to another around a sphere, with a sidesite outside the sphere on the far side: MuJoCo 4.0 leads it around the sphere on the
# side of that site; MJX 3.17 takes the straight line. Where the site is on the near side both take the straight line. Both accept the model
# without a warning.
# Seen: MuJoCo 1.6278 m (far side), 1.2369 (near side); MJX 1.2369 in both. Fails if any changes.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==4.0.0 mujoco-mjx==3.17.0 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > tendon.py <<'PY'
import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)
XML = """<mujoco><worldbody><geom name="ball" size=".3" contype="0" conaffinity="0"/>
<site name="from" pos="0.5 -0.3 0.1"/><site name="side" pos="{}"/>
<body pos="-0.5 0.4 0.3"><joint type="slide"/><geom size=".01" mass="1" contype="0" conaffinity="0"/><site name="to"/></body></worldbody>
<tendon><spatial><site site="from"/><geom geom="ball" sidesite="side"/><site site="to"/></spatial></tendon></mujoco>"""
for side, expected in (("-0.3 0.5 -0.5", (1.6278, 1.2369)), ("0.3 -0.5 0.5", (1.2369, 1.2369))):
    model = mujoco.MjModel.from_xml_string(XML.format(side))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    on_device = mjx.put_model(model)
    by_mjx = jax.jit(mjx.forward)(on_device, mjx.make_data(on_device)).ten_length
    print("side", side, "MuJoCo", data.ten_length, "MJX", by_mjx)
    assert np.allclose([data.ten_length[0], by_mjx[0]], expected, atol=1e-4)
PY
venv/bin/python tendon.py

#!/bin/sh
# mujoco==4.0.0, mujoco-mjx==3.17.0, jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Python 3.11, seen 2026-11-28.
# A tendon around a sphere, with a sidesite outside of the sphere: MuJoCo 4.0 leads it around the sphere on the site's side, whichever body the site belongs to.
# MJX 3.17 does so if the site's position in the frame of its own body is as far out; with the same place reached by the body's position instead, it takes
# the site to be inside of the sphere, and the tendon goes straight. Both accept the model without a warning.
# Seen with the site at (-0.3 0.5 -0.5): MuJoCo 1.6278 m; MJX 1.2369 (by the body's position), 1.6278 (by the site's). Fails if any changes.
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
<site name="from" pos="0.5 -0.3 0.1"/><site name="to" pos="-0.5 0.4 0.3"/>
<body pos="{}"><joint type="slide"/><geom size=".01" mass="1" contype="0" conaffinity="0"/><site name="side" pos="{}"/></body></worldbody>
<tendon><spatial><site site="from"/><geom geom="ball" sidesite="side"/><site site="to"/></spatial></tendon></mujoco>"""
PLACE, ORIGIN = "-0.3 0.5 -0.5", "0 0 0"
for body, site, expected in ((PLACE, ORIGIN, 1.2369), (ORIGIN, PLACE, 1.6278)):
    model = mujoco.MjModel.from_xml_string(XML.format(body, site))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    on_device = mjx.put_model(model)
    by_mjx = jax.jit(mjx.forward)(on_device, mjx.make_data(on_device)).ten_length
    print("body at", body, "site at", site, "MuJoCo", data.ten_length, "MJX", by_mjx)
    assert np.allclose(data.ten_length, 1.6278, atol=1e-4) and np.allclose(by_mjx, expected, atol=1e-4)
PY
venv/bin/python tendon.py

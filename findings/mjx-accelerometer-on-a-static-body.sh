#!/bin/sh
# mujoco==4.0.0, mujoco-mjx==3.17.0, jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Python 3.11, seen 2026-11-27.
# An accelerometer at rest measures gravity's reaction, 9.81 m/s2 upwards. For a site on a body without joints (a sensor mast fixed to the world, say) MuJoCo 4.0 says
# so; MJX 3.17 says 0. Both accept the model without a warning.
# Seen: MuJoCo [0 0 9.81], MJX [0 0 0]. Fails if either changes.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==4.0.0 mujoco-mjx==3.17.0 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > rest.py <<'PY'
import jax
import mujoco
import numpy as np
from mujoco import mjx

XML = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body pos="0 0 1"><geom size=".1" contype="0" conaffinity="0"/><site name="mast"/></body>
<body pos="2 0 1"><joint type="slide" axis="1 0 0"/><geom size=".1" contype="0" conaffinity="0"/></body>
</worldbody><sensor><accelerometer site="mast"/></sensor></mujoco>"""
model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
on_device = mjx.put_model(model)
by_mjx = np.asarray(jax.jit(mjx.forward)(on_device, mjx.make_data(on_device)).sensordata)
print("MuJoCo", data.sensordata, "MJX", by_mjx)
assert np.allclose(data.sensordata, [0, 0, 9.81]) and np.allclose(by_mjx, 0)
PY
venv/bin/python rest.py

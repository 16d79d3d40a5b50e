#!/bin/sh
# mujoco==4.0.0, mujoco-mjx==3.17.0, jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Python 3.11, seen 2026-11-28.
# A slider on a spring that yields at 0.02 m (springyield, new in MuJoCo 4.0), pulled out by 0.1 m and let go: MuJoCo 4.0 leaves it 0.08 m out, as a spring that
# was bent for good; MJX 3.17 lets it return to 0, as an elastic one. Both accept the model without a warning.
# Seen after 3 s: MuJoCo 0.07996, MJX -1e-13. Fails if either changes.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==4.0.0 mujoco-mjx==3.17.0 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > spring.py <<'PY'
import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)
XML = """<mujoco><option gravity="0 0 0" timestep="0.002"/><worldbody><body>
<joint type="slide" axis="1 0 0" stiffness="100" damping="20" springyield="0.02"/><geom size=".1" mass="1" contype="0" conaffinity="0"/>
</body></worldbody></mujoco>"""
model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
data.qpos[:] = 0.1
on_device = mjx.put_model(model)
by_mjx = mjx.make_data(on_device).replace(qpos=np.array([0.1]))
advance = jax.jit(mjx.step)
for _ in range(1500):
    mujoco.mj_step(model, data)
    by_mjx = advance(on_device, by_mjx)
print("MuJoCo", data.qpos, "MJX", by_mjx.qpos)
assert np.allclose(data.qpos, 0.08, atol=1e-3) and np.allclose(by_mjx.qpos, 0, atol=1e-6)
PY
venv/bin/python spring.py

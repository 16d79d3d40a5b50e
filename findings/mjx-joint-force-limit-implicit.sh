#!/bin/sh
# mujoco==4.0.0, mujoco-mjx==3.17.0, jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Python 3.11, seen 2026-11-28.
# A slider of 1 kg, driven by a velocity servo whose force on the joint is limited to 1 N (actuatorfrcrange), integrator implicitfast. At its limit
# the force does not depend on the velocity any more: MuJoCo 4.0 moves the slider by 1 N; MJX 3.17 still takes the servo's damping into the implicit
# step, and moves it half as fast. With Euler both agree. Both accept the model without a warning.
# Seen after 10 steps of 10 ms: MuJoCo 0.1 m/s with both integrators; MJX 0.05 (implicitfast), 0.1 (Euler). Fails if any changes.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==4.0.0 mujoco-mjx==3.17.0 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > limit.py <<'PY'
import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)
XML = """<mujoco><option gravity="0 0 0" integrator="{}" timestep="0.01"/><worldbody><body>
<joint name="x" type="slide" axis="1 0 0" actuatorfrcrange="-1 1"/><geom size=".1" mass="1" contype="0" conaffinity="0"/>
</body></worldbody><actuator><velocity joint="x" kv="100" ctrlrange="-10 10"/></actuator></mujoco>"""
for integrator, expected in (("implicitfast", 0.05), ("Euler", 0.1)):
    model = mujoco.MjModel.from_xml_string(XML.format(integrator))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1
    on_device = mjx.put_model(model)
    by_mjx = mjx.make_data(on_device).replace(ctrl=np.ones(1))
    advance = jax.jit(mjx.step)
    for _ in range(10):
        mujoco.mj_step(model, data)
        by_mjx = advance(on_device, by_mjx)
    print(integrator, "MuJoCo", data.qvel, "MJX", by_mjx.qvel)
    assert np.allclose(data.qvel, 0.1) and np.allclose(by_mjx.qvel, expected)
PY
venv/bin/python limit.py

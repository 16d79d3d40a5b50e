#!/bin/sh
# mujoco==4.0.0, mujoco-mjx==3.17.0, jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Python 3.11, seen 2026-11-27.
# A free rigid box that tumbles without forces, integrator RK4: MuJoCo 4.0 integrates the orientation of a free joint to fourth order, MJX 3.17 to second
# order only. Both accept the model without a warning, so a model tuned on one integrates differently on the other.
# Seen, largest error of qpos after 0.64 s against a step of 0.25 ms, steps 40 / 20 / 10 ms: MuJoCo 1.3e-7, 8.2e-9, 5.1e-10 (16 times
# less for half the step); MJX 3.2e-4, 8.0e-5, 2.0e-5 (4 times less). Fails if MJX's error falls by more than 6 times, or MuJoCo's by less than 12.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==4.0.0 mujoco-mjx==3.17.0 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > tumble.py <<'PY'
import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)
XML = """<mujoco><option gravity="0 0 0" integrator="RK4" timestep="{}"/><worldbody>
<body><freejoint/><geom type="box" size=".3 .2 .1" contype="0" conaffinity="0"/></body></worldbody></mujoco>"""
SECONDS = 0.64
SPIN = [2.0, 3.0, 1.0]


def by_c(step):
    model = mujoco.MjModel.from_xml_string(XML.format(step))
    data = mujoco.MjData(model)
    data.qvel[3:] = SPIN
    for _ in range(round(SECONDS / step)):
        mujoco.mj_step(model, data)
    return data.qpos.copy()


def by_mjx(step):
    model = mjx.put_model(mujoco.MjModel.from_xml_string(XML.format(step)))
    data = mjx.make_data(model)
    data = data.replace(qvel=data.qvel.at[3:].set(np.array(SPIN)))
    advance = jax.jit(mjx.step)
    for _ in range(round(SECONDS / step)):
        data = advance(model, data)
    return np.asarray(data.qpos)


reference = by_c(0.00025)
for name, simulate in (("MuJoCo", by_c), ("MJX", by_mjx)):
    errors = [float(np.abs(simulate(step) - reference).max()) for step in (0.04, 0.02, 0.01)]
    ratios = [errors[0] / errors[1], errors[1] / errors[2]]
    print(name, "errors", [f"{e:.1e}" for e in errors], "ratios", [f"{r:.1f}" for r in ratios])
    assert min(ratios) > 12 if name == "MuJoCo" else max(ratios) < 6
PY
venv/bin/python tumble.py

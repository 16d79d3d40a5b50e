#!/bin/sh
# optax==0.2.8, jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Python 3.11, seen 2026-11-27.
# optax.clip_by_global_norm squares before it sums, in the gradients' own precision: float32 gradients whose entries are finite but whose
# norm is beyond about 1.8e19 have the global norm inf, and are divided by it. The clipped gradient is exactly zero, without an error or a NaN, so a
# training loop that looks for non-finite numbers sees a healthy step that moves nothing (while Adam's moments decay).
# Seen: entries 1e18 -> clipped to norm 0.5; entries 1e19 -> all zeros, global norm inf. Fails if the second is not zero.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check optax==0.2.8 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > clip.py <<'PY'
import jax.numpy as jnp
import optax

clip = optax.clip_by_global_norm(0.5)
for entry, expected in ((1e18, 0.25), (1e19, 0.0)):
    gradient = {"w": jnp.full(4, entry, jnp.float32)}
    update, _ = clip.update(gradient, clip.init(gradient))
    print(entry, update["w"], "norm", optax.global_norm(gradient))
    assert (update["w"] == expected).all()
PY
venv/bin/python clip.py

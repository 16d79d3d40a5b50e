#!/bin/sh
# jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Linux x86-64, Python 3.11, seen 2026-11-27.
# On a CPU, JAX calls the host function of jax.pure_callback with denormal numbers flushed to zero in the calling thread (XLA's mode leaks
# into Python). Threads that existed before keep the normal mode. So one NumPy product over one array gives zeros in the callback itself and
# denormals in a thread pool that the callback hands the work to: equal work, other bits, by which thread it ran on.
# Native code that splits a batch over its own threads (a physics engine, say) is affected in the same way.
# Seen: callback thread [0. 0. 0.], pool thread [1.5e-308 1.5e-308 1.5e-308]. Fails if both agree.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > callback.py <<'PY'
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)
pool = ThreadPoolExecutor(1)
pool.submit(int).result()  # its thread exists before JAX calls back


def half(x):
    return np.asarray(x) * np.float64(0.5)


def host(x):
    return np.stack([half(x), pool.submit(half, x).result()])


shape = jax.ShapeDtypeStruct((2, 3), jnp.float64)
here, there = np.asarray(jax.jit(lambda x: jax.pure_callback(host, shape, x))(jnp.full(3, 3e-308)))
print("callback thread", here, "pool thread", there)
assert (here == 0).all() and (there > 0).all()
PY
venv/bin/python callback.py

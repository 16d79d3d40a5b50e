#!/bin/sh
# jax==0.10.2, jaxlib==0.10.2, numpy==2.4.6; Linux x86-64, Python 3.11, seen 2026-11-27.
# XLA's CPU client sizes its thread pool by the environment variable NPROC where it is set, below the number of processors that the process
# may use. The size of the pool decides how sums are split, so the same compiled gradient gives other bits with NPROC=1 than without,
# on a machine with two or more processors. NPROC is a name that other tools use (build scripts set it), and JAX does not document it.
# A program that promises bit-identical results must record or fix it.
# Seen: digest without NPROC = digest with NPROC=2, digest with NPROC=1 differs.
# Fails if NPROC=1 gives the bits of a run without it. Needs two processors.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > gradient.py <<'PY'
import hashlib

import jax
import jax.numpy as jnp
import numpy as np

x = jnp.asarray(np.random.default_rng(0).standard_normal((4096, 256)), jnp.float32)
w = jnp.asarray(np.random.default_rng(1).standard_normal((256, 256)), jnp.float32)
gradient = jax.jit(jax.grad(lambda w: jnp.mean(jnp.tanh(x @ w) ** 2)))(w)
print(hashlib.sha256(np.asarray(gradient).tobytes()).hexdigest()[:16])
PY
unset NPROC
plain=$(venv/bin/python gradient.py)
one=$(NPROC=1 venv/bin/python gradient.py)
again=$(venv/bin/python gradient.py)
echo "without NPROC: $plain, once more: $again, NPROC=1: $one"
[ "$plain" = "$again" ] && [ "$plain" != "$one" ]

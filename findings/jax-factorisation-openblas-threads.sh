#!/bin/sh
# jax==0.10.2, jaxlib==0.10.2, scipy==1.17.1, numpy==2.4.6; Python 3.11, two or more cores, seen 2026-11-28.
# On CPUs jnp.linalg.eigh and cholesky are those of the OpenBLAS inside SciPy's wheel, which has a pool of threads of its own. Its OPENBLAS_NUM_THREADS decides
# the last bits: of 128 rows eigh differs between 1 and 2 threads, of 256 rows Cholesky does too, while XLA's own NPROC is the same. The variable is read when SciPy is
# loaded, which is at the first factorisation, or earlier if anything imports scipy.linalg (brax does): set in os.environ after that, it has no effect.
# Seen: "eigh 128: 1 thread and 2 differ", "cholesky 256: 1 thread and 2 differ", "set after import jax: as 1 thread", "set after import scipy.linalg: as 2 threads".
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 scipy==1.17.1 numpy==2.4.6
cat >bits.py <<'PY'
import hashlib, os, sys
import jax, jax.numpy as jnp
if "late" in sys.argv:
    import scipy.linalg
if len(sys.argv) > 1:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
def digest(function, size):
    rows = jnp.sin(jnp.arange(300 * size, dtype=jnp.float32) ** 1.1).reshape(300, size)
    matrix = rows.T @ rows / 300 + 0.01 * jnp.eye(size)
    return hashlib.sha256(jax.jit(function)(matrix).tobytes()).hexdigest()[:12]
print(digest(lambda x: jnp.linalg.eigh(x)[1], 128), digest(jnp.linalg.cholesky, 256))
PY
export JAX_PLATFORMS=cpu
set -- $(OPENBLAS_NUM_THREADS=1 venv/bin/python bits.py); eigh_1=$1; cholesky_1=$2
set -- $(OPENBLAS_NUM_THREADS=2 venv/bin/python bits.py); eigh_2=$1; cholesky_2=$2
test "$eigh_1" != "$eigh_2"; echo "eigh 128: 1 thread and 2 differ"
test "$cholesky_1" != "$cholesky_2"; echo "cholesky 256: 1 thread and 2 differ"
test "$(OPENBLAS_NUM_THREADS=2 venv/bin/python bits.py early)" = "$eigh_1 $cholesky_1"; echo "set after import jax: as 1 thread"
test "$(OPENBLAS_NUM_THREADS=2 venv/bin/python bits.py late)" = "$eigh_2 $cholesky_2"; echo "set after import scipy.linalg: as 2 threads"

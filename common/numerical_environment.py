"""The variables and processor cores that decide the last bits of an update, beside versions and hardware.

XLA splits its work over a pool of threads, and sums depend on how they are split. Measured with jaxlib 0.10 on two
cores: NPROC=1 or OMP_NUM_THREADS=1 gives other bits than two threads, NPROC=4 on two cores the same ones, and one
core gives other bits whatever NPROC says. XLA_FLAGS and JAX_... choose how programs are compiled. Factorisations
(kernel critic, nystrom, kmp, basis) are those of SciPy's OpenBLAS, which has threads of its own: eigh differs between
one and two of them at any size, Cholesky from 256 rows on.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from threadpoolctl import threadpool_limits

FACTORISATION_THREADS = "OPENBLAS_NUM_THREADS"

THREAD_VARIABLES = ("NPROC", "OMP_NUM_THREADS", FACTORISATION_THREADS)
"""Variables that jaxlib and OpenBLAS take their number of threads from."""

_PREFIXES = ("JAX_", "XLA_")
_WITHOUT_EFFECT = (
    "JAX_COMPILATION_CACHE",
    "JAX_PERSISTENT_CACHE",
    "JAX_ENABLE_COMPILATION_CACHE",
    "JAX_LOG",
    "JAX_DEBUG_LOG",
    "JAX_TRACEBACK",
    "XLA_PYTHON_CLIENT",
    "XLA_CLIENT_MEM_FRACTION",
)
"""Beginnings of names that choose caches, messages and memory, not numbers."""


def numerical_environment(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The variables that decide bits and are set, by name."""
    return {
        name: value for name, value in sorted(environment.items()) if name in THREAD_VARIABLES or decides_bits(name)
    }


def decides_bits(name: str) -> bool:
    """True if XLA or JAX compile or compute by the variable of that name."""
    return name in THREAD_VARIABLES or (name.startswith(_PREFIXES) and not name.startswith(_WITHOUT_EFFECT))


def factorise_on_one_thread() -> None:
    """One thread for OpenBLAS, unless the user has said how many: for a new run, before JAX factorises anything.

    Matrices of a few hundred rows gain nothing from more, its threads get into the way of XLA's, and the bits are those
    of any number of cores.
    """
    os.environ.setdefault(FACTORISATION_THREADS, "1")
    _tell_openblas()


def _tell_openblas() -> None:
    """Variables are read when OpenBLAS is loaded, which importing brax or MJX does: here it is told again."""
    given = os.environ.get(FACTORISATION_THREADS, "") or os.environ.get("OMP_NUM_THREADS", "")
    threads = int(given) if given.isdecimal() and int(given) > 0 else len(os.sched_getaffinity(0))
    threadpool_limits(threads, user_api="blas")


def adopt(recorded: Mapping[str, str], cores: str) -> list[str]:
    """Take over the number of threads and cores of a recorded run; returns a sentence for each change.

    To be called before JAX computes anything, from the thread that makes it do so. XLA_FLAGS and JAX_... are not taken
    over: those of a log from elsewhere could make XLA write files.

    Args:
        recorded: variables of the run as `numerical_environment` has them; a run that recorded none had none.
        cores: how many the run had; "" where that is not recorded.
    """
    notes = []
    for name in THREAD_VARIABLES:
        old, new = os.environ.get(name), recorded.get(name)
        if old == new:
            continue
        if new is None:
            del os.environ[name]
            notes.append(f"{name}={old} is left out: the run was made without it, and the bits depend on it")
        else:
            os.environ[name] = new
            notes.append(f"{name} is {new}, as in the run, in place of {old or 'none'}: the bits depend on it")
    available = sorted(os.sched_getaffinity(0))
    if cores.isdecimal() and 0 < int(cores) < len(available):
        os.sched_setaffinity(0, available[: int(cores)])
        notes.append(f"{cores} of {len(available)} cores are used, as in the run: the bits depend on it")
    _tell_openblas()
    return notes

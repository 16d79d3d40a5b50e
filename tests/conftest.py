"""Shape and type checks of the mathematics, a JAX that the native engine can work with, and no clock, for every test.

JAX itself is imported only for tests that may use it: those of log and wire do without, and are quicker so.
"""

import os

# As `factorise_on_one_thread` sets it in a run, before anything loads OpenBLAS: tests compute a run's states again.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook
from threadpoolctl import threadpool_limits

WITHOUT_JAX = ("log", "wire", "viewing", "dashboard", "pages")

# How long an example takes is the machine's affair, not a promise of what is tested.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# In place before they are imported for the first time, by whichever test does so.
install_import_hook(["common.kernels", "common.maths"], "shape_checks.check")


CORES = os.sched_getaffinity(0)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Cores and threads of factorisations as at the start: a test, or what it shares, may have adopted a run's."""
    os.sched_setaffinity(0, CORES)
    threadpool_limits(1, user_api="blas")


def pytest_pycollect_makemodule(module_path: Path) -> None:
    """Set what `common.physics.engines.require_synchronous_dispatch` sets, before a test module uses JAX on import."""
    if module_path.parent.name not in WITHOUT_JAX:
        import jax

        jax.config.update("jax_cpu_enable_async_dispatch", False)


@pytest.fixture(scope="module")
def in_a_hurry() -> Iterator[None]:
    """What a module's tests compile is compiled in a hurry: for those that ask how programs behave, not how fast."""
    from quick_compiler import quick_compiler

    with quick_compiler():
        yield


@pytest.fixture(autouse=True, scope="module")
def _compiled_as_a_user_does(request: pytest.FixtureRequest) -> None:
    """A module that is in no hurry uses no program of one that was: it may compare bits with another process."""
    if "in_a_hurry" not in request.fixturenames and "quick_compiler" in sys.modules:
        sys.modules["quick_compiler"].forget_programs()


@pytest.fixture(autouse=True)
def _the_environment_stays() -> Iterator[None]:
    """Put back what a command changed in this process's environment: it is the next test's, too."""
    before = dict(os.environ)
    yield
    for name in os.environ.keys() - before.keys() - {"PYTEST_CURRENT_TEST"}:
        del os.environ[name]
    for name, value in before.items():
        if name != "PYTEST_CURRENT_TEST" and os.environ.get(name) != value:
            os.environ[name] = value

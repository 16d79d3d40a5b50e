"""Shape and type checks of the mathematics, a JAX that the native engine can work with, and no clock, for every test.

JAX itself is imported only for tests that may use it: those of log and wire do without, and are quicker so.
"""

from pathlib import Path

from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

WITHOUT_JAX = ("log", "wire", "viewing", "dashboard", "pages")

# How long an example takes is the machine's affair, not a promise of what is tested.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# In place before they are imported for the first time, by whichever test does so.
install_import_hook(["common.kernels", "common.maths"], "shape_checks.check")


def pytest_pycollect_makemodule(module_path: Path) -> None:
    """Set what `common.physics.engines.require_synchronous_dispatch` sets, before a test module uses JAX on import."""
    if module_path.parent.name not in WITHOUT_JAX:
        import jax

        jax.config.update("jax_cpu_enable_async_dispatch", False)

"""Shape and type checks of the mathematics, and a JAX that the native engine can work with, for every test.

JAX itself is imported only for tests that may use it: those of log and wire do without, and are quicker so.
"""

from pathlib import Path

from jaxtyping import install_import_hook

WITHOUT_JAX = ("log", "wire")

# In place before `common.maths` is imported for the first time, by whichever test does so.
install_import_hook("common.maths", "shape_checks.check")


def pytest_pycollect_makemodule(module_path: Path) -> None:
    """What `common.physics.engines.prepare_jax` does; too late once a test module has used JAX, be it on import."""
    if module_path.parent.name not in WITHOUT_JAX:
        import jax

        jax.config.update("jax_cpu_enable_async_dispatch", False)

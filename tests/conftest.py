"""Shape and type checks of the mathematics, and a JAX that the native engine can work with, for every test.

JAX is not imported here: the tests of log and wire do without it.
"""

import sys

from jaxtyping import install_import_hook

# In place before `common.maths` is imported for the first time, by whichever test does so.
install_import_hook("common.maths", "shape_checks.check")


def pytest_collection_finish() -> None:
    """What `common.physics.engines.prepare_jax` does, which is too late once another test has used JAX."""
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_cpu_enable_async_dispatch", False)

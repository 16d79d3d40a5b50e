"""Shape and type checks of the mathematics, and a JAX that the native engine can work with, for every test.

The hook must be in place before `common.maths` is imported for the first time, by whichever test does so; beartype
is imported only then.
"""

import jax
from jaxtyping import install_import_hook

install_import_hook("common.maths", "shape_checks.check")

# As `common.physics.engines.prepare_jax` does, which is too late once another test has used JAX.
jax.config.update("jax_cpu_enable_async_dispatch", False)

"""Shape and type checks of the mathematics, for every test.

The hook must be in place before `common.maths` is imported for the first time, by whichever test does so. It
imports neither JAX nor beartype until then.
"""

from jaxtyping import install_import_hook

install_import_hook("common.maths", "shape_checks.check")

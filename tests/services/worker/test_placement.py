"""Where a worker's programs are computed, once it knows the engine of its run."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import pytest

from common.errors import PhysicsError
from services.worker.placement import compute_beside


@pytest.fixture(autouse=True)
def _default_device() -> Iterator[None]:
    yield
    jax.config.update("jax_default_device", None)


def test_programs_of_the_native_engine_are_computed_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though JAX would compute on the GPU that it found; with MJX they go back there."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    cpu = jax.local_devices(backend="cpu")[0]
    compute_beside("native")
    assert jax.config.jax_default_device == cpu
    assert jax.jit(jnp.sum)(jnp.ones(3)).device == cpu
    compute_beside("mjx")
    assert jax.config.jax_default_device is None


def test_without_a_gpu_nothing_is_changed() -> None:
    """There is one place only."""
    compute_beside("native")
    assert jax.config.jax_default_device is None


def test_a_jax_without_a_cpu_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence names the variable that does it."""

    def none(backend: str) -> None:
        raise RuntimeError("Unknown backend cpu")

    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(jax, "local_devices", none)
    with pytest.raises(PhysicsError, match="JAX_PLATFORMS=cuda,cpu"):
        compute_beside("native")

"""Python functions called by compiled programs: what they are given, what comes back, and what is cached."""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring
from jax.experimental.compilation_cache import compilation_cache

from common.physics import host_functions
from common.physics.host_functions import HostFunction

Arrays = Sequence[np.ndarray]


def both_ways(inputs: Arrays, results: Arrays) -> None:
    """[N, 3], [N] -> the product [N, 3] and the sum of all inputs [N]."""
    rows, factor = inputs
    results[0][:] = rows * factor[:, None]
    results[1][:] = rows.sum(axis=1) + factor


ROWS, FACTORS = jnp.arange(12, dtype=jnp.float32).reshape(4, 3), jnp.array([1.0, 2.0, -1.0, 0.5])


def mapped(function: HostFunction) -> Any:
    """The function of one row, mapped over rows and compiled."""
    return jax.jit(jax.vmap(lambda row, factor: function((row, factor), [(3,), ()])))


@pytest.fixture(params=[True, False], ids=["foreign function", "callback"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """With and without XLA's interface to foreign functions."""
    if not request.param:
        monkeypatch.setattr(host_functions, "_registered", lambda: False)
    return bool(request.param)


def test_a_mapped_function_is_called_once_for_all(way: bool) -> None:
    """With the mapped axis in front, whatever the way; rows 0 1 2 | 3 4 5 | 6 7 8 | 9 10 11."""
    calls: list[tuple[int, ...]] = []

    def run(inputs: Arrays, results: Arrays) -> None:
        calls.append(inputs[0].shape)
        both_ways(inputs, results)

    function = HostFunction(run)
    products, sums = mapped(function)(ROWS, FACTORS)
    np.testing.assert_array_equal(products, [[0, 1, 2], [6, 8, 10], [-6, -7, -8], [4.5, 5, 5.5]])
    np.testing.assert_array_equal(sums, [4, 14, 20, 30.5])
    assert calls == [(4, 3)]


def test_arguments_cannot_be_written_to() -> None:
    """They are XLA's own memory, which other operations may still read."""
    function = HostFunction(lambda inputs, results: inputs[0].fill(0.0))
    with pytest.raises(Exception, match="read-only"):
        jax.block_until_ready(mapped(function)(ROWS, FACTORS))


def test_an_array_without_elements(way: bool) -> None:
    """A robot without motors has commands [N, 0]."""

    def run(inputs: Arrays, results: Arrays) -> None:
        assert inputs[1].shape == (4, 0)
        results[0][:] = inputs[0]

    function = HostFunction(run)
    call = jax.jit(jax.vmap(lambda row, none: function((row, none), [(3,), (0,)])))
    np.testing.assert_array_equal(call(ROWS, jnp.zeros((4, 0)))[0], ROWS)


def test_an_error_ends_the_program_with_its_text(way: bool) -> None:
    """Not the process."""

    def run(inputs: Arrays, results: Arrays) -> None:
        raise ValueError("no such robot")

    function = HostFunction(run)
    with pytest.raises(Exception, match="ValueError: no such robot"):
        jax.block_until_ready(mapped(function)(ROWS, FACTORS))


def test_only_float32_goes_in() -> None:
    """Other types are refused by name of the rule, rather than read as something they are not."""
    function = HostFunction(both_ways)
    call = jax.jit(jax.vmap(lambda row, factor: function((row, factor), [(3,), ()])))
    with pytest.raises(Exception, match="host functions take and return float32"):
        jax.block_until_ready(call(ROWS.astype(jnp.int32), FACTORS))


def test_a_program_whose_function_is_gone_says_so() -> None:
    """A number is never given twice, so that it cannot call another function instead."""
    function = HostFunction(both_ways)
    call, number = mapped(function).lower(ROWS, FACTORS).compile(), function.number
    jax.block_until_ready(call(ROWS, FACTORS))
    del function
    jax.clear_caches()
    gc.collect()
    assert HostFunction(both_ways).number > number
    with pytest.raises(Exception, match=f"the environment of this program is gone .host function {number}."):
        jax.block_until_ready(call(ROWS, FACTORS))


def test_an_interface_of_another_version_is_done_without(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """JAX refuses the function, and callbacks are used, as a warning says."""

    def refuse(*_: Any, **__: Any) -> None:
        raise ValueError("API version mismatch")

    monkeypatch.setattr(jax.ffi, "register_ffi_target", refuse)
    with caplog.at_level(logging.WARNING):
        assert host_functions._registered.__wrapped__() is False
    assert "compiled anew at each start" in caplog.text
    assert "API version mismatch" in caplog.text


# -- the cache ---------------------------------------------------------------------------------------------


@pytest.fixture
def events(tmp_path: Path) -> Iterator[list[str]]:
    """What JAX tells of a compilation cache in a folder of its own."""
    names = {"jax_compilation_cache_dir": str(tmp_path), "jax_persistent_cache_min_compile_time_secs": 0.0}
    before = {name: getattr(jax.config, name) for name in names}
    seen: list[str] = []
    listening = True

    def listen(name: str, **_: Any) -> None:
        if listening:
            seen.append(name.rpartition("/")[2])

    for name, value in names.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
    monitoring.register_event_listener(listen)
    yield seen
    listening = False
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


def test_programs_with_host_functions_are_cached(events: list[str]) -> None:
    """Compiled once, then read: by the number of the function, which is all of it that the program holds."""
    function = HostFunction(both_ways)
    first = mapped(function)(ROWS, FACTORS)
    assert events.count("cache_misses") == 1
    events.clear()
    jax.clear_caches()
    again = mapped(function)(ROWS, FACTORS)
    assert (events.count("cache_hits"), events.count("cache_misses")) == (1, 0)
    jax.tree.map(np.testing.assert_array_equal, first, again)


def test_programs_of_other_functions_are_not_mixed_up(events: list[str]) -> None:
    """Two functions of the same shapes have two entries."""
    one, other = HostFunction(both_ways), HostFunction(lambda inputs, results: [result.fill(7.0) for result in results])
    first = mapped(one)(ROWS, FACTORS)
    second = mapped(other)(ROWS, FACTORS)
    assert events.count("cache_misses") == 2
    assert float(first[1][0]) == 4.0
    assert float(second[1][0]) == 7.0

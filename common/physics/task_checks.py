"""Checks of a task's functions before anything is simulated: traced with shapes alone, which starts no device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from common.errors import SettingsError
from common.physics.simulation import Data, ReadingLayout
from common.physics.task import Task


def observation_size(name: str, task: Task) -> int:
    """The size O of a task's observations.

    Raises:
        SettingsError: a function of the task fails, or returns something of the wrong shape.
    """
    try:
        layout = ReadingLayout(task.model, task.reads)
    except SettingsError as error:
        raise SettingsError(f"task {name}: {error}") from None
    model = task.model
    read = {path.split("/")[1]: _float(shape) for path, shape in layout.rest().items()}
    fields = {"qpos": _float((model.nq,)), "qvel": _float((model.nv,)), **read}
    action, key = _float((model.nu,)), jax.eval_shape(lambda: jax.random.key(0))
    first = _traced(name, "first_state", task.first_state, key)
    _require(name, "first_state", first, [(model.nq,), (model.nv,)], "positions and velocities of the joints")
    _require(name, "command", _traced(name, "command", task.command, action), (model.nu,), "a number for each actuator")

    def observe(values: dict[str, Any]) -> Any:
        return task.observation(Data(values))

    def judge(function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda before, action, after: function(Data(before), action, Data(after))

    shape = _traced(name, "observation", observe, fields)
    if not isinstance(shape, tuple) or len(shape) != 1 or not shape[0]:
        raise SettingsError(f"task {name}: observation() returns {_told(shape)} where a vector of numbers is needed")
    if (again := _traced(name, "observation", observe, fields)) != shape:
        raise SettingsError(f"task {name}: observation() returns {_told(shape)} once and {_told(again)} another time")
    for method, function in (("reward", task.reward), ("terminated", task.terminated)):
        found = _traced(name, method, judge(function), fields, action, fields)
        _require(name, method, found, (), "one value for each environment")
    return int(shape[0])


def _float(shape: tuple[int, ...]) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, jnp.float32)


def _traced(name: str, method: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """The shape of the result, or the list of shapes where it is several arrays."""
    try:
        result = jax.eval_shape(lambda *given: jax.tree.map(jnp.asarray, function(*given)), *arguments)
    except jax.errors.ConcretizationTypeError:
        raise SettingsError(
            f"task {name}: {method}() decides something in Python by numbers that are only known when it runs; write "
            "jnp.where(condition, a, b) for `a if condition else b`, and jnp functions for those of numpy or math"
        ) from None
    except Exception as error:  # a user's function may raise anything
        text = str(error).strip().splitlines() or [""]
        raise SettingsError(f"task {name}: {method}() raises {type(error).__name__}: {text[0]}") from error
    leaves = jax.tree.leaves(result)
    if isinstance(result, jax.ShapeDtypeStruct):
        return result.shape
    return [leaf.shape for leaf in leaves]


def _require(name: str, method: str, found: Any, wanted: Any, what: str) -> None:
    if found != wanted:
        raise SettingsError(f"task {name}: {method}() returns {_told(found)} where {_told(wanted)} is needed: {what}")


def _told(shape: Any) -> str:
    if isinstance(shape, list):
        return " and ".join(_told(part) for part in shape) or "nothing"
    return f"an array of shape {shape}" if shape else "a single number"

"""An exported policy on disk: written beside, verified, and only then under its name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import export as jax_export

from common.errors import SettingsError
from common.files import create
from common.physics.step_functions import StepFunctions
from reskpn.export.graph import NotTranslatable
from reskpn.export.policy import TrainedPolicy, facts
from reskpn.export.simulation import packed_simulation
from reskpn.export.stablehlo import write_stablehlo
from reskpn.export.translate import to_onnx
from reskpn.export.verify import Verified, verify
from reskpn.policy_file import FORMAT, KEY, SIMULATION, load, pack

Format = Literal["onnx", "jax"]
FORMATS: tuple[Format, ...] = ("onnx", "jax")
SUFFIXES: dict[Format, str] = {"onnx": ".onnx", "jax": ".npz"}


def format_of(path: Path) -> Format:
    """The format that a file's ending stands for. SettingsError for another ending."""
    for format in FORMATS:
        if path.suffix == SUFFIXES[format]:
            return format
    raise SettingsError(f"{path}: an exported policy is a file that ends in .onnx, or in .npz for JAX")


@dataclass(frozen=True)
class Written:
    """A verified file. `not_playable`: the reason why `reskpn play` cannot play it; None where it can."""

    path: Path
    size_bytes: int
    verified: Verified
    not_playable: str | None


def write_policy(policy: TrainedPolicy, observations: np.ndarray, format: Format, path: Path) -> Written:
    """Write a policy, verify what was written on observations [n, O], and give it its name.

    Raises:
        SettingsError: the file cannot be written.
        NumericsError: it does not act as the trained policy does; nothing is left of it.
    """
    functions = StepFunctions(policy.settings.task)
    known = {
        "format": FORMAT,
        **facts(policy, functions.observation_layout(), functions.action_limits(), functions.step_s),
    }
    beside = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        not_playable = _write(beside, policy, format, functions, known)
        verified = verify(load(beside), policy.function(), observations)
        size = beside.stat().st_size
        beside.replace(path)
    except OSError as error:
        raise SettingsError(f"{path} cannot be written ({error.strerror}); choose another file with --out") from None
    finally:
        beside.unlink(missing_ok=True)
    return Written(path, size, verified, not_playable)


def _write(
    path: Path, policy: TrainedPolicy, format: Format, functions: StepFunctions, known: dict[str, Any]
) -> str | None:
    """Write the file; returns the reason why it cannot be played, or None."""
    size = known["observation"]["size"]
    not_playable, metadata = None, {}
    if format == "jax":
        not_playable = "`reskpn play` plays ONNX files"
    else:
        try:
            metadata[SIMULATION] = pack(packed_simulation(functions, policy.settings))
        except NotTranslatable as error:
            not_playable = f"task {policy.settings.task} uses what ONNX cannot express: {error}"
    if not_playable is not None:
        known = known | {"not_playable": not_playable}
    with create(path) as file:
        if format == "jax":
            write_stablehlo(file, policy.function_of_arrays(), policy.arrays, size, known)
        else:
            file.write(onnx_bytes(policy.function(), size, metadata | {KEY: json.dumps(known)}))
    return not_playable


def onnx_bytes(function: Callable[[jax.Array], jax.Array], observation_size: int, metadata: dict[str, str]) -> bytes:
    """The ONNX file of a policy: `observation` [batch, O] in, `action` [batch, A] out."""
    (batch,) = jax_export.symbolic_shape("batch")
    inputs = {"observation": jax.ShapeDtypeStruct((batch, observation_size), jnp.float32)}
    model = to_onnx(lambda observation: [function(observation)], inputs, ["action"], name="policy")
    for key, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    return model.SerializeToString()

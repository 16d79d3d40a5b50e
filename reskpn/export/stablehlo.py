"""A policy for programs with JAX: its arrays and StableHLO that takes them, in one NumPy archive."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import jax
import jax.numpy as jnp
import numpy as np
from jax import export

from common.errors import PolicyFileError
from reskpn.policy_file import KEY, Policy, parse_facts

PROGRAM = "program"
ARRAYS = "arrays/"
"""Names in the archive: the program's bytes, and the prefix of the policy's arrays."""

PLATFORMS = ("cpu", "cuda", "tpu")


def write_stablehlo(
    file: BinaryIO,
    function: Callable[[dict[str, Any], jax.Array], jax.Array],
    arrays: Mapping[str, np.ndarray],
    observation_size: int,
    facts: Mapping[str, Any],
) -> None:
    """Write the archive.

    Args:
        function: actions [B, A] from the arrays by path and observations [B, O].
    """
    (batch,) = export.symbolic_shape("batch")
    specs = {name: jax.ShapeDtypeStruct(array.shape, array.dtype) for name, array in arrays.items()}
    observations = jax.ShapeDtypeStruct((batch, observation_size), jnp.float32)
    program = export.export(jax.jit(function), platforms=PLATFORMS)(specs, observations).serialize()
    content = {f"{ARRAYS}{name}": array for name, array in arrays.items()}
    content[PROGRAM] = np.frombuffer(program, np.uint8)
    content[KEY] = np.frombuffer(json.dumps(facts).encode(), np.uint8)
    np.savez_compressed(file, allow_pickle=False, **content)


def load_stablehlo(path: Path) -> Policy:
    """The policy in an archive. PolicyFileError where it is none."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
    except OSError as error:
        raise PolicyFileError(f"{path} cannot be read ({error.strerror or error})") from None
    except (ValueError, zipfile.BadZipFile, EOFError) as error:
        raise PolicyFileError(f"{path} is not an archive of NumPy arrays ({error})") from None
    facts = parse_facts(content[KEY].tobytes().decode(errors="replace") if KEY in content else None, path)
    if PROGRAM not in content:
        raise PolicyFileError(f"{path} has no program; export the policy again")
    arrays = {name.removeprefix(ARRAYS): array for name, array in content.items() if name.startswith(ARRAYS)}
    program = jax.jit(export.deserialize(bytearray(content[PROGRAM].tobytes())).call)
    placed = jax.device_put(arrays)
    return Policy(path, facts, lambda observations: np.asarray(program(placed, observations)))

"""A trained policy from a file, for a robot's control loop: needs NumPy and ONNX Runtime, nothing else.

    from reskpn.policy_file import load

    policy = load("hopper-v730.onnx")
    action = policy.act(observation)

Files are made by `reskpn export`; docs/export.md describes them.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import onnxruntime

from common.errors import PolicyFileError

KEY = "reskpn"
"""Entry of an ONNX file's metadata with the facts about the policy, as JSON."""

SIMULATION = "reskpn.simulation"
"""Entry with what `reskpn play` needs: JSON, deflated, in base 64."""

FORMAT = 1


class Action(Protocol):
    """Clipped actions [B, A] for observations [B, O]."""

    def __call__(self, observations: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class Policy:
    """A policy without exploration; its actions are clipped as the environment clips them.

    facts: of the file's metadata: task, run, version, digest, observation, action, versions of packages.
    simulation: what `reskpn play` needs; None where the file cannot be played.
    """

    path: Path
    facts: Mapping[str, Any]
    compute: Action
    simulation: Mapping[str, Any] | None = None

    @property
    def task(self) -> str:
        return str(self.facts["task"])

    @property
    def observation_size(self) -> int:
        return int(self.facts["observation"]["size"])

    def act(self, observation: np.ndarray | Sequence[float]) -> np.ndarray:
        """The action [A] for an observation [O], or [B, A] for [B, O]; float32, each number in [-1, 1].

        Raises:
            PolicyFileError: the observation has another shape, or a number that is not finite.
        """
        given = np.asarray(observation, np.float32)
        if given.ndim not in (1, 2) or given.shape[-1] != self.observation_size:
            raise PolicyFileError(
                f"an observation of shape {list(given.shape)}; the policy of {self.path.name} takes "
                f"[{self.observation_size}], or [B, {self.observation_size}] for several"
            )
        if not np.isfinite(given).all():
            raise PolicyFileError("an observation has a number that is not finite; no action follows from it")
        actions = self.compute(np.atleast_2d(given))
        return actions[0] if given.ndim == 1 else actions


def load(path: str | Path, *, threads: int = 1) -> Policy:
    """The policy in a file that `reskpn export` made, `.onnx` or `.npz`; the latter needs JAX.

    Args:
        threads: of ONNX Runtime. More than one slows a single action down.

    Raises:
        PolicyFileError: there is no such file, or it is not an exported policy.
    """
    path = Path(path)
    if path.suffix == ".npz":
        from reskpn.export.stablehlo import load_stablehlo

        return load_stablehlo(path)
    session = open_session(_read(path), str(path), threads)
    metadata = session.get_modelmeta().custom_metadata_map
    facts = parse_facts(metadata.get(KEY), path)

    def compute(observations: np.ndarray) -> np.ndarray:
        actions: np.ndarray = session.run(None, {"observation": observations})[0]
        return actions

    packed = metadata.get(SIMULATION)
    return Policy(path, facts, compute, None if packed is None else unpack(packed))


def open_session(model: bytes, name: str, threads: int = 1) -> onnxruntime.InferenceSession:
    """The model of a file or a part of one, ready to run. PolicyFileError where it is none."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own exceptions have no common class but this one
        reason = str(error).splitlines()[0][:200]
        raise PolicyFileError(f"{name} is not an ONNX file that ONNX Runtime can run ({reason})") from None


def parse_facts(text: str | None, path: Path) -> Mapping[str, Any]:
    """The facts in a file's metadata. PolicyFileError where it has none that this version understands."""
    try:
        facts = json.loads(text) if text is not None else None
    except ValueError:
        facts = None
    if not isinstance(facts, dict):
        raise PolicyFileError(f"{path} was not made by `reskpn export`: it says nothing of task and observation")
    if facts.get("format") != FORMAT:
        raise PolicyFileError(
            f"{path} is of format {facts.get('format')}, this version reads format {FORMAT}; export the policy again"
        )
    return facts


def pack(content: Mapping[str, Any]) -> str:
    """A map of JSON values, bytes and arrays as text; `unpack` reads it."""
    plain = {name: _plain(value) for name, value in content.items()}
    return base64.b64encode(zlib.compress(json.dumps(plain).encode(), 9)).decode()


def unpack(text: str) -> dict[str, Any]:
    """The map that `pack` made a text of. PolicyFileError where it is damaged."""
    try:
        content = json.loads(zlib.decompress(base64.b64decode(text)))
        return {name: _restored(value) for name, value in content.items()}
    except (ValueError, zlib.error, KeyError, TypeError, AttributeError) as error:
        raise PolicyFileError(f"the simulation in this file is damaged ({error}); export the policy again") from None


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return {"bytes": base64.b64encode(value).decode()}
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value, "<f4").tobytes()
        return {"floats": base64.b64encode(data).decode(), "shape": list(value.shape)}
    return value


def _restored(value: Any) -> Any:
    if isinstance(value, dict) and "bytes" in value:
        return base64.b64decode(value["bytes"])
    if isinstance(value, dict) and "floats" in value:
        return np.frombuffer(base64.b64decode(value["floats"]), "<f4").reshape(value["shape"])
    return value


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise PolicyFileError(
            f"{path} cannot be read ({error.strerror}); give a file made by `reskpn export`"
        ) from None

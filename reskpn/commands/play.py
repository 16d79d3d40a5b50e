"""`reskpn play`: episodes without exploration, of an exported policy or of any version of a recorded run."""

from __future__ import annotations

import argparse
import json
import time
from typing import TYPE_CHECKING

from common.engine_names import NATIVE
from common.errors import PolicyFileError, SettingsError
from common.printable import printable
from reskpn.commands import evaluate
from reskpn.commands.command import EXIT_CODES, Command

if TYPE_CHECKING:
    import numpy as np

    from reskpn.policy_file import Policy

EPILOG = f"""\
An exported policy (`reskpn export`) brings its task with it: playing it needs ONNX
Runtime and MuJoCo, and neither JAX nor the run. Without --seed it begins in the same
states as the run's own evaluation; --seed draws others.

Of a run, a policy that the log does not hold (it has every log.policy_every-th and the
last) is recomputed from the log, which takes as long as the learner took for it.

{EXIT_CODES}"""


def run(given: argparse.Namespace) -> int:
    """Play the episodes and print their returns. Returns 0."""
    if given.path.suffix != ".onnx" and not given.path.is_file():
        return evaluate.run(given)
    _check(given)
    from reskpn.playing import first_states, play
    from reskpn.policy_file import load

    policy = load(given.path)
    task = printable(policy.task)
    if given.task is not None and given.task != policy.task:
        raise PolicyFileError(f"{given.path} is a policy of task {task}, not of {given.task}")
    if not 1 <= given.episodes <= first_states(policy):
        raise SettingsError(f"--episodes is {given.episodes}; allowed: 1 to {first_states(policy)}")
    began_s = time.monotonic()
    returns, lengths = play(policy, given.episodes, given.seed)
    took_s = time.monotonic() - began_s
    _print(policy, returns, lengths, given, took_s)
    return 0


def _check(given: argparse.Namespace) -> None:
    """SettingsError for an option or a number that an exported policy cannot be played with."""
    if given.version is not None:
        raise SettingsError(f"--version is for runs; {given.path} holds one policy")
    if given.threads:
        raise SettingsError("--threads is for runs; an exported policy is played on one thread")
    if given.physics not in (None, NATIVE):
        raise SettingsError(f"--physics is {given.physics}; an exported policy is played with {NATIVE}")
    if given.seed is not None and not 0 <= given.seed < 2**32:
        raise SettingsError(f"--seed is {given.seed}; allowed: 0 to {2**32 - 1}")


def _print(policy: Policy, returns: np.ndarray, lengths: np.ndarray, given: argparse.Namespace, took_s: float) -> None:
    facts = policy.facts
    if given.json:
        shown = {name: facts[name] for name in ("run", "version", "task")}
        shown |= {"seed": given.seed, "returns": returns.tolist(), "lengths": lengths.tolist()}
        print(json.dumps(shown))
        return
    print(
        f"{printable(str(facts['run']))}: policy {facts['version']} of task {printable(policy.task)}, "
        f"{'first states of the run' if given.seed is None else f'seed {given.seed}'}, physics {NATIVE}"
    )
    print(
        f"return {returns.mean():,.1f} ± {returns.std():,.1f} (from {returns.min():,.1f} to {returns.max():,.1f}) over "
        f"{len(returns)} episodes of {lengths.mean():,.0f} steps on average, in {took_s:.1f} s"
    )


COMMAND = Command(evaluate.add_options, run, EPILOG, usage="reskpn play POLICY.onnx|RUN [options]")

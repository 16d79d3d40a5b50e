"""Where the time of one update goes: its operations by kind, and the share of the processor's measured matrix speed.

    python -m benchmarks.profile --task hopper --case ppo --case "exact n=1 M=2441"

One update is traced by JAX's profiler. XLA's operations are sorted by what they contain; times are summed over threads,
so they say how the work is divided, not how long it takes. The speed of products of a minibatch's size is measured in
the same process, right before and after.
"""

from __future__ import annotations

import argparse
import gzip
import itertools
import json
import re
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.machine import describe, machine
from benchmarks.update import CASES, Subject
from common.config.settings import RunSettings
from common.tasks import TASKS

KINDS = (
    ("matrix products", ("dot", "convolution", "custom-call")),
    ("tanh, exp", ("tanh", "exponential", "exponential-minus-one", "log")),
    ("sorts", ("sort",)),
    ("gathers", ("gather",)),
    ("sums", ("reduce", "reduce-window")),
)
"""Kinds of operations, by the HLO instructions that they contain; the first that fits counts."""

OTHER = "other elementwise work"

_COMPUTATION = re.compile(r"^(?:ENTRY )?%?([\w.\-]+) [^\n]*\{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
_INSTRUCTION = re.compile(r"^\s*(?:ROOT )?%?([\w.\-]+) = (?:\([^=]*?\)|\S+) ([\w\-]+)\((.*)$", re.MULTILINE)
_CALLED = re.compile(r"calls=%?([\w.\-]+)")
_CONTROL = frozenset({"while", "conditional", "call", "parameter", "tuple", "get-tuple-element", "constant", "bitcast"})


def kinds_of_operations(hlo: str) -> dict[str, str]:
    """The kind of every operation of a compiled program by its name, as the profiler names it."""
    inside: dict[str, set[str]] = {}
    calls: dict[str, tuple[str, str]] = {}
    for name, body in _COMPUTATION.findall(hlo):
        inside[name] = set()
        for instruction, opcode, rest in _INSTRUCTION.findall(body):
            inside[name].add(opcode)
            called = _CALLED.search(rest)
            calls[instruction] = (opcode, called.group(1) if called else "")
    return {
        name: _kind({opcode} | inside.get(called, set()))
        for name, (opcode, called) in calls.items()
        if opcode not in _CONTROL
    }


def _kind(opcodes: set[str]) -> str:
    return next((kind for kind, those in KINDS if opcodes.intersection(those)), OTHER)


def traced_ms(work: Any) -> dict[str, float]:
    """Milliseconds by operation, summed over threads, while `work` is called."""
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            work()
        path = next(Path(folder).rglob("*.trace.json.gz"))
        events = json.loads(gzip.decompress(path.read_bytes()))["traceEvents"]
    found: defaultdict[str, float] = defaultdict(float)
    for event in events:
        if event.get("ph") == "X":
            found[event["name"]] += event.get("dur", 0) / 1e3
    return found


def by_kind(ms: Mapping[str, float], kinds: Mapping[str, str]) -> dict[str, float]:
    """Milliseconds by kind; what the profiler shows beside the program's operations is left out."""
    found: defaultdict[str, float] = defaultdict(float)
    for name, value in ms.items():
        if name in kinds:
            found[kinds[name]] += value
    return found


def network_flop(settings: RunSettings) -> float:
    """Floating-point operations of the networks' products in one update's epochs.

    A layer takes 2 B in out of them forward and twice that backward, but for the gradient by the observations.
    """
    task, hidden = TASKS[settings.task], settings.algorithm.hidden
    first = 2 * task.observation_size * hidden[0]  # of policy and critic
    between = sum(2 * a * b for a, b in itertools.pairwise(hidden))
    forward = first + between + hidden[-1] * (task.action_size + 1)
    return 2.0 * settings.batch_size * settings.algorithm.epochs * (3 * forward - first)


def product_speed(rows: int, width: int, seconds: float = 0.5) -> float:
    """FLOP/s of [rows, width] @ [width, width] in float32, many in a row in one program."""
    count = 64

    @jax.jit
    def chain(x: jax.Array, y: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, count, lambda _, z: jnp.matmul(z, y), x)

    x, y = jnp.ones((rows, width), jnp.float32), jnp.eye(width, dtype=jnp.float32)
    chain(x, y).block_until_ready()
    speeds, until = [], time.perf_counter() + seconds
    while time.perf_counter() < until:
        began = time.perf_counter()
        chain(x, y).block_until_ready()
        speeds.append(2.0 * count * rows * width * width / (time.perf_counter() - began))
    return statistics.median(speeds)


def report(task: str, name: str, updates: int) -> Iterator[str]:
    """The lines of one case."""
    subject = Subject(next(case for case in CASES if case.name == name), task)
    settings = RunSettings.model_validate({"task": task})
    rows = settings.batch_size // settings.algorithm.minibatches
    subject.seconds()
    speeds = [product_speed(rows, settings.algorithm.hidden[-1])]
    seconds = statistics.median(subject.seconds()[0] for _ in range(updates))
    speeds.append(product_speed(rows, settings.algorithm.hidden[-1]))
    peak, flop = statistics.mean(speeds), network_flop(settings)
    yield f"\n{task}, {name}: {1e3 * seconds:.0f} ms an update (median of {updates})"
    yield (
        f"the networks' products: {flop / 1e9:.1f} GFLOP, at least {1e3 * flop / peak:.0f} ms at the "
        f"{peak / 1e9:.0f} GFLOP/s that products of {rows} rows reach here: {flop / peak / seconds:.0%} of the update"
    )
    ms = by_kind(traced_ms(subject.seconds), kinds_of_operations(subject.hlo()))
    for kind, value in sorted(ms.items(), key=lambda item: -item[1]):
        yield f"  {kind:24} {value:8.0f} ms of threads  {value / sum(ms.values()):5.0%}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.profile", description=__doc__.split("\n")[0])
    parser.add_argument("--task", action="append", choices=TASKS, help="default: hopper")
    parser.add_argument("--case", action="append", help='of benchmarks.update; default: ppo and "exact n=1 M=2441"')
    parser.add_argument("--updates", type=int, default=5, help="updates whose time is taken (default 5)")
    given = parser.parse_args(arguments)
    print(*describe(machine()), sep="\n")
    for task in given.task or ["hopper"]:
        for case in given.case or ["ppo", "exact n=1 M=2441"]:
            print(*report(task, case, given.updates), sep="\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The cost of the service: the same run in one process and as learner and actors, alternating, in new processes.

`--reference` adds `benchmarks.reference`, the same work by another implementation in one process, as a yardstick
for the machine. In async mode the phases overlap and the data depend on timing, so that only the speed can be compared.

    make bench
    python -m benchmarks.service --task humanoid --learner reskpn --actors 1 2 --repeats 3 --json result.json

Both sides are measured over the same updates, without the first few: one process by its own clock, the service by the
times of the `/update` messages in its log. Other options are passed to both sides as settings.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from benchmarks.machine import describe, machine
from benchmarks.one_process import UPDATES, WARM_UP
from benchmarks.processes import run_json, run_module
from benchmarks.reference import LEARNERS, Recipe
from common.errors import ReskpnError, SettingsError
from common.log.reader import LogReader

MODES = ("sync", "async")
GOAL = 0.85
"""Promised speed of the service with one actor relative to one process."""

NS = 1e-9
PHASES = {
    "physics": "environments",
    "policy": "acting, between two physics steps",
    "learner": "the update",
    "hand_over": "policy and rollout passed on in memory",
    "publish": "snapshot encoded and announced",
    "transport": "orders, snapshot and rollout on their way, checked and logged",
}
"""Consecutive phases that make up the whole update."""

BESIDE = {
    "wait": "learner's loop idle",
    "record": "digest, policy log and checkpoint, while the actors are at work again",
    "log": "the log's thread at work",
    "push": "from sending a rollout to its acknowledgement; within transport",
}
"""Phases that overlap with those above."""


REFERENCE = "reference"
REFERENCE_SETTINGS = ("task", "learner", "physics", "num_envs", "seed")


@dataclass(frozen=True)
class Sample:
    """One run: environment steps per second, mean seconds of an update by phase, digest of the last state.

    The reference tells neither phases nor a digest.
    """

    env_steps_per_s: float
    seconds: dict[str, float]
    state_digest: str


@dataclass(frozen=True)
class Plan:
    """The runs to compare. `settings` are options of `reskpn train`."""

    settings: list[str]
    batch_size: int
    updates: int
    warm_up: int

    def __post_init__(self) -> None:
        if not 0 < self.warm_up < self.updates:
            raise SettingsError(
                f"--warm-up is {self.warm_up}; it must be at least 1, for the clock starts at the end of an update, "
                f"and less than the {self.updates} updates"
            )


def one_process(plan: Plan) -> Sample:
    """Run without the service, in one process."""
    result = run_json("benchmarks.one_process", [*plan.settings, "--warm-up", str(plan.warm_up)])
    return Sample(result["env_steps_per_s"], result["seconds"], result["state_digest"])


def reference(plan: Plan) -> Sample:
    """Run the reference implementation with the same sizes; its clock excludes only the first update."""
    options = dict(zip(plan.settings[::2], plan.settings[1::2], strict=True))
    words = [word for name in REFERENCE_SETTINGS for word in (option(name), options[option(name)])]
    result = run_json("benchmarks.reference", [*words, "--steps", options["--total-steps"]])
    return Sample(result["env_steps_per_s"], {}, "")


def option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def service(plan: Plan, actors: int, mode: str) -> Sample:
    """Run `reskpn train` and read the log afterwards."""
    with tempfile.TemporaryDirectory(prefix="reskpn-bench-") as folder:
        run_dir = Path(folder) / "run"
        places = ["--actors", str(actors), "--run-dir", str(run_dir), "--evaluation.episodes", "0", "--mode", mode]
        run_module("reskpn", ["train", *plan.settings, *places])
        digest = json.loads((run_dir / "summary.json").read_text())["state_digest"]
        updates = [(message.t_ns, message.json()) for message in LogReader(run_dir).messages(["/update"])]
    counted = [record["seconds"] for _, record in updates[plan.warm_up :]]
    update_s = (updates[-1][0] - updates[plan.warm_up - 1][0]) * NS / len(counted)
    seconds = phases(counted, update_s)
    if mode == "async":
        del seconds["transport"]  # what is left of an update without the others, if they came one after the other
    return Sample(plan.batch_size / update_s, seconds, digest)


def phases(records: Sequence[Mapping[str, float]], update_s: float) -> dict[str, float]:
    """Mean seconds per update by phase, from `seconds` in the `/update` messages; of actors, the slowest.

    Actors begin on the next rollout when a policy is published, while the learner still keeps its records. What is
    left of an update without the actors' and the learner's work is therefore the transport, not the learner's wait
    less the actors' work.
    """
    names = {name for record in records for name in record}
    mean = {name: sum(record.get(name, 0.0) for record in records) / len(records) for name in names}
    seconds = {"policy": mean["actor/collect"], "learner": mean["learner"], "publish": mean["publish"]}
    if "actor/physics" in mean:
        seconds["physics"] = mean["actor/physics"]
    seconds["transport"] = update_s - sum(seconds.values())
    beside = {"wait": mean["wait"], "record": mean["record"], "log": mean["log"], "push": mean["actor/push"]}
    return seconds | beside | {"update": update_s}


def compare(
    plan: Plan, actors: Sequence[int], modes: Sequence[str], repeats: int, with_reference: bool = False
) -> dict[str, list[Sample]]:
    """Samples by side ("one process", "reference", "1 actor", "1 actor async", ...), taken in alternation."""
    sides: dict[str, Callable[[Plan], Sample]] = {"one process": one_process}
    if with_reference:
        sides[REFERENCE] = reference
    sides |= {_name(number, mode): partial(service, actors=number, mode=mode) for number in actors for mode in modes}
    samples: dict[str, list[Sample]] = {side: [] for side in sides}
    for turn in range(repeats):
        for side, run in sides.items():
            samples[side].append(run(plan))
        done = ", ".join(f"{side} {found[-1].env_steps_per_s:,.0f}" for side, found in samples.items())
        print(f"turn {turn + 1} of {repeats}: {done} steps/s", file=sys.stderr, flush=True)
    return samples


def _name(actors: int, mode: str) -> str:
    return f"{actors} actor{'s' if actors > 1 else ''}{' async' if mode == 'async' else ''}"


def ratios(samples: Mapping[str, Sequence[Sample]], side: str) -> list[float]:
    """Speed of a side relative to one process, pairwise."""
    pairs = zip(samples[side], samples["one process"], strict=True)
    return [mine.env_steps_per_s / theirs.env_steps_per_s for mine, theirs in pairs]


def speed_table(samples: Mapping[str, Sequence[Sample]]) -> Iterator[str]:
    yield f"{'':16}{'steps/s (median)':>18}{'ratio (median)':>16}  pair by pair"
    for side, found in samples.items():
        speed = statistics.median(sample.env_steps_per_s for sample in found)
        line = f"{side:16}{speed:>18,.0f}"
        if side != "one process":
            pairs = ratios(samples, side)
            line += f"{statistics.median(pairs):>16.3f}  {' '.join(f'{ratio:.3f}' for ratio in pairs)}"
        yield line
    if "1 actor" in samples:
        ratio = statistics.median(ratios(samples, "1 actor"))
        digests = {sample.state_digest for side in ("one process", "1 actor") for sample in samples[side]}
        yield f"goal for 1 actor: {GOAL}, {'met' if ratio >= GOAL else 'missed'}"
        yield (
            "one process and 1 actor ended in the same state, bit for bit"
            if len(digests) == 1
            else "one process and 1 actor did NOT end in the same state: they did not do the same work"
        )


def phase_table(samples: Mapping[str, Sequence[Sample]]) -> Iterator[str]:
    def row(name: str, text: str) -> str:
        cells = []
        for found in samples.values():
            values = [sample.seconds[name] for sample in found if name in sample.seconds]
            cells.append(f"{1e3 * statistics.median(values):>16.1f}" if values else f"{'-':>16}")
        return f"{name:12}{''.join(cells)}  {text}"

    yield f"{'ms an update':12}{''.join(f'{side:>16}' for side in samples)}"
    yield from (row(name, text) for name, text in PHASES.items())
    yield row("update", "all of the above")
    yield "beside those:"
    yield from (row(name, text) for name, text in BESIDE.items())


def main(arguments: Sequence[str] | None = None) -> int:
    parser = _parser()
    given, further = parser.parse_known_args(arguments)
    found = machine()
    batch_size = given.num_envs * given.num_steps
    names = ("task", "learner", "physics", "num_envs", "num_steps", "seed")
    settings = ["--config", "paper"] + [word for name in names for word in (option(name), str(getattr(given, name)))]
    settings += ["--total-steps", str(given.updates * batch_size), *further]
    if given.reference and (further or given.learner not in LEARNERS or given.num_steps != Recipe.num_steps):
        parser.error(
            f"--reference has the learners {' and '.join(LEARNERS)} with {Recipe.num_steps} steps and fixed settings; "
            f"given were --learner {given.learner}, --num-steps {given.num_steps} and settings: "
            f"{' '.join(further) or 'none'}. Leave it out, or them"
        )
    try:
        plan = Plan(settings, batch_size, given.updates, given.warm_up)
        samples = compare(plan, given.actors, given.modes, given.repeats, given.reference)
    except ReskpnError as error:
        print(f"service: {error}", file=sys.stderr)
        return error.exit_code
    print(
        f"{given.task}, {given.learner}: {given.num_envs} environments x {given.num_steps} steps, "
        f"{given.updates} updates of which the first {given.warm_up} are left out"
    )
    for line in (*describe(found), "", *speed_table(samples), "", *phase_table(samples)):
        print(line)
    if given.json:
        content = {side: [asdict(sample) for sample in taken] for side, taken in samples.items()}
        record = {"machine": found, "options": settings, "warm_up": given.warm_up, "samples": content}
        given.json.write_text(json.dumps(record, indent=2) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.service",
        description="Speed of a run in one process and through the service, and where an update's time goes. "
        "Further options are settings for both, such as --algorithm.hidden 64,64.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--task", default="hopper", help="environment")
    parser.add_argument("--learner", default="dpo", help="algorithm")
    parser.add_argument("--physics", default="auto", help="engine")
    parser.add_argument("--num-envs", type=int, default=2048, metavar="N", help="environments over all actors")
    parser.add_argument("--num-steps", type=int, default=10, metavar="N", help="steps of each for one update")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of every run")
    parser.add_argument("--updates", type=int, default=UPDATES, metavar="N", help="updates of every run")
    parser.add_argument("--warm-up", type=int, default=WARM_UP, metavar="N", help="first updates, not measured")
    parser.add_argument(
        "--actors", type=int, nargs="+", default=[1, 2], metavar="N", help="numbers of actors to measure"
    )
    parser.add_argument("--modes", nargs="+", choices=MODES, default=MODES, help="modes to measure with each number")
    parser.add_argument("--reference", action="store_true", help="measure benchmarks.reference, too")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="runs of each kind, in turns")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every sample there, too")
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""Times of updates on this process's device: learners, and the precision of their products.

On a GPU, JAX multiplies float32 matrices in TF32 where a program names no precision, so that is what a run does; the
kernel's own products name full precision. "float32" is full precision for all of them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from benchmarks.gpu.cases import CENTRES
from benchmarks.gpu.rows import plan_of, tell
from benchmarks.update import Case, Subject, in_turns
from common.runtime import enable_compilation_cache

PPO = Case("ppo", None)
PAPER = Case(f"exact n=1 M={CENTRES}", {"samples": 1, "capacity": CENTRES})
LEARNERS = (
    PAPER,
    Case(f"exact n=5 M={CENTRES}", {"samples": 5, "capacity": CENTRES}),
    Case("rff n=B M=256", {"representation": "rff", "samples": "batch", "capacity": 256, "step": "trust-region"}),
    Case("exact n=1 M=256", {"samples": 1, "capacity": 256}),
)
PRECISIONS: dict[str, dict[str, Any]] = {
    "TF32": {"products": "tensorfloat32"},
    "bfloat16": {"products": "tensorfloat32", "precision": "bfloat16"},
    "float32": {"products": "float32"},
}
"""What a case is changed by, by the name of the precision in the report."""


def usual() -> Iterator[tuple[str, Case, list[Case]]]:
    """Precision, PPO in it, and the cases that are compared with that."""
    for name, changes in PRECISIONS.items():
        others = LEARNERS if name == "TF32" else (PAPER,)
        yield name, replace(PPO, **changes), [replace(case, **changes) for case in others]


def whole(batch: int) -> Iterator[tuple[str, Case, list[Case]]]:
    """The whole batch as centres; the name of the case says how many these are."""
    changes = PRECISIONS["TF32"]
    case = Case(f"exact n=B M={batch}", {"samples": "batch", "capacity": batch})
    yield "TF32", replace(PPO, **changes), [replace(case, **changes)]


def measure(plan: Mapping[str, Any]) -> None:
    """Tell a row for each case as soon as it is known; each is timed in turns with PPO in the same precision."""
    sizes = plan["sizes"]
    groups = usual() if plan["which"] == "usual" else whole(sizes["num_envs"] * sizes["num_steps"])
    for precision, first, others in groups:
        ppo, compile_s = compiled(first, plan["task"], sizes)
        (alone,) = in_turns([ppo], plan["rounds"])
        row(plan, precision, alone, compile_s)
        for case in others:
            subject, compile_s = compiled(case, plan["task"], sizes)
            row(plan, precision, in_turns([ppo, subject], plan["rounds"])[1], compile_s)
            del subject  # its state would take the memory of the next


def compiled(case: Case, task: str, sizes: Mapping[str, Any]) -> tuple[Subject, float]:
    """A case ready to be timed, and the seconds that it took to get there."""
    began_s = time.perf_counter()
    return Subject(case, task, sizes), time.perf_counter() - began_s


def row(plan: Mapping[str, Any], precision: str, found: Mapping[str, Any], compile_s: float) -> None:
    tell(
        task=plan["task"],
        case=found["case"],
        precision=precision,
        ms=1e3 * found["seconds"],
        by_ppo=found["ratio"],
        compile_s=compile_s,
    )


if __name__ == "__main__":
    enable_compilation_cache()
    measure(plan_of())

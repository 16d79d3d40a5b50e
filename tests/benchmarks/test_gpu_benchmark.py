"""`make bench-gpu`: cases in processes of their own, within a budget, and results that outlive a kill."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gpu import __main__ as command
from benchmarks.gpu import physics_case, service_case, update_case
from benchmarks.gpu.cases import CENTRES, FULL, SMALL, WARP, Case, Scale, cases, physics
from benchmarks.gpu.report import Facts, lines, write
from benchmarks.gpu.rows import MARK, plan_of, row_in
from benchmarks.gpu.session import LEAST_S, Outcome, environment_of, run_all
from common.errors import SettingsError

pytestmark = pytest.mark.usefixtures("in_a_hurry")

MACHINE = dict.fromkeys(("python", "jax", "jaxlib", "mujoco", "mujoco-mjx", "brax", "eclipse-zenoh"), "1.2") | {
    "date": "2026-01-02 03:04",
    "cores": "2",
    "cpu": "A CPU",
    "load": "0.1",
    "commit": "abcdef0123456789",
}
FACTS = Facts(
    {"backend": "gpu", "devices": "A GPU", "memory": "10 GiB", "driver": ""}, MACHINE, "full", FULL.sizes, 9.0
)


@dataclass(frozen=True)
class Script(Case):
    """A case that runs a script in place of a measurement."""

    script: str = ""

    def words(self, scale: Scale) -> list[str]:
        return ["-c", self.script]


def script(name: str, text: str, limit_s: float = 60.0) -> Script:
    return Script(name, "physics", {}, limit_s, script=text)


def ran(*scripts: Script, budget_s: float = 1e3, **more: Any) -> tuple[list[Outcome], list[list[int]]]:
    """The outcomes, and the numbers of rows that were there whenever results were kept."""
    kept: list[list[int]] = []

    def keep(outcomes: list[Outcome]) -> None:
        kept.append([len(outcome.rows) for outcome in outcomes])

    return run_all(scripts, SMALL, cpu=True, budget_s=budget_s, keep=keep, **more), kept


ROW = '{"a": 1}'
WARP_ROW = '{"task": "hopper", "engine": "warp", "envs": 4, "note": "not installed"}'
ONE_ROW = f"print('words of a library'); print({MARK!r} + {ROW!r})"


def test_a_case_that_fails_does_not_stop_the_rest() -> None:
    """Its last words are its reason, and the next case runs; what was told is kept at once."""
    fails = script("bad", f"{ONE_ROW}; print('no memory', flush=True); raise SystemExit(3)")
    (bad, good), kept = ran(fails, script("good", ONE_ROW))
    assert (bad.state, good.state) == ("failed", "done")
    assert bad.reason.splitlines() == ["exit code 3", "words of a library", "no memory"]
    assert bad.rows == good.rows == [{"a": 1}]
    assert kept[:2] == [[0, 0], [1, 0]]
    assert kept[-1] == [1, 1]


def test_a_case_that_takes_too_long_is_stopped_with_what_it_started() -> None:
    """It keeps its rows; the process that it started is ended, too, or its line would still come."""
    child = "import time; time.sleep(60)"
    text = f"import subprocess, sys; {ONE_ROW}; sys.stdout.flush(); subprocess.run([sys.executable, '-c', {child!r}])"
    (slow,), _ = ran(script("slow", text, limit_s=5.0 / SMALL.patience))
    assert (slow.state, slow.rows) == ("stopped", [{"a": 1}])
    assert slow.reason == "after 5 s, its limit"
    assert slow.seconds < 30.0


def test_results_that_are_kept_while_a_case_runs_say_so() -> None:
    """Whoever kills the command then reads that this case is not whole."""
    kept: list[tuple[str, str]] = []
    keep = lambda outcomes: kept.append((outcomes[0].state, outcomes[0].reason))  # noqa: E731
    run_all([script("good", ONE_ROW)], SMALL, cpu=True, budget_s=1e3, keep=keep)
    assert kept[:2] == [("not run", ""), ("stopped", "it was at work when this was written")]
    assert kept[-1] == ("done", "")


def test_what_the_budget_does_not_reach_is_named() -> None:
    """A case is not begun with less than the least time; one without a row has failed, whatever its exit code."""
    times = iter([0.0, 0.0, 100.0 - LEAST_S + 1.0])
    (silent, late), _ = ran(
        script("silent", "pass"), script("late", ONE_ROW), budget_s=100.0, clock=lambda: next(times)
    )
    assert (silent.state, silent.reason) == ("failed", "exit code 0")
    assert (late.state, late.reason) == ("not run", "the budget of 100 s was used up")


def test_processes_take_the_gpu_only_where_it_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """The native engine has the CPU to itself; nobody reserves memory, and settings of the shell do not count."""
    for name in ("JAX_PLATFORMS", "XLA_PYTHON_CLIENT_PREALLOCATE", "XLA_CLIENT_MEM_FRACTION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("RESKPN_NUM_ENVS", "3")
    on_gpu = environment_of(physics("hopper", "mjx", 1.0), FULL, cpu=False)
    assert "JAX_PLATFORMS" not in on_gpu
    assert "RESKPN_NUM_ENVS" not in on_gpu
    assert on_gpu["XLA_PYTHON_CLIENT_PREALLOCATE"] == "false"
    assert environment_of(physics("hopper", "native", 1.0), FULL, cpu=False)["JAX_PLATFORMS"] == "cpu"
    small = environment_of(physics("hopper", "mjx", 1.0), SMALL, cpu=True)
    assert (small["JAX_PLATFORMS"], small["JAX_DISABLE_MOST_OPTIMIZATIONS"]) == ("cpu", "1")


def test_every_case_is_there_once() -> None:
    """Both tasks with every engine, every precision, every learner, and the paper's centres."""
    found = {case.name: case for case in cases()}
    assert len(found) == len(cases())
    for task in ("hopper", "humanoid"):
        for engine in ("native", "mjx", WARP):
            assert found[f"physics {task} {engine}"].on_cpu is (engine == "native")
        assert f"update {task}" in found
        native, mjx = found[f"service {task} native n=1"], found[f"service {task} mjx n=1"]
        assert (native.plan["mode"], mjx.plan["mode"]) == ("async", "sync")
        assert native.plan["settings"][-2:] == ["--rkhs.capacity", "2441"]
    assert {"ppo", "n=5", "whole batch"} <= {name.removeprefix("service humanoid mjx ") for name in found}
    assert set(update_case.PRECISIONS) == {"TF32", "bfloat16", "float32"}
    assert {case.name for case in update_case.LEARNERS} >= {f"exact n=1 M={CENTRES}", f"exact n=5 M={CENTRES}"}


def test_a_process_is_told_what_its_case_says() -> None:
    """The plan travels as one word, and settings become options of `reskpn train`."""
    case = next(case for case in cases() if case.name == "service hopper native n=1")
    plan = plan_of([case.words(SMALL)[-1]])
    assert (plan["actors"], plan["mode"], plan["updates"]) == (2, "async", SMALL.updates)
    assert service_case.options({"num_envs": 8, "algorithm": {"hidden": [4, 4], "epochs": 1}}) == [
        *("--num-envs", "8", "--algorithm.hidden", "4,4", "--algorithm.epochs", "1")
    ]


# -- what is measured --------------------------------------------------------------------------------------

SIZES = {"num_envs": 4, "num_steps": 2, "algorithm": {"hidden": [4, 4], "minibatches": 2, "epochs": 1}}


@pytest.fixture
def rows(capsys: pytest.CaptureFixture[str]) -> Callable[[], list[dict[str, Any]]]:
    """The rows that were told in this process."""

    def told() -> list[dict[str, Any]]:
        return [row for line in capsys.readouterr().out.splitlines() if (row := row_in(line)) is not None]

    return told


def test_updates_are_timed_in_turns_with_ppo(
    monkeypatch: pytest.MonkeyPatch, rows: Callable[[], list[dict[str, Any]]]
) -> None:
    """One row each, by PPO in the same precision; the products have the precision of the row."""
    made: list[tuple[str, str | None, str]] = []
    compile_ = update_case.compiled

    def compiled(case: Any, *rest: Any) -> Any:
        made.append((case.name, case.products, case.precision))
        return compile_(case, *rest)

    monkeypatch.setattr(update_case, "compiled", compiled)
    monkeypatch.setattr(update_case, "LEARNERS", ())
    monkeypatch.setattr(update_case, "PAPER", update_case.Case("paper", {"samples": 1, "capacity": 4}))
    monkeypatch.setattr(update_case, "PRECISIONS", {"bfloat16": update_case.PRECISIONS["bfloat16"]})
    update_case.measure({"task": "hopper", "which": "usual", "rounds": 1, "sizes": SIZES})
    ppo, paper = rows()
    assert made == [("ppo", "tensorfloat32", "bfloat16"), ("paper", "tensorfloat32", "bfloat16")]
    assert (ppo["case"], ppo["precision"], ppo["by_ppo"]) == ("ppo", "bfloat16", 1.0)
    assert paper["case"] == "paper"
    assert paper["ms"] > 0.0
    assert paper["by_ppo"] > 0.0


def test_physics_of_the_native_engine(rows: Callable[[], list[dict[str, Any]]]) -> None:
    """The same measurement as `benchmarks.physics`."""
    physics_case.measure({"task": "hopper", "engine": "native", "steps": 2, "repeats": 1, "sizes": SIZES})
    (row,) = rows()
    assert (row["task"], row["engine"], row["envs"], row["diverged"]) == ("hopper", "native", 4, 0)
    assert row["steps_s"] > 0.0


def test_warp_that_is_not_installed_is_said(
    monkeypatch: pytest.MonkeyPatch, rows: Callable[[], list[dict[str, Any]]]
) -> None:
    """It is no failure, and the row says how to get it."""
    monkeypatch.setattr(physics_case, "find_spec", lambda name: None)
    physics_case.measure({"task": "hopper", "engine": WARP, "steps": 2, "repeats": 1, "sizes": SIZES})
    (row,) = rows()
    assert row["note"].startswith("not installed")
    assert "| hopper | warp | 4 | - | - | - | not installed" in "\n".join(
        lines(FACTS, [Outcome("physics hopper warp", "physics", "done", rows=[row])])
    )


# -- the report --------------------------------------------------------------------------------------------


def test_results_are_tables_with_device_date_and_versions(tmp_path: Path) -> None:
    """What was not measured stands below, in a line; the JSON has all of it."""
    service = {
        "settings": ["--task", "hopper"], "mode": "async", "actors": 2, "steps_s": 2e6, "minutes_of_paper": 0.4,
        "ms": {"update": 10.0, "learner": 7.25, "wait": 1.0, "publish": 1.0, "policy": 2.0, "push": 3.0},
    }  # fmt: skip
    update = {"task": "hopper", "case": "ppo", "precision": "TF32", "ms": 1.26, "by_ppo": 1.0, "compile_s": 3.2}
    outcomes = [
        Outcome("update hopper", "update", "stopped", 5.0, "after 5 s, its limit", [update]),
        Outcome("service hopper", "service", "done", 5.0, "", [service]),
        Outcome("physics hopper mjx", "physics", "failed", 1.0, "exit code 1\n  out of memory"),
    ]
    write(tmp_path, FACTS, outcomes)
    text = (tmp_path / "results.md").read_text()
    assert text.startswith("# A GPU, 2026-01-02 03:04\n")
    assert "gpu, A GPU, 10 GiB; driver unknown" in text
    assert "commit abcdef012345; python 1.2, jax 1.2" in text
    assert "| hopper | ppo | TF32 | 1.3 | 1.00 | 3 s |" in text
    # physics is no phase of its own with MJX; 5e7 steps at 2e6 a second take 25 s, 0.4 minutes
    assert "| task hopper | async | 2 | 2,000,000 | 0.4 min | 10.0 | 1.0 | 7.2 | 1.0 | - | 2.0 | 3.0 |" in text
    assert "- physics hopper mjx: failed: exit code 1 / out of memory" in text
    assert "- update hopper: stopped: after 5 s, its limit" in text
    assert "service hopper:" not in text
    found = json.loads((tmp_path / "results.json").read_text())
    assert [case["state"] for case in found["cases"]] == ["stopped", "done", "failed"]
    assert found["cases"][1]["rows"] == [service]
    assert list(tmp_path.glob("*.part")) == []


# -- the command -------------------------------------------------------------------------------------------


def test_without_a_gpu_it_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Before anything is measured; a case that does not exist is refused as well."""
    monkeypatch.setattr(command, "adopt", lambda environment: None)
    monkeypatch.setattr(command, "run_json", lambda module, words: {"backend": "cpu", "devices": "cpu"})
    assert command.main(["--out", str(tmp_path / "out")]) == SettingsError.exit_code
    words = capsys.readouterr().err
    assert "JAX finds no GPU here, only cpu" in words
    assert "requirements/cuda.txt" in words
    assert not (tmp_path / "out").exists()
    assert command.main(["--only", "walker"]) == SettingsError.exit_code
    assert "--only walker: no case is called so; update humanoid, " in capsys.readouterr().err


def test_on_a_cpu_a_case_without_results_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The command's exit code is what CI looks at."""
    monkeypatch.setattr(command, "adopt", lambda environment: None)
    monkeypatch.setattr(command, "device", lambda cpu: FACTS.device)
    good = f"print({MARK!r} + {WARP_ROW!r})"
    monkeypatch.setattr(command, "cases", lambda: [script("good", good), script("bad", "pass")])
    assert command.main(["--device", "cpu", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert "# A GPU" in out
    assert "1 of 2 cases without all results: bad" in err
    assert command.main(["--device", "cpu", "--out", str(tmp_path), "--only", "good"]) == 0


def test_the_probe_names_the_device() -> None:
    """In a process of its own; a CPU has neither a memory limit nor a driver."""
    found = command.run_json("benchmarks.gpu.probe", [])
    assert found["backend"] == "cpu"
    assert found["devices"]
    assert found["memory"] == ""

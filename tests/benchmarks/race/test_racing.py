"""Runs of the race with made-up entrants: given their time, stopped, kept, and not made twice."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from benchmarks.race import __main__ as race_command
from benchmarks.race.entrants import OTHERS, Entrant, Run
from benchmarks.race.records import find, path_of, read_all, read_result
from benchmarks.race.running import race
from common.errors import LogReadError, ProcessError, SettingsError
from reskpn.study.writing import write_result
from tests.benchmarks.race.results import result

SHORT_MINUTES = 0.1
RUNS_ON = """
import json, time
print(json.dumps({"about": {"versions": {}, "settings": {"seed": SEED}}}), flush=True)
print(json.dumps({"at": time.time(), "env_steps": 64, "episodes": 1, "return_sum": 12.0}), flush=True)
time.sleep(600)
"""


class Scripted(Entrant):
    """An entrant that is a few lines of Python."""

    name = "scripted"
    what = "scripted: a few lines"

    def __init__(self, program: str) -> None:
        self._program = program

    def command(self, run: Run) -> list[str]:
        return [sys.executable, "-c", self._program.replace("SEED", str(run.seed))]

    def decided_by(self, task: str) -> Mapping[str, Any]:
        return {"program": self._program}


def test_an_entrant_has_its_time_and_is_stopped() -> None:
    """It would run for ten minutes; what it reported is in the curve."""
    found = race(Scripted(RUNS_ON), "hopper", 7, SHORT_MINUTES, 1)
    assert (found.entrant, found.seed, found.minutes, found.cores) == ("scripted", 7, SHORT_MINUTES, 1)
    assert found.settings == {"seed": 7}
    assert sum(found.curve.episodes) == 1
    assert found.curve.return_at(60 * SHORT_MINUTES) == 12.0
    assert "host" not in found.machine


def test_an_entrant_that_ends_before_its_time_is_an_error_with_its_last_words() -> None:
    with pytest.raises(ProcessError, match=r"ended after \d+ s of 6 with exit code 3; .*\n  no such thing"):
        race(Scripted("import sys; print('no such thing'); sys.exit(3)"), "hopper", 0, SHORT_MINUTES, 1)


def test_more_cores_than_there_are_is_one_sentence() -> None:
    with pytest.raises(SettingsError, match="--cores 999: this process may use"):
        race(Scripted(""), "hopper", 0, SHORT_MINUTES, 999)


def test_runs_are_made_in_turns_and_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Seed by seed, entrant by entrant; a second time nothing is left; more minutes than a result has are made."""
    made: list[tuple[str, int]] = []

    def pretend(entrant: Entrant, task: str, seed: int, minutes: float, cores: int) -> Any:
        made.append((entrant.name, seed))
        return result(entrant.name, seed, [100.0] * int(minutes), task=task)

    monkeypatch.setattr(race_command, "race", pretend)
    words = ["--entrants", "default", "reference", "--seeds", "0", "1", "--minutes", "1", "--results", str(tmp_path)]
    assert race_command.main(words) == 0
    assert made == [("default", 0), ("reference", 0), ("default", 1), ("reference", 1)]
    assert "hopper, seed 0, default: return 100 after 1 min, 60,000 steps; 3 left" in capsys.readouterr().out
    assert race_command.main(words) == 0
    assert len(made) == 4
    words[words.index("--minutes") + 1] = "2"
    assert race_command.main(words) == 0
    assert len(made) == 8
    assert {each.minutes for each in read_all(tmp_path)} == {2}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--entrants", "nobody"], "race: 'nobody' is not a known entrant"),
        (["--tasks", "chess"], "race: 'chess' is not a task of the race"),
        (["--minutes", "0"], "race: --minutes is 0; it must be more than 0"),
    ],
)
def test_bad_options_are_one_sentence(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert race_command.main(words) == SettingsError.exit_code
    assert said in capsys.readouterr().err


def test_a_result_comes_back_as_it_was_written(tmp_path: Path) -> None:
    kept, reference = result("reference", 0, [1.0, 2.0]), OTHERS["reference"]
    write_result(kept, path_of(tmp_path, reference, "hopper", 0))
    assert find(tmp_path, reference, "hopper", 0, 2.0) == kept
    assert find(tmp_path, reference, "hopper", 0, 3.0) is None
    assert find(tmp_path, reference, "hopper", 1, 2.0) is None


@pytest.mark.parametrize("text", ["{", json.dumps({"format": 1}), "[]"])
def test_a_file_that_is_no_result_is_one_sentence(text: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.json"
    path.write_text(text)
    with pytest.raises(LogReadError, match="is not a result of the race of format 1"):
        read_result(path)

"""`reskpn replay`: what it prints of a recorded run, and its exit codes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import UPDATES, Recording, batch, made_up, trainer_settings, write_log

import common.runtime
import services.learner.training.trainer
import services.replay.service
from common.config.settings import RunSettings
from common.errors import NumericsError
from common.log.chain import Chain
from common.log.reader import LogReader
from common.wire.rollout import Rollout
from reskpn.cli import main
from services.learner.reporting.statistics import Episodes
from services.learner.training.checkpoints import list_checkpoints, read_checkpoint

UPDATE_3 = {"value": 0.3, "digest": "state-3"}
"""What the learner below makes of update 3."""


class Learner:
    """In place of the trainer: its states are called as in the made-up log."""

    def __init__(self, settings: RunSettings) -> None:
        self.version = 0

    def compile(self) -> None:
        """Nothing to compile."""

    def update(self, rollouts: Sequence[Rollout]) -> dict[str, float]:
        self.version += 1
        if self.version == 3 and UPDATE_3["digest"] == "":
            raise NumericsError("update 3 made the optimiser not finite")
        return {"train/kl": float(UPDATE_3["value"]) if self.version == 3 else self.version / 10}

    def state_arrays(self) -> dict[str, np.ndarray]:
        return {"version": np.array(self.version, np.int32)}

    def digest(self) -> str:
        return str(UPDATE_3["digest"]) if self.version == 3 else f"state-{self.version}"


@pytest.fixture(autouse=True)
def learner(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(services.learner.training.trainer, "Trainer", Learner)
    monkeypatch.setattr(common.runtime, "enable_compilation_cache", lambda: None)
    before = dict(UPDATE_3)
    yield
    UPDATE_3.update(before)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """With the episodes that ended in update 2, as a learner logs them."""
    made = made_up()
    place, _ = made.of("/update")[1]
    record = Episodes.of(batch(2)).record(2)
    assert record is not None
    return Recording([*made.messages[:place], ("/episode", record), *made.messages[place:]], made.start)


@pytest.fixture
def run_dir(recording: Recording, tmp_path: Path) -> Path:
    return write_log(tmp_path / "x", recording.messages)


Said = Callable[..., tuple[int, str, str]]


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Said:
    """Runs `reskpn replay`: exit code, stdout and stderr."""

    def run(*words: object) -> tuple[int, str, str]:
        code = main(["replay", *map(str, words)])
        printed = capsys.readouterr()
        assert "Traceback" not in printed.out + printed.err
        return code, printed.out, printed.err

    return run


# -- verify ------------------------------------------------------------------------------------------------


def test_verify_says_that_all_agree(said: Said, run_dir: Path) -> None:
    """Exit code 0, how many, that it was bit for bit, and how fast against the run."""
    code, out, _ = said(run_dir, "--verify")
    assert code == 0
    assert "all 4 updates agree, bit for bit\n" in out
    assert "versions, hardware and commit are those of the run\n" in out
    assert " s where the run took 3.0 s: " in out
    assert "FALLBACK" not in out


def test_verify_takes_compiled_programs_of_the_runs_number_of_threads(
    said: Said, recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cache is chosen once NPROC is the run's."""
    found: list[str | None] = []
    monkeypatch.setenv("NPROC", "1")
    monkeypatch.setattr(common.runtime, "enable_compilation_cache", lambda: found.append(os.environ.get("NPROC")))
    said(write_log(tmp_path / "a", recording.messages, environment={"NPROC": "7"}), "--verify")
    assert found == ["7"]


def test_verify_says_that_the_chain_holds(said: Said, recording: Recording, tmp_path: Path) -> None:
    """Of a log that has one; of an older log, that it has none."""
    code, out, _ = said(write_log(tmp_path / "a", recording.messages, links=Chain()), "--verify")
    assert code == 0
    assert "the chain holds: 5 records name what was written before them, and the log was closed\n" in out
    code, out, _ = said(write_log(tmp_path / "b", recording.messages), "--verify")
    assert code == 0
    assert "this log has no chain, as those of earlier releases" in out


@pytest.mark.parametrize("topic", ["/event", "/rollout"])
def test_verify_finds_what_no_figure_shows(said: Said, recording: Recording, tmp_path: Path, topic: str) -> None:
    """An event that was removed, or a rollout whose time of sending was changed: exit code 1 and a finding."""
    reader = LogReader(write_log(tmp_path / "a", recording.messages, links=Chain()))
    messages = [(message.topic, message.data) for message in reader.messages()]
    place = next(place for place, (name, _) in enumerate(messages) if name == topic)
    changed = [] if topic == "/event" else [(topic, replace(Rollout.decode(messages[place][1]), t_ns=7).encode())]
    messages[place : place + 1] = changed
    code, out, _ = said(write_log(tmp_path / "b", messages, **reader.metadata()), "--verify")
    assert code == 1
    assert "all 4 updates agree, bit for bit\n" in out
    assert "RECORDS DIFFER: /update 1 was written after other records than those before it" in out


def test_metadata_that_was_changed_is_no_excuse(said: Said, recording: Recording, tmp_path: Path) -> None:
    """Another processor would let other bits pass; in a chained log the change itself is found."""
    reader = LogReader(write_log(tmp_path / "a", recording.messages, links=Chain()))
    messages = [(message.topic, message.data) for message in reader.messages()]
    changed = reader.metadata() | {"hardware": {**reader.metadata()["hardware"], "cpu": "another"}}
    UPDATE_3.update(value=0.30001, digest="other")
    code, out, _ = said(write_log(tmp_path / "b", messages, **changed), "--verify")
    assert code == 1
    assert "FALLBACK" in out
    assert "metadata included" in out


def test_metrics_of_an_equal_state_are_compared(
    said: Said, recording: Recording, run_dir: Path, tmp_path: Path
) -> None:
    """Doubled ones are found, unless the log says that another commit computed them."""
    UPDATE_3.update(value=0.6)
    code, out, _ = said(run_dir, "--verify")
    assert code == 1
    assert "its state is the recorded one, and its metrics are not those that follow from it" in out
    other = {"run": "run-1", "commit": "other"}
    code, out, _ = said(write_log(tmp_path / "b", recording.messages, run=other), "--verify")
    assert code == 0
    assert "metrics differ from update 3 on, while all states are as recorded" in out


def test_verify_shows_the_first_divergence(said: Said, run_dir: Path) -> None:
    """Exit code 1, its version, both digests and the metrics with both values."""
    UPDATE_3.update(value=0.30001, digest="other")
    code, out, _ = said(run_dir, "--verify")
    assert code == 1
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "update 3 DIVERGES; the 2 before it agree, bit for bit" in lines
    assert "state digest recorded state-3" in lines
    assert "state digest recomputed other" in lines
    assert "train/kl 0.3 0.30001" in lines
    assert "all 4" not in out


def test_verify_says_where_no_metric_differs(said: Said, run_dir: Path) -> None:
    """The states do all the same."""
    UPDATE_3["digest"] = "other"
    code, out, _ = said(run_dir, "--verify")
    assert code == 1
    assert "its metrics are the same: the states differ in something that no metric shows" in out


def test_verify_says_why_an_update_could_not_be_applied(said: Said, run_dir: Path) -> None:
    """In place of the digest and the metrics."""
    UPDATE_3["digest"] = ""
    code, out, _ = said(run_dir, "--verify")
    assert code == 1
    assert "none: the update could not be applied\n  update 3 made the optimiser not finite\n" in out


def test_verify_until(said: Said, run_dir: Path) -> None:
    """A divergence after that version is not met."""
    UPDATE_3["digest"] = "other"
    code, out, _ = said(run_dir, "--verify", "--until", 2)
    assert code == 0
    assert "verifying 2 updates" in out
    assert "all 2 updates agree" in out


def test_verify_on_other_hardware_says_what_it_falls_back_to(said: Said, recording: Recording, tmp_path: Path) -> None:
    """A state that differs there is held against the metrics, and that is said with tolerance, place and cause."""
    run_dir = write_log(tmp_path, recording.messages, hardware={"devices": "TPU v9"})
    code, out, _ = said(run_dir, "--verify")
    assert code == 0
    assert "all 4 updates agree, bit for bit" in out
    assert "FALLBACK" not in out
    UPDATE_3.update(value=0.30001, digest="other")
    code, out, _ = said(run_dir, "--verify")
    assert code == 0
    assert "all 4 updates agree: the first 2 bit for bit, 2 in their metrics" in out
    assert "FALLBACK: from update 3 on the states differ in their bits" in out
    assert "within 0.05 + 20% of the recorded value" in out
    assert "updates 1 to 2 were equal bit for bit all the same" in out
    assert "devices: TPU v9 in the log, " in out
    UPDATE_3["value"] = 0.42  # 0.3 + 0.05 + 20% is 0.41
    code, out, _ = said(run_dir, "--verify")
    assert code == 1
    assert "update 3 DIVERGES" in out


def test_another_commit_is_no_excuse(said: Said, recording: Recording, tmp_path: Path) -> None:
    """It is said, and states must be equal."""
    UPDATE_3["digest"] = "other"
    code, out, _ = said(write_log(tmp_path, recording.messages, run={"commit": "abc"}), "--verify")
    assert code == 1
    assert "commit: abc in the log, " in out
    assert "(does not excuse other bits)" in out


def test_a_killed_run_is_verified_as_far_as_it_goes(said: Said, run_dir: Path) -> None:
    """Its last segment has no end, and that is said."""
    (segment,) = (run_dir / "log").glob("*.mcap")
    content = segment.read_bytes()
    segment.write_bytes(content[: content.rindex(b"state-4") + 5])
    code, out, _ = said(run_dir, "--verify")
    assert code == 0
    assert "all 3 updates agree" in out
    assert "00000.mcap has no end: its run was killed or goes on; " in out


# -- extract -----------------------------------------------------------------------------------------------


def test_extract_says_what_it_wrote(said: Said, run_dir: Path, tmp_path: Path) -> None:
    """File by file, with their rows: 9 rollouts of 6 transitions, 2 episodes, 4 updates."""
    code, out, _ = said(run_dir, "--extract", tmp_path / "t", "--format", "parquet")
    assert code == 0
    assert [line.removeprefix(f"{tmp_path}/t/") for line in out.splitlines()] == [
        "rollouts.parquet: 54 rows",
        "episodes.parquet: 2 rows",
        "metrics.parquet: 4 rows",
        "evaluations.parquet: 0 rows",
    ]


def test_extract_takes_all_of_a_log(said: Said, run_dir: Path, tmp_path: Path) -> None:
    """--until belongs to another use of it, and nothing is written."""
    code, _, err = said(run_dir, "--extract", tmp_path / "t", "--until", 2)
    assert code == 2
    assert err == "reskpn replay: --until goes with --verify; the other uses of a log take all of it\n"
    assert not (tmp_path / "t").exists()


# -- publish -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("words", "rate"), [([], 1.0), (["--rate", "2.5"], 2.5), (["--rate", "max"], None)])
def test_publish_plays_at_a_pace(
    said: Said, run_dir: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], rate: float | None
) -> None:
    """The run's, times the rate, on the endpoint given; 130 where it was stopped."""
    calls: list[dict[str, object]] = []
    monkeypatch.setattr(services.replay.service, "run_player", lambda run, where, **how: calls.append(how) or where)
    code, out, _ = said(run_dir, "--publish", "--endpoint", "tcp/127.0.0.1:7999", "--delay", "0", *words)
    assert code == 0
    assert (calls[0]["rate"], calls[0]["delay_s"]) == (rate, 0.0)
    assert "listening on tcp/127.0.0.1:7999" in out
    monkeypatch.setattr(services.replay.service, "run_player", lambda *_, **__: False)
    code, out, _ = said(run_dir, "--publish")
    assert code == 130
    assert out.endswith("run-1: stopped\n")


def test_publish_opens_no_doors(said: Said, run_dir: Path) -> None:
    """An address that other machines reach has to be allowed."""
    code, _, err = said(run_dir, "--publish", "--endpoint", "tcp/0.0.0.0:7999")
    assert code == 2
    assert "can be reached from other machines" in err


def test_a_rate_is_a_pace(capsys: pytest.CaptureFixture[str], run_dir: Path) -> None:
    """Zero is none."""
    with pytest.raises(SystemExit):
        main(["replay", str(run_dir), "--publish", "--rate", "0"])
    assert "'0' is not a pace: give a number above 0, or max" in capsys.readouterr().err


# -- into --------------------------------------------------------------------------------------------------


def test_into_trains_another_learner(said: Said, run_dir: Path, tmp_path: Path) -> None:
    """With the settings of the run but for those given; its metrics are printed and a run directory is left."""
    made = tmp_path / "made"
    words = ("--into", "ppo", "--algorithm.gamma", "0.5", "--run-dir", made)
    code, out, _ = said(run_dir, *words)
    assert code == 0
    assert "training ppo on its 4 updates of experience" in out
    assert "update 4/4 | train/kl 0.4" in out
    summary = json.loads((made / "summary.json").read_text())
    assert (summary["experience_of"], summary["learner"], summary["updates"]) == ("run-1", "ppo", 4)
    assert (summary["total_steps"], summary["metrics"]) == (48, {"train/kl": 0.4})
    settings = json.loads((made / "settings.json").read_text())
    assert settings["learner"] == "ppo"
    assert settings["algorithm"] == trainer_settings().algorithm.model_dump(mode="json") | {"gamma": 0.5}
    assert read_checkpoint(list_checkpoints(made)[0]).version == 4
    code, _, err = said(run_dir, *words)
    assert code == 2
    assert "already holds a run" in err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--into", "trpo"], "learner (from the command line): 'trpo' is not a learner; "),
        (["--into", "ppo", "--num-steps", "6"], "num_steps is 6, but the recorded rollouts were made with 3; "),
        (["--into", "ppo", "--task", "hopper"], "task is 'hopper', but the recorded rollouts were made with 'inver"),
        (["--into", "ppo", "--learner", "dpo"], "--learner goes without --into"),
        (
            ["--verify", "--algorithm.gamma", "0.5"],
            "algorithm.gamma is a setting of a learner; settings go with --into",
        ),
    ],
)
def test_settings_that_another_learner_cannot_have(
    said: Said, run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], sentence: str
) -> None:
    """One sentence, exit code 2, and no directory is made."""
    monkeypatch.chdir(tmp_path)
    code, _, err = said(run_dir, *words)
    assert code == 2
    assert err.startswith(f"reskpn replay: {sentence}")
    assert not (tmp_path / "runs").exists()


# -- what cannot be replayed -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("until", "code", "sentence"),
    [("0", 2, "has updates 1 to 4; give one of them"), ("5", 2, "--until 5: the log of run-1 has updates 1 to 4")],
)
def test_until_is_a_version_of_the_log(said: Said, run_dir: Path, until: str, code: int, sentence: str) -> None:
    """One that is not is refused before anything is computed."""
    found, out, err = said(run_dir, "--verify", "--until", until)
    assert (found, out) == (code, "")
    assert sentence in err


def test_directories_without_a_run(said: Said, recording: Recording, tmp_path: Path) -> None:
    """Absent, empty, or without an update: one sentence each."""
    code, out, err = said(tmp_path / "absent", "--verify")
    assert (code, out) == (5, "")
    assert err.startswith(f"reskpn replay: {tmp_path / 'absent'} does not exist; ")
    code, _, err = said(tmp_path, "--verify")
    assert code == 5
    assert err.startswith(f"reskpn replay: no log in {tmp_path}: ")
    code, _, err = said(write_log(tmp_path / "x", recording.messages[:1]), "--verify")
    assert code == 2
    assert err.endswith("x: the log holds no update yet; there is nothing to replay\n")


def test_a_missing_rollout_is_named(said: Said, recording: Recording, tmp_path: Path) -> None:
    """With the update that used it: exit code 5, for the log is not whole."""
    place, _ = recording.of("/rollout")[-2]  # the last is the one without use
    code, _, err = said(write_log(tmp_path, recording.without(place)), "--verify")
    assert code == 5
    assert f"update {UPDATES} names the rollout of slot 0, incarnation life-0, seq 3, which is not among" in err


def test_one_use_has_to_be_chosen(capsys: pytest.CaptureFixture[str], run_dir: Path) -> None:
    """None is the default."""
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(run_dir)])
    assert ended.value.code == 2
    assert "one of the arguments --verify" in capsys.readouterr().err

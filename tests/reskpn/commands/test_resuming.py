"""`--resume` on the command line: what is gone on with, what is over, and what is refused."""

from __future__ import annotations

import json
import os
import platform
from pathlib import Path
from typing import Any

import pytest

import reskpn.supervision.supervisor
import services.learner.resume.shutdown_notice
import services.learner.service
from common.config.settings import RunSettings, TransportSettings
from common.config.sources import from_values
from common.errors import LogReadError
from common.log.lock import LogLock
from common.log.reader import LogReader
from common.log.writer import LogWriter
from reskpn.cli import main

BASE: dict[str, Any] = {"num_envs": 8, "num_steps": 8, "total_steps": 640, "algorithm": {"minibatches": 2}, "seed": 4}


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("RESKPN_")]:
        monkeypatch.delenv(name)


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, RunSettings, bool]]:
    """Instead of running: which command began, with which settings, and whether it resumes."""
    calls: list[tuple[str, RunSettings, bool]] = []

    def train(
        settings: RunSettings,
        *,
        resume: object = None,
        skip_batch: bool = False,
        page: bool = False,
        trace: object = None,
    ) -> int:
        calls.append(("train without a batch" if skip_batch else "train", settings, resume is not None))
        return 0

    def run_learner(
        settings: RunSettings,
        *,
        stop: object,
        resume: bool = False,
        skip_batch: bool = False,
        lock: object = None,
        origin: object = None,
        trace: object = None,
    ) -> int:
        calls.append(("learner without a batch" if skip_batch else "learner", settings, resume))
        return 0

    monkeypatch.setattr(reskpn.supervision.supervisor, "train", train)
    monkeypatch.setattr(services.learner.service, "run_learner", run_learner)
    return calls


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """A run that was interrupted; its learner listened on port 4000."""
    settings = from_values(BASE | {"transport": {"endpoint": "tcp/127.0.0.1:4000"}})
    with LogWriter(tmp_path / "run" / "log", metadata={"settings": {"json": settings.model_dump_json()}}):
        pass
    return tmp_path / "run"


def test_train_resumes_with_the_settings_of_the_run(begun: list[Any], run_dir: Path) -> None:
    """And chooses a port of its own: of the old processes none is left."""
    assert main(["train", "--resume", str(run_dir)]) == 0
    ((command, settings, resume),) = begun
    assert (command, resume, settings.seed, settings.run_dir) == ("train", True, 4, run_dir)
    assert "endpoint" not in settings.transport.model_fields_set


@pytest.mark.parametrize("command", ["train", "learner"])
def test_a_batch_is_skipped_where_a_run_is_resumed(
    begun: list[Any], run_dir: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    """`--skip-batch` goes with `--resume RUN_DIR`, and is refused without a run that has such a batch."""
    assert main([command, "--resume", str(run_dir), "--skip-batch"]) == 0
    assert [name for name, _, _ in begun] == [f"{command} without a batch"]
    assert main([command, "--skip-batch"]) == 2
    assert "--skip-batch goes with --resume RUN_DIR" in capsys.readouterr().err


@pytest.mark.parametrize("how", [["--resume", "{}"], ["--resume", "auto", "--run-dir", "{}"]])
def test_a_learner_resumes_where_it_was(begun: list[Any], run_dir: Path, how: list[str]) -> None:
    """On the endpoint that its actors know."""
    assert main(["learner", *(word.format(run_dir) for word in how)]) == 0
    ((command, settings, resume),) = begun
    assert (command, resume, settings.seed) == ("learner", True, 4)
    assert settings.transport.endpoint == "tcp/127.0.0.1:4000"


def test_auto_starts_a_run_where_there_is_none(begun: list[Any], tmp_path: Path) -> None:
    """The same command of a container serves both."""
    assert main(["learner", "--resume", "auto", "--run-dir", str(tmp_path / "new"), "--seed", "9"]) == 0
    ((_, settings, resume),) = begun
    assert (resume, settings.seed) == (False, 9)


@pytest.fixture
def newest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The newest of two unfinished runs in runs/, both with these settings but on other ports, made before."""
    monkeypatch.chdir(tmp_path)
    for number, name in enumerate(["old", "new"]):
        run = Path("runs") / name
        settings = from_values(BASE | {"transport": {"endpoint": f"tcp/127.0.0.1:{4000 + number}"}})
        with LogWriter(run / "log", metadata={"settings": {"json": settings.model_dump_json()}}) as log:
            log.write("/event", {"level": "info", "name": "begun", "text": "a run"})
        os.utime(run, (1000.0 + number, 1000.0 + number))
    return tmp_path / "runs" / "new"


SAME = ["--num-envs", "8", "--num-steps", "8", "--total-steps", "640", "--algorithm.minibatches", "2", "--seed", "4"]


def test_auto_goes_on_with_the_newest_run(begun: list[Any], newest: Path) -> None:
    """Without a directory: what a container that is started again is to do."""
    assert main(["learner", "--resume", "auto", *SAME]) == 0
    ((_, settings, resume),) = begun
    assert (resume, settings.run_dir) == (True, newest)


def test_auto_starts_a_run_of_other_settings(begun: list[Any], newest: Path) -> None:
    """What was interrupted is another run then, and stays as it is."""
    assert main(["learner", "--resume", "auto", *SAME[:-1], "5"]) == 0
    assert main(["learner", "--resume", "auto"]) == 0
    assert [(settings.seed, settings.run_dir, resume) for _, settings, resume in begun] == [
        (5, None, False),
        (0, None, False),
    ]


def test_auto_starts_a_run_after_a_finished_one(begun: list[Any], newest: Path) -> None:
    """An older one that was interrupted does not count: someone has gone on to another since."""
    (newest / "summary.json").write_text(json.dumps({"complete": True}))
    os.utime(newest, (2000.0, 2000.0))
    assert main(["learner", "--resume", "auto", *SAME]) == 0
    assert [(settings.run_dir, resume) for _, settings, resume in begun] == [(None, False)]


@pytest.mark.parametrize(("more", "begins"), [([], False), (["--total-steps", "1280"], True)])
def test_a_finished_run(
    begun: list[Any], run_dir: Path, capsys: pytest.CaptureFixture[str], more: list[str], begins: bool
) -> None:
    """Is said to be one, which is no error; with more steps it goes on."""
    (run_dir / "summary.json").write_text(json.dumps({"complete": True}))
    assert main(["train", "--resume", str(run_dir), *more]) == 0
    assert len(begun) == begins
    assert ("this run has finished, with 10 updates; give more --total-steps" in capsys.readouterr().out) is not begins


@pytest.mark.parametrize("how", [["--resume", "{}"], ["--resume", "auto", "--run-dir", "{}"]])
def test_a_finished_run_whose_log_is_not_closed(
    begun: list[Any], run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: list[str]
) -> None:
    """Its learner was killed before its actors had heard that all is done: they are told, and nothing else begins."""
    notified: list[tuple[Path, str]] = []

    def send_shutdown_notice(run_dir: Path, transport: TransportSettings, **_: object) -> None:
        notified.append((run_dir, transport.endpoint))

    monkeypatch.setattr(services.learner.resume.shutdown_notice, "send_shutdown_notice", send_shutdown_notice)
    words = ["learner", *(word.format(run_dir) for word in how)]
    (run_dir / "summary.json").write_text(json.dumps({"complete": True}))
    assert main(words) == 0
    assert notified == []
    (segment,) = (run_dir / "log").glob("*.mcap")
    os.truncate(segment, segment.stat().st_size - 1)
    assert main(words) == 0
    assert notified == [(run_dir, "tcp/127.0.0.1:4000")]
    assert begun == []


@pytest.mark.parametrize("complete", [True, False])
def test_a_damaged_log_is_no_reason_to_begin_another_run_in_silence(
    begun: list[Any], newest: Path, complete: bool
) -> None:
    """Other bytes at the end of a log: who resumes it hears of that. Not if it is over."""
    (segment,) = (newest / "log").glob("*.mcap")
    os.truncate(segment, segment.stat().st_size - 1)
    (torn,) = LogReader(newest).torn
    os.truncate(segment, torn.good_bytes)
    with segment.open("ab") as file:
        file.write(b"\xff" * 4096)
    with pytest.raises(LogReadError):
        _ = LogReader(newest).torn
    (newest / "summary.json").write_text(json.dumps({"complete": complete}))
    os.utime(newest, (2000.0, 2000.0))
    assert main(["learner", "--resume", "auto", *SAME]) == 0
    assert [(settings.run_dir, resume) for _, settings, resume in begun] == [
        (None, False) if complete else (newest, True)
    ]


def test_train_closes_the_log_of_a_finished_run(begun: list[Any], run_dir: Path) -> None:
    """It has no actors from before that would have to be told."""
    (run_dir / "summary.json").write_text(json.dumps({"complete": True}))
    (segment,) = (run_dir / "log").glob("*.mcap")
    os.truncate(segment, segment.stat().st_size - 1)
    assert main(["train", "--resume", str(run_dir)]) == 0
    assert not LogReader(run_dir).torn
    assert begun == []


def test_auto_notifies_the_actors_of_a_run_that_has_just_finished(
    begun: list[Any], newest: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A learner's container that is started again after its kill does not begin another run."""
    notified: list[Path] = []
    monkeypatch.setattr(
        services.learner.resume.shutdown_notice,
        "send_shutdown_notice",
        lambda run_dir, *_, **__: notified.append(run_dir),
    )
    (newest / "summary.json").write_text(json.dumps({"complete": True}))
    (segment,) = (newest / "log").glob("*.mcap")
    os.truncate(segment, segment.stat().st_size - 1)
    os.utime(newest, (2000.0, 2000.0))
    assert main(["learner", "--resume", "auto", *SAME]) == 0
    assert [path.absolute() for path in notified] == [newest]
    assert begun == []


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["train", "--resume", "{}/nowhere"], "no run was begun there; give the directory of a run"),
        (["train", "--resume", "{}", "--seed", "5"], "leave out seed (it is 4, given 5), or start another run"),
    ],
)
def test_what_is_refused(
    begun: list[Any], run_dir: Path, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    """With exit code 2 and a sentence, before anything begins."""
    assert main([word.format(run_dir) for word in words]) == 2
    assert sentence in capsys.readouterr().err
    assert begun == []


@pytest.mark.parametrize("words", [["train", "--resume", "{}"], ["learner", "--resume", "{}"]])
def test_a_run_that_is_being_resumed_is_refused(
    begun: list[Any], run_dir: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    """Before anything of its log is read or repaired, with the process and host that hold it."""
    with LogLock(run_dir / "log"):
        assert main([word.format(run_dir) for word in words]) == 5
    assert f"being written by another process (pid {os.getpid()} on host {platform.node()})" in capsys.readouterr().err
    assert begun == []
    assert main([word.format(run_dir) for word in words]) == 0


def test_a_run_with_links_in_it_is_not_resumed(
    begun: list[Any], run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They could lead anywhere: the link is named, and nothing is written."""
    (tmp_path / "victim").write_text("precious")
    (run_dir / "log" / "00000.mcap.torn").symlink_to(tmp_path / "victim")
    assert main(["train", "--resume", str(run_dir)]) == 5
    assert "00000.mcap.torn is in the way of resuming or repairing: it is a symbolic link" in capsys.readouterr().err
    assert (begun, (tmp_path / "victim").read_text()) == ([], "precious")


def test_auto_chooses_by_what_the_logs_say(begun: list[Any], newest: Path) -> None:
    """Times of directories change when they are copied or looked into; the older run is named, with its command."""
    old = newest.with_name("old")
    os.utime(old, (9000.0, 9000.0))
    assert main(["learner", "--resume", "auto", *SAME]) == 0
    assert [(settings.run_dir, resume) for _, settings, resume in begun] == [(newest, True)]


def test_auto_names_the_unfinished_run_that_it_passes_over(
    begun: list[Any], newest: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where a newer one of the same settings is finished, and a new one is begun."""
    (newest / "summary.json").write_text(json.dumps({"complete": True}))
    assert main(["learner", "--resume", "auto", *SAME]) == 0
    assert [resume for _, _, resume in begun] == [False]
    printed = capsys.readouterr().out
    assert "runs/old has these settings and is not finished" in printed
    assert "continue it with --resume runs/old" in printed


@pytest.mark.parametrize(("seed", "code"), [("4", 5), ("5", 0)])
def test_auto_stops_at_a_log_whose_beginning_is_damaged(
    begun: list[Any], newest: Path, capsys: pytest.CaptureFixture[str], seed: str, code: int
) -> None:
    """It may be the run to continue, unless the settings beside it say that it is another."""
    (segment,) = (newest / "log").glob("*.mcap")
    settings = LogReader(newest).metadata()["settings"]["json"]
    segment.write_bytes(b"\x00" + segment.read_bytes()[1:])
    (newest / "settings.json").write_text(settings)
    (newest.with_name("old") / "summary.json").write_text(json.dumps({"complete": True}))
    assert main(["learner", "--resume", "auto", *SAME[:-1], seed]) == code
    assert ("runs/new may be the run to continue, but it cannot be read" in capsys.readouterr().err) == (code == 5)
    assert len(begun) == (code == 0)


def test_a_path_that_is_too_long_is_a_sentence(begun: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """Not a traceback."""
    assert main(["train", "--resume", "x" * 300]) == 5
    assert "cannot be read: File name too long" in capsys.readouterr().err


def test_a_log_is_repaired_without_resuming(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """So that other programs can read its last file; a second time there is nothing to do."""
    (segment,) = (run_dir / "log").glob("*.mcap")
    os.truncate(segment, segment.stat().st_size - 1)
    assert main(["log", "repair", str(run_dir)]) == 0
    assert f"repaired {segment}: 0 messages are whole" in capsys.readouterr().out
    assert not LogReader(run_dir).torn
    assert main(["log", "repair", str(run_dir)]) == 0
    assert "every file of the log has its end; nothing was to be repaired" in capsys.readouterr().out
    with LogLock(run_dir / "log"):
        assert main(["log", "repair", str(run_dir)]) == 5

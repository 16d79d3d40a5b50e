"""The command line: its help, and a sentence with the right exit code for whatever is wrong."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

import reskpn.supervision.supervisor
import services.actor.service
import services.learner.service
from common.config.presets import PRESETS
from common.config.settings import RunSettings, Section
from common.errors import (
    CheckpointError,
    LogReadError,
    LogWriteError,
    NumericsError,
    PhysicsError,
    ProcessError,
    ReskpnError,
)
from common.wire.endpoint import free_port
from common.wire.keys import JOIN
from common.wire.messages import JoinReply
from common.wire.session import open_session
from reskpn.cli import COMMANDS, main


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """No settings from outside, and JAX as it is: its cache is not moved for the tests after this one."""
    for name in [name for name in os.environ if name.startswith("RESKPN_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("COLUMNS", "120")
    for service in (services.actor.service, services.learner.service):
        monkeypatch.setattr(service, "enable_compilation_cache", lambda: None)


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch) -> list[RunSettings]:
    """Instead of training: the settings that `train` was called with."""
    calls: list[RunSettings] = []

    def train(settings: RunSettings, *, page: bool = False, trace: object = None) -> int:
        calls.append(settings)
        return 0

    monkeypatch.setattr(reskpn.supervision.supervisor, "train", train)
    return calls


Said = Callable[..., tuple[int, str]]


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Said:
    """Runs a command that must fail: its exit code, and what it said on stderr after its own name."""

    def run(*words: str) -> tuple[int, str]:
        code = main(words)
        printed = capsys.readouterr()
        name = f"reskpn {words[0]}: "
        assert printed.err.startswith(name)
        assert printed.err.endswith("\n")
        assert "Traceback" not in printed.out + printed.err
        return code, printed.err.removeprefix(name).removesuffix("\n")

    return run


def left(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[object, str, str]:
    """Exit code, stdout and stderr of a command that argparse ends."""
    with pytest.raises(SystemExit) as ended:
        main(words)
    printed = capsys.readouterr()
    return ended.value.code, printed.out, printed.err


# -- help --------------------------------------------------------------------------------------------------


def test_help_names_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    """With what each is for."""
    code, out, _ = left(capsys, "--help")
    assert code == 0
    assert "train on this machine: a learner and its actors as processes on loopback" in out
    assert "serve one training run; actors connect to it" in out
    assert "collect experience for a learner, from this machine or another" in out
    assert "show how a run and each of its actors are doing, from any machine that reaches the learner" in out
    assert "check this machine before a run" in out
    assert "verify a recorded run, or use its log: extract, publish, train another learner" in out


@pytest.mark.parametrize("command", ["train", "learner", "doctor"])
def test_help_explains_every_setting(capsys: pytest.CaptureFixture[str], command: str) -> None:
    """Each with an option and a line; tasks, learners, precedence and exit codes below. Nothing internal."""
    code, out, _ = left(capsys, command, "--help")
    assert code == 0
    words = " ".join(out.split())
    for name, field in RunSettings.model_fields.items():
        if isinstance(field.default, Section):
            for inner, inner_field in type(field.default).model_fields.items():
                assert f"--{name}.{inner}".replace("_", "-") in out
                assert " ".join((inner_field.description or "missing").split()) in words
        else:
            assert f"--{name.replace('_', '-')}" in out
            assert " ".join((field.description or "missing").split()) in words
    assert "--config FILE" in out
    assert f"({', '.join(PRESETS)})" in words
    for known in ("inverted_pendulum, hopper", "auto, mjx, native", "reskpn", "dpo", "RESKPN_ALGORITHM__GAMMA"):
        assert known in out
    for meaning in (
        "0 done",
        "1 a replay diverged",
        "2 a setting is not possible",
        "3 no connection",
        "130 stopped by Ctrl-C",
    ):
        assert meaning in words
    assert "--supervised" not in out


def test_help_of_an_actor(capsys: pytest.CaptureFixture[str]) -> None:
    """It has few options, for a run's settings come from the learner."""
    code, out, _ = left(capsys, "actor", "--help")
    assert code == 0
    for option in ("--endpoint ADDRESS", "--physics {auto,mjx,native}", "--run", "--threads", "--connect-timeout S"):
        assert option in out
    assert "RESKPN_TRANSPORT__ENDPOINT" in out
    assert "--algorithm" not in out
    assert "--supervised" not in out


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    """Of the installed package; no command is needed."""
    code, out, _ = left(capsys, "--version")
    assert (code, out) == (0, f"reskpn {metadata.version('reskpn')}\n")


def test_the_paper_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    """By its title."""
    _, out, _ = left(capsys, "--help")
    assert "Enhancing Stability and Robustness in RKHS-Based Reinforcement Learning" in " ".join(out.split())


def test_help_loads_no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of commands is all that it needs: what commands work with is loaded by the one that runs."""
    code = (
        "import sys, contextlib\n"
        "from reskpn.cli import main\n"
        "with contextlib.suppress(SystemExit): main(['--help'])\n"
        "heavy = {'jax', 'pydantic', 'pydantic_settings', 'zenoh', 'mujoco', 'rich', 'numpy', 'msgpack', 'yaml'}\n"
        "print(heavy & set(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == "set()\n"


def test_output_that_is_closed_early(tmp_path: Path) -> None:
    """Ends a command that only prints, as it ends other programs: no traceback, and the exit code of SIGPIPE."""
    for number in range(3000):
        (tmp_path / "runs" / f"run-{number:04d}").mkdir(parents=True)
    reader, writer = os.pipe()
    command = [sys.executable, "-m", "reskpn", "runs", "--folder", str(tmp_path / "runs"), "--json"]
    process = subprocess.Popen(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    os.close(reader)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (141, "")


# -- what argparse says ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ([], f"the following arguments are required: {{{','.join(COMMANDS)}}}"),
        (["trian"], "invalid choice: 'trian'"),
        (["train", "--seed"], "argument --seed: expected one argument"),
        (["actor", "--physics", "quick"], "argument --physics: invalid choice: 'quick'"),
        (["actor", "--threads", "all"], "argument --threads: invalid int value: 'all'"),
    ],
)
def test_words_that_are_no_options(
    capsys: pytest.CaptureFixture[str], trained: list[RunSettings], words: list[str], why: str
) -> None:
    """Usage, reason, exit code 2; an option is never guessed from its beginning."""
    code, out, err = left(capsys, *words)
    assert (code, out) == (2, "")
    assert why in err
    assert trained == []


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["train", "--algorithm.gama", "1"], "--algorithm.gama {} of `reskpn train`; did you mean --algorithm.gamma?"),
        (["train", "--algorithm.lr=1"], "--algorithm.lr {} of `reskpn train`; did you mean --algorithm.learning-rate?"),
        (["train", "--num_envs", "4"], "--num_envs {} of `reskpn train`; did you mean --num-envs?"),
        (["train", "--ta", "hopper"], "--ta {} of `reskpn train`; did you mean --task?"),
        (["train", "--resum", "x"], "--resum {} of `reskpn train`; did you mean --resume?"),
        (["train", "--zzz"], "--zzz {} of `reskpn train`; `reskpn train --help` lists all of them"),
        (["train", "hopper"], "hopper {} of `reskpn train`; `reskpn train --help` lists all of them"),
        (["actor", "--seed", "3"], "--seed {} of `reskpn actor`; `reskpn actor --help` lists all of them"),
        (["status", "--endpont", "x"], "--endpont {} of `reskpn status`; did you mean --endpoint?"),
    ],
)
def test_options_that_are_mistyped(said: Said, trained: list[RunSettings], words: list[str], sentence: str) -> None:
    """Answered with the nearest option of the command, in one sentence; never guessed from their beginning."""
    assert said(*words) == (2, sentence.format("(from the command line) is not an option"))
    assert trained == []


def test_a_combination_is_told_with_its_sources(
    said: Said, trained: list[RunSettings], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each setting that the sentence names, and none that it does not name."""
    monkeypatch.setenv("RESKPN_NUM_ENVS", "63")
    monkeypatch.setenv("RESKPN_SEED", "3")
    code, text = said("train", "--actors", "2")
    assert code == 2
    assert text.endswith(" (actors is from the command line, num_envs is from the environment)")


# -- settings ----------------------------------------------------------------------------------------------


def test_settings_reach_the_run(trained: list[RunSettings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From command line, environment and file."""
    file = tmp_path / "a.yaml"
    file.write_text("task: hopper\nseed: 1\nnum_envs: 64\n")
    monkeypatch.setenv("RESKPN_SEED", "2")
    monkeypatch.setenv("RESKPN_ALGORITHM__GAMMA", "0.5")
    code = main(["train", "--config", str(file), "--algorithm.gamma", "0.25", "--total-steps", "1e5"])
    assert code == 0
    (settings,) = trained
    assert (settings.task, settings.num_envs, settings.seed) == ("hopper", 64, 2)
    assert (settings.algorithm.gamma, settings.total_steps) == (0.25, 100_000)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--task", "hoper"], "task (from the command line): 'hoper' is not a task; did you mean 'hopper'? allowed: "),
        (["--learner", "trpo"], "learner (from the command line): 'trpo' is not a learner; "),
        (["--physics", "Native"], "physics (from the command line): 'Native' is not a physics engine; did you mean "),
        (["--rkhs.kernel", "cubic"], "rkhs.kernel (from the command line): 'cubic' is not a kernel; "),
        (["--algorithm.gamma", "2"], "algorithm.gamma (from the command line): '2': Input should be less than or"),
        (["--num-envs", "7"], "num_envs (7) must be a multiple of actors (2): "),
        (["--algorithm.minibatches", "7"], "a batch of 8192 transitions (num_envs 64 x num_steps 128) cannot be "),
        (["--total-steps", "10"], "total_steps (10) is less than one update of 8192 transitions "),
        (["--config", "/nowhere.yaml"], "--config /nowhere.yaml: cannot be read (No such file or directory); "),
    ],
)
def test_settings_that_are_not_possible(
    said: Said, trained: list[RunSettings], words: list[str], sentence: str
) -> None:
    """One sentence, exit code 2, and nothing is begun."""
    code, text = said("train", *words)
    assert code == 2
    assert text.startswith(sentence)
    assert "\n" not in text
    assert trained == []


def test_a_typing_error_in_the_environment(said: Said, trained: list[RunSettings], monkeypatch: Any) -> None:
    """Is found by every command that reads it."""
    monkeypatch.setenv("RESKPN_TSAK", "hopper")
    for command in ("train", "learner", "actor"):
        code, text = said(command)
        assert code == 2
        assert text == "RESKPN_TSAK (from the environment) is not a setting; did you mean RESKPN_TASK?"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (LogWriteError, 5),
        (LogReadError, 5),
        (CheckpointError, 5),
        (PhysicsError, 6),
        (NumericsError, 7),
        (ProcessError, 8),
    ],
)
def test_every_error_has_its_exit_code(
    said: Said, monkeypatch: pytest.MonkeyPatch, error: type[ReskpnError], code: int
) -> None:
    """Those of errors that need a run to happen; its sentence is all that is printed."""

    def train(settings: RunSettings, *, page: bool = False, trace: object = None) -> int:
        raise error("what happened and what to do")

    monkeypatch.setattr(reskpn.supervision.supervisor, "train", train)
    assert said("train") == (code, "what happened and what to do")


def test_a_mistake_of_the_program_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not this package's error keeps its traceback."""

    def train(settings: RunSettings, *, page: bool = False, trace: object = None) -> int:
        raise ZeroDivisionError

    monkeypatch.setattr(reskpn.supervision.supervisor, "train", train)
    with pytest.raises(ZeroDivisionError):
        main(["train"])


# -- the learner -------------------------------------------------------------------------------------------


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


def test_a_port_in_use(said: Said, tmp_path: Path) -> None:
    """Exit code 3, with the port and what to do; no run directory is left behind."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        code, text = said(
            "learner", "--transport.endpoint", f"tcp/127.0.0.1:{port}", "--run-dir", str(tmp_path / "run")
        )
    assert code == 3
    assert text.startswith(f"port {port} of tcp/127.0.0.1:{port} is in use: stop the process that has it, or choose ")
    assert not (tmp_path / "run").exists()


def test_an_open_door(said: Said, tmp_path: Path) -> None:
    """A learner that any machine could reach must be wanted."""
    code, text = said("learner", "--transport.endpoint", "tcp/0.0.0.0:7447", "--run-dir", str(tmp_path / "run"))
    assert code == 2
    assert "transport.endpoint tcp/0.0.0.0:7447 can be reached from other machines" in text
    assert not (tmp_path / "run").exists()


def test_a_run_directory_that_cannot_be(said: Said, tmp_path: Path, endpoint: str) -> None:
    """Below a regular file."""
    (tmp_path / "file").write_text("")
    words = ["--transport.endpoint", endpoint, "--run-dir", str(tmp_path / "file" / "run")]
    code, text = said("learner", *words)
    assert code == 2
    assert text == (
        f"run_dir {tmp_path}/file/run cannot be written (Not a directory); part of the path is a file: choose another "
        "directory, with --run-dir"
    )


@pytest.mark.parametrize("command", ["train", "learner"])
def test_a_run_directory_that_holds_a_run(said: Said, tmp_path: Path, endpoint: str, command: str) -> None:
    """It stays as it is."""
    (tmp_path / "summary.json").write_text("{}")
    code, text = said(command, "--transport.endpoint", endpoint, "--run-dir", str(tmp_path))
    assert code == 2
    assert text.startswith(f"run_dir {tmp_path} already holds a run (summary.json); choose another directory")
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


# -- the actor ---------------------------------------------------------------------------------------------


def test_an_actor_that_finds_nobody(said: Said, endpoint: str) -> None:
    """Exit code 3 after the time it was given, with the likely causes."""
    code, text = said("actor", "--endpoint", endpoint, "--connect-timeout", "0.5", "--physics", "native")
    assert code == 3
    assert text.startswith(f"no connection to {endpoint} within 0.5 s. Likely causes: no learner is running there; ")


def test_an_evaluator_that_finds_nobody(said: Said, endpoint: str) -> None:
    """As an actor."""
    code, text = said("evaluator", "--endpoint", endpoint, "--connect-timeout", "0.5", "--physics", "native")
    assert code == 3
    assert text.startswith(f"no connection to {endpoint} within 0.5 s.")


def test_an_evaluator_with_nothing_to_do(said: Said) -> None:
    """Is refused before it looks for a learner."""
    assert said("evaluator", "--every", "0") == (2, "--every is 0; allowed: 1 or more")


def test_an_actor_with_no_address(said: Said) -> None:
    """An example of one."""
    code, text = said("actor", "--endpoint", "localhost", "--physics", "native")
    assert code == 3
    assert text.startswith("'localhost' is not an address: ")
    assert text.endswith("as in tcp/127.0.0.1:7447")


def test_the_address_may_come_from_the_environment(
    said: Said, endpoint: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Or from a file; the option wins over both."""
    monkeypatch.setenv("RESKPN_TRANSPORT__ENDPOINT", "from-the-environment")
    file = tmp_path / "a.yaml"
    file.write_text("transport: {endpoint: from-the-file}\nphysics: native\n")
    assert said("actor", "--config", str(file))[1].startswith("'from-the-environment' is not an address")
    assert said("actor", "--config", str(file), "--endpoint", "x")[1].startswith("'x' is not an address")
    monkeypatch.delenv("RESKPN_TRANSPORT__ENDPOINT")
    assert said("actor", "--config", str(file))[1].startswith("'from-the-file' is not an address")


@pytest.fixture
def refusing_learner(endpoint: str) -> Iterator[None]:
    """Answers every actor that it is not wanted, for good."""
    reply = JoinReply.refused("r", "run", "this learner runs 'r', not 'q'", final=True).encode()
    with open_session(listen=[endpoint], max_message_size=1 << 20) as session:
        session.serve(JOIN, lambda request: request.reply(reply))
        yield


def test_an_actor_that_is_refused(said: Said, endpoint: str, refusing_learner: None) -> None:
    """Exit code 4, with the learner's reason."""
    code, text = said("actor", "--endpoint", endpoint, "--physics", "native", "--connect-timeout", "15")
    assert (code, text) == (4, "the learner does not take this actor: this learner runs 'r', not 'q'")


def test_signals_are_put_back(said: Said, endpoint: str) -> None:
    """A command run inside a program leaves its handlers alone."""
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    said("actor", "--endpoint", endpoint, "--connect-timeout", "0.1", "--physics", "native")
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    assert "supervisor-watch" not in {thread.name for thread in threading.enumerate()}

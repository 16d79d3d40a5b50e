"""`reskpn train`: processes started, started again and stopped together, with harmless ones in their places."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from common.config.settings import RunSettings
from common.config.sources import load
from common.cores import usable_cores
from common.errors import ProcessError, SettingsError
from common.trace_plan import TracePlan
from common.wire.endpoint import Endpoint
from reskpn.supervision import actors as actors_module
from reskpn.supervision import processes as processes_module
from reskpn.supervision.actors import QUICK_EXITS, ActorSupervisor
from reskpn.supervision.supervisor import resolved, train

DEADLINE_S = 20.0

STAYS = "cat"
"""A process that lives until it is asked to stop, which is when its standard input ends."""


Supervisors = Callable[..., ActorSupervisor]


@pytest.fixture
def until() -> Callable[[Callable[[], object]], None]:
    """Waits until a condition that other processes bring about holds; fails after a deadline."""
    pause = threading.Event()

    def wait(condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, "what was waited for did not happen in time"
            pause.wait(0.005)

    return wait


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Puts shell scripts in the places of `reskpn learner` and `reskpn actor`; $2 is the first option's value."""

    def put(**scripts: str) -> None:
        monkeypatch.setattr(
            processes_module, "reskpn_command", lambda command: ["/bin/sh", "-c", scripts[command], command]
        )

    return put


@pytest.fixture
def supervisors(tmp_path: Path) -> Iterator[Supervisors]:
    """Makes the supervisor of a run's actors; stopped after the test."""
    made: list[ActorSupervisor] = []

    def make(actors: int = 1) -> ActorSupervisor:
        made.append(ActorSupervisor(resolved(RunSettings(actors=actors, run_dir=tmp_path))))
        return made[-1]

    yield make
    for supervisor in made:
        supervisor.stop()


def processes(supervisor: ActorSupervisor) -> list[subprocess.Popen[bytes]]:
    return [actor.process for actor in supervisor.actors if actor.process is not None]


# -- settings ----------------------------------------------------------------------------------------------


def test_the_run_directory_is_absolute(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Its processes may be in other folders; by default it is named by the run."""
    monkeypatch.chdir(tmp_path)
    assert resolved(RunSettings(run_dir=Path("a/b"))).run_dir == tmp_path / "a" / "b"
    by_default = resolved(RunSettings(task="reacher", seed=3)).run_dir
    assert by_default is not None
    assert by_default.parent == tmp_path / "runs"
    assert by_default.name.startswith("reacher-reskpn-s3-")


def test_a_port_is_chosen_where_none_was_asked_for() -> None:
    """So that two runs on one machine do not meet; other settings of the transport count all the same."""
    asked = RunSettings.model_validate({"transport": {"lease_s": 7.0}})
    endpoint = Endpoint.parse(resolved(asked).transport.endpoint)
    assert endpoint.is_loopback
    assert endpoint.port != Endpoint.parse(asked.transport.endpoint).port
    assert resolved(asked).transport.lease_s == 7.0


def test_an_endpoint_that_was_asked_for_is_kept() -> None:
    """Also one that is the default, said aloud."""
    for endpoint in ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:4000"):
        asked = RunSettings.model_validate({"transport": {"endpoint": endpoint}})
        assert resolved(asked).transport.endpoint == endpoint


def test_certificates_are_of_one_process(tmp_path: Path) -> None:
    """`train` starts several, which cannot all be the learner."""
    settings = load(environment={"RESKPN_TRANSPORT__CERTIFICATES": str(tmp_path)})
    with pytest.raises(SettingsError, match=r"use `reskpn learner` and `reskpn actor`, each with its own"):
        train(settings)


def test_everything_else_stays(tmp_path: Path) -> None:
    """Nothing but the directory and the endpoint is changed."""
    asked = RunSettings.model_validate({"seed": 5, "algorithm": {"gamma": 0.5}, "run_dir": tmp_path})
    assert resolved(asked).model_dump(exclude={"transport"}) == asked.model_dump(exclude={"transport"})


# -- the actors --------------------------------------------------------------------------------------------


def test_all_actors_are_started_at_once(stand_in: Callable[..., None], supervisors: Supervisors) -> None:
    """Beside the learner, for which they wait by themselves."""
    stand_in(actor=STAYS)
    supervisor = supervisors(4)
    assert processes(supervisor) == []
    supervisor.keep_alive()
    assert len({process.pid for process in processes(supervisor)}) == 4


def test_actors_that_live_are_left_alone(stand_in: Callable[..., None], supervisors: Supervisors) -> None:
    """However often they are looked after."""
    stand_in(actor=STAYS)
    supervisor = supervisors(2)
    supervisor.keep_alive()
    first = processes(supervisor)
    supervisor.keep_alive()
    assert processes(supervisor) == first
    assert [process.poll() for process in first] == [None, None]


def test_an_actor_that_has_left_is_not_missed(
    stand_in: Callable[..., None], supervisors: Supervisors, until: Callable[..., None]
) -> None:
    """Exit code 0 means that the run is over."""
    stand_in(actor="exit 0")
    supervisor = supervisors()
    supervisor.keep_alive()
    (process,) = processes(supervisor)
    assert process.wait(DEADLINE_S) == 0
    supervisor.keep_alive()
    assert processes(supervisor) == [process]


@pytest.mark.parametrize(("script", "how"), [("kill -9 $$", "signal 9"), ("exit 3", "exit code 3")])
def test_an_actor_that_died_is_started_again(
    stand_in: Callable[..., None],
    supervisors: Supervisors,
    capsys: pytest.CaptureFixture[str],
    script: str,
    how: str,
) -> None:
    """The user is told of it; the others go on."""
    stand_in(actor=STAYS)
    supervisor = supervisors(2)
    supervisor.keep_alive()
    well, ill = processes(supervisor)
    ill.kill()
    ill.wait(DEADLINE_S)
    stand_in(actor=script)
    supervisor.keep_alive()
    assert "actor 1 ended with signal 9; restarting it\n" in capsys.readouterr().err
    assert processes(supervisor)[0] is well
    again = processes(supervisor)[1]
    assert again is not ill
    again.wait(DEADLINE_S)
    stand_in(actor=STAYS)
    supervisor.keep_alive()
    assert f"actor 1 ended with {how}; restarting it\n" in capsys.readouterr().err


@pytest.mark.parametrize("code", [2, 4, 6])
def test_an_actor_that_will_never_work_ends_the_run(
    stand_in: Callable[..., None], supervisors: Supervisors, code: int
) -> None:
    """A setting, a refusal or an engine that is missing is the same the next time: the end of its log file says why."""
    stand_in(actor=f"for i in 1 2 3 4 5 6; do echo word $i; done; echo reason >&2; exit {code}")
    supervisor = supervisors()
    supervisor.keep_alive()
    processes(supervisor)[0].wait(DEADLINE_S)
    with pytest.raises(ProcessError) as ended:
        supervisor.keep_alive()
    log_file = supervisor.log_file(supervisor.actors[0])
    assert str(ended.value) == (
        f"actor 0 ended with exit code {code} and is not restarted; the end of its log file ({log_file}):\n"
        "  word 3\n  word 4\n  word 5\n  word 6\n  reason"
    )
    assert log_file.read_text().splitlines()[0] == "word 1"


def die(supervisor: ActorSupervisor) -> None:
    """Have the one actor started, and wait for its end."""
    supervisor.keep_alive()
    processes(supervisor)[0].wait(DEADLINE_S)


def test_an_actor_that_dies_again_and_again_ends_the_run(
    stand_in: Callable[..., None], supervisors: Supervisors
) -> None:
    """Three quick deaths on end are enough."""
    stand_in(actor="echo no; exit 9")
    supervisor = supervisors()
    for _ in range(QUICK_EXITS):
        die(supervisor)
    with pytest.raises(ProcessError, match=r"actor 0 ended with exit code 9 and is not restarted"):
        supervisor.keep_alive()


def test_deaths_far_apart_do_not_add_up(
    stand_in: Callable[..., None], supervisors: Supervisors, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of days may lose an actor now and then; one that worked for long begins its count anew."""
    stand_in(actor="exit 9")
    supervisor = supervisors()
    die(supervisor)
    die(supervisor)  # one quick death behind it, the second to be found
    monkeypatch.setattr(actors_module, "QUICK_S", 0.0)
    for _ in range(2 * QUICK_EXITS):
        die(supervisor)
    monkeypatch.setattr(actors_module, "QUICK_S", 1000.0)
    # The last of the slow ones was not found yet: it is quick by the new measure, and two more may be.
    for _ in range(QUICK_EXITS - 1):
        die(supervisor)
    with pytest.raises(ProcessError):
        supervisor.keep_alive()


def test_at_the_end_all_are_asked_to_stop(stand_in: Callable[..., None], supervisors: Supervisors) -> None:
    """And have stopped when it is over."""
    stand_in(actor=f"{STAYS}; exit 5")
    supervisor = supervisors(4)
    supervisor.keep_alive()
    supervisor.stop()
    assert [process.returncode for process in processes(supervisor)] == [5, 5, 5, 5]
    supervisor.stop()


def test_who_does_not_stop_is_killed(
    stand_in: Callable[..., None],
    supervisors: Supervisors,
    monkeypatch: pytest.MonkeyPatch,
    until: Callable[..., None],
) -> None:
    """After a time of grace."""
    monkeypatch.setattr(processes_module, "GRACE_S", 0.1)
    stand_in(actor="exec sleep 60")
    supervisor = supervisors(2)
    supervisor.keep_alive()
    supervisor.stop()
    assert [process.returncode for process in processes(supervisor)] == [-signal.SIGKILL] * 2


def test_actors_are_told_where_and_not_what(
    stand_in: Callable[..., None], supervisors: Supervisors, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The learner has the settings, already merged: its variables must not count a second time. The cache's does."""
    monkeypatch.setenv("RESKPN_SEED", "3")
    monkeypatch.setenv("RESKPN_CACHE_DIR", "/somewhere")
    stand_in(actor='echo "$@"; env')
    supervisor = supervisors(2)
    supervisor.keep_alive()
    for process in processes(supervisor):
        process.wait(DEADLINE_S)
    cores = max(1, usable_cores() // 2)
    for number in (0, 1):
        words, *environment = supervisor.log_file(supervisor.actors[number]).read_text().splitlines()
        assert words == f"--endpoint {supervisor.settings.transport.endpoint} --threads {cores}"
        variables = dict(line.split("=", 1) for line in environment if "=" in line)
        assert "RESKPN_SEED" not in variables
        assert variables["RESKPN_CACHE_DIR"] == "/somewhere"


@pytest.mark.parametrize(
    ("physics", "expected"),
    [("native", {"JAX_PLATFORMS": "cpu"}), ("mjx", {"PREALLOCATE": "true", "FRACTION": "0.3"})],
)
def test_actors_are_told_what_they_may_take_of_the_gpu(
    stand_in: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    physics: str,
    expected: dict[str, str],
) -> None:
    """Nothing of it with the native engine, and their share with MJX, in the environment that they are started in."""
    for name in ("JAX_PLATFORMS", "XLA_PYTHON_CLIENT_PREALLOCATE", "XLA_CLIENT_MEM_FRACTION"):
        monkeypatch.delenv(name, raising=False)
    stand_in(
        actor='echo "JAX_PLATFORMS=$JAX_PLATFORMS"; echo "PREALLOCATE=$XLA_PYTHON_CLIENT_PREALLOCATE";'
        'echo "FRACTION=$XLA_CLIENT_MEM_FRACTION"'
    )
    tree = {"actors": 1, "run_dir": tmp_path, "physics": physics, "device_memory": {"actor": 0.3}}
    supervisor = ActorSupervisor(resolved(RunSettings.model_validate(tree)))
    die(supervisor)
    lines = supervisor.log_file(supervisor.actors[0]).read_text().splitlines()
    assert {name: value for name, value in (line.split("=") for line in lines) if value} == expected
    supervisor.stop()


def test_shares_that_do_not_fit_are_refused_before_anything_starts(tmp_path: Path) -> None:
    """0.6 + 2 x 0.3: no directory is left behind."""
    tree = {"physics": "mjx", "run_dir": tmp_path / "run", "device_memory": {"learner": 0.6, "actor": 0.3}}
    with pytest.raises(SettingsError, match=r"make 1\.2 of the GPU"):
        train(RunSettings.model_validate(tree))
    assert not (tmp_path / "run").exists()


# -- the whole ---------------------------------------------------------------------------------------------


def learner_that(tmp_path: Path, then: str) -> str:
    """A learner that keeps the settings it was given as the run's, and then does something."""
    return f'cp "$2" {tmp_path}/given.json; cp "$2" {tmp_path}/settings.json; {then}'


@pytest.mark.parametrize(("then", "code"), [("exit 0", 0), ("exit 2", 2), ("kill -9 $$", 128 + 9)])
def test_the_learners_end_is_the_runs_end(
    stand_in: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str], then: str, code: int
) -> None:
    """Its exit code is the run's; a signal is told as a shell does, with how to go on. Actors are stopped with it."""
    mark = tmp_path / "actor-was-there"
    stand_in(
        learner=learner_that(tmp_path, f"while ! test -e {mark}; do sleep 0.01; done; {then}"),
        actor=f"touch {mark}; cat; touch {tmp_path}/actor-has-left",
    )
    asked = RunSettings.model_validate({"run_dir": tmp_path, "actors": 1, "seed": 4})
    assert train(asked) == code
    hint = f"the learner was ended by signal 9; continue with: reskpn train --resume {tmp_path}"
    assert (hint in capsys.readouterr().err) is (code == 128 + 9)
    assert (tmp_path / "actor-has-left").exists()
    # The learner was given all settings, with the run's directory and the endpoint that was chosen.
    given = load(config=str(tmp_path / "given.json"), environment={})
    assert given.model_dump(exclude={"transport"}) == asked.model_dump(exclude={"transport"})
    assert given.transport.endpoint != asked.transport.endpoint


def test_the_learner_is_told_what_to_trace(stand_in: Callable[..., None], tmp_path: Path) -> None:
    """In the words that its own command line takes."""
    stand_in(learner=f'echo "$@" > {tmp_path}/words', actor=STAYS)
    assert train(RunSettings(run_dir=tmp_path / "run", actors=1), trace=TracePlan(5, 100)) == 0
    assert (tmp_path / "words").read_text().split()[-2:] == ["--trace", "5@100"]


def test_ctrl_c_stops_the_learner_first(
    stand_in: Callable[..., None], tmp_path: Path, until: Callable[..., None]
) -> None:
    """It is asked to, and its exit code is the run's; actors are not started again meanwhile."""
    stand_in(
        learner=learner_that(tmp_path, f"cat; test -e {tmp_path}/actor-has-left && exit 1; exit 130"),
        actor=f"touch {tmp_path}/actor-is-there; cat; touch {tmp_path}/actor-has-left",
    )

    def interrupt() -> None:
        until((tmp_path / "actor-is-there").exists)
        os.kill(os.getpid(), signal.SIGINT)

    interrupter = threading.Thread(target=interrupt)
    interrupter.start()
    assert train(RunSettings(run_dir=tmp_path, actors=1)) == 130
    interrupter.join(DEADLINE_S)
    assert (tmp_path / "actor-has-left").exists()


def test_an_actor_that_cannot_be_kept_alive_stops_the_learner(stand_in: Callable[..., None], tmp_path: Path) -> None:
    """In order: it is asked to, so that its log is whole."""
    stand_in(
        learner=learner_that(tmp_path, f"cat; touch {tmp_path}/learner-has-left; exit 130"),
        actor="echo no engine; exit 6",
    )
    with pytest.raises(ProcessError, match=r"actor 0 ended with exit code 6 and is not restarted(.|\n)*no engine"):
        train(RunSettings(run_dir=tmp_path, actors=1))
    assert (tmp_path / "learner-has-left").exists()


def test_a_directory_that_holds_a_run_is_found_before_anything_starts(
    stand_in: Callable[..., None], tmp_path: Path
) -> None:
    """The older run is not touched."""
    (tmp_path / "summary.json").write_text("older")
    stand_in(learner=f"touch {tmp_path}/started", actor=f"touch {tmp_path}/started")
    with pytest.raises(SettingsError, match=r"already holds a run \(summary\.json\)"):
        train(RunSettings(run_dir=tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


def test_processes_are_out_of_reach_of_the_terminal(stand_in: Callable[..., None], supervisors: Supervisors) -> None:
    """Ctrl-C reaches `train` alone, which stops them in order: each is the leader of a session of its own."""
    stand_in(actor=STAYS)
    supervisor = supervisors()
    supervisor.keep_alive()
    (process,) = processes(supervisor)
    assert os.getsid(process.pid) == process.pid


def test_the_commands_are_this_packages() -> None:
    """By the Python that runs now, and told that they are supervised."""
    command: Any = processes_module.reskpn_command("learner")
    assert command[1:] == ["-m", "reskpn", "learner", "--supervised"]

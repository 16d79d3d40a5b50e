"""`reskpn.train`: a whole run on this machine, as `reskpn train` makes it, from a script or a notebook."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.config.sources import from_values
from common.config.trackers import require_trackers
from common.device_memory import require_room
from common.errors import CodecError, ProcessError, SettingsError, WireError
from common.runs.directory import claim_run_dir
from common.runs.listing import read_summary
from common.wire.credentials import Credentials
from common.wire.report import Progress
from common.wire.status_request import ask, connect
from reskpn.api.run import Run, open_run
from reskpn.commands.settings_options import own_task
from reskpn.supervision.supervisor import refuse_certificates, resolved, supervise

__all__ = ["Progress", "train"]

ASK_EVERY_S = 1.0
ANSWER_S = 1.0
LAST_LINES = 8


def train(
    task: str, learner: str = "reskpn", *, on_progress: Callable[[Progress], None] | None = None, **settings: Any
) -> Run:
    """Train to the end and return the run.

    The learner and its actors are processes of their own; what they print is in the run's folder `processes`. An
    exception, such as KeyboardInterrupt, stops them in good order and leaves a run that `reskpn train --resume`
    continues. Needs no `if __name__ == "__main__"`, and may be called from any thread.

    Args:
        on_progress: called in this thread about once a second, and once at the end.
        settings: any other setting of a run (docs/settings.md), groups as maps: `algorithm={"learning_rate": 1e-4}`.
            Environment variables are not read.

    Raises:
        SettingsError: a setting is not possible.
        ProcessError: the learner or an actor failed; the end of what it printed is in the message.
    """
    chosen = own_task(_settings(task=task, learner=learner, **settings), task)
    refuse_certificates(chosen)
    require_room(chosen)
    require_trackers(chosen.track)
    chosen = resolved(chosen.model_copy(update={"run_dir": claim_run_dir(chosen)}))
    assert chosen.run_dir is not None
    output = chosen.run_dir / "processes" / "learner.txt"
    output.parent.mkdir(exist_ok=True)
    with _Watch.of(chosen, on_progress) as watch, output.open("ab") as file:
        code = supervise(chosen, on_poll=watch.tell, output=file.fileno())
    if code:
        raise _failure(code, output, chosen.run_dir)
    watch.tell_end(chosen.run_dir)
    return open_run(chosen.run_dir)


def _settings(**given: Any) -> RunSettings:
    """SettingsError where they are not possible."""
    try:
        text = json.dumps({name: value for name, value in given.items() if value is not None}, default=_as_text)
    except (TypeError, ValueError) as error:
        raise SettingsError(f"a setting is neither text, number, list nor map ({error})") from None
    return from_values(json.loads(text))


def _as_text(value: Any) -> str:
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__}: {value!r}")


def _failure(code: int, output: Path, run_dir: Path) -> ProcessError:
    last = output.read_text(errors="replace").strip().splitlines()[-LAST_LINES:]
    return ProcessError(
        f"the learner of {run_dir} ended with exit code {code}; the end of its output ({output}):\n"
        + "\n".join(f"  {line}" for line in last)
    )


class _Watch:
    """Asks the learner for its progress on a thread of its own, and tells it where it is polled.

    The learner answers late while it starts and compiles, and actors must be looked after meanwhile.
    """

    def __init__(self, settings: RunSettings, on_progress: Callable[[Progress], None]) -> None:
        self._settings = settings
        self._on_progress = on_progress
        self._stop = threading.Event()
        self._newest: Progress | None = None
        self._told: Progress | None = None

    @classmethod
    @contextmanager
    def of(cls, settings: RunSettings, on_progress: Callable[[Progress], None] | None) -> Iterator[_Watch]:
        watch = cls(settings, on_progress or _nothing)
        thread = threading.Thread(target=watch._run, name="reskpn-progress", daemon=True)
        if on_progress is not None:
            thread.start()
        try:
            yield watch
        finally:
            watch._stop.set()
            if on_progress is not None:
                thread.join()

    def tell(self) -> None:
        """Hand on what is new."""
        newest = self._newest
        if newest is not None and newest is not self._told:
            self._told = newest
            self._on_progress(newest)

    def tell_end(self, run_dir: Path) -> None:
        """Hand on the figures of the finished run, as its summary has them."""
        summary = read_summary(run_dir) or {}
        settings = self._settings
        last = self._told or Progress(
            phase="", text="", version=0, updates=settings.updates, env_steps=0, total_steps=settings.total_steps,
            steps_per_s=None, train_return=None, staleness=0.0,
        )  # fmt: skip
        figures = {
            "version": summary.get("updates", last.version),
            "env_steps": summary.get("total_steps", last.env_steps),
            "train_return": summary.get("train_return_mean", last.train_return),
            "steps_per_s": summary.get("env_steps_per_s", last.steps_per_s),
        }
        self._on_progress(last.model_copy(update={"phase": "finished", "text": "", **figures}))

    def _run(self) -> None:
        transport = self._settings.transport
        credentials = Credentials(users=transport.users)
        while not self._stop.wait(ASK_EVERY_S):
            try:
                with connect(transport.endpoint, ANSWER_S, credentials) as session:
                    while not self._stop.wait(ASK_EVERY_S):
                        self._newest = ask(session, transport.endpoint, ANSWER_S).progress
            except (WireError, CodecError):
                continue  # not there yet, or no longer


def _nothing(_: Progress) -> None:
    """Takes the progress where no caller asks for it."""

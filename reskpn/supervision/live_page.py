"""The live page of `reskpn train --dashboard`: a process beside the run, which goes on whatever becomes of the page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common.config.settings import RunSettings
from common.output import say
from common.wire.listening_socket import address_of, listen
from reskpn.supervision import processes

HOST = "127.0.0.1"


@contextmanager
def live_page(settings: RunSettings) -> Iterator[None]:
    """Serve the page of the run and print its address.

    The socket is opened here, so that the address is known before anything is loaded.

    Raises:
        SessionError: no port is free.
    """
    assert settings.run_dir is not None
    with listen(HOST, None) as listening:
        say(f"live page: {address_of(listening)} (until the run ends; afterwards: {command(settings.run_dir)})")
        log_file = settings.run_dir / "processes" / "dashboard.txt"
        log_file.parent.mkdir(exist_ok=True)
        words = ["--run-dir", str(settings.run_dir), "--listening", str(listening.fileno())]
        if settings.transport.users is not None:
            words += ["--users", str(settings.transport.users)]
        with log_file.open("ab") as output:
            process = processes.start(
                [*processes.reskpn_command("dashboard"), *words], output=output.fileno(), keep=[listening.fileno()]
            )
    try:
        yield
    finally:
        processes.stop_all([process])


def command(run_dir: Path) -> str:
    """The command that shows a run at any time."""
    return f"reskpn dashboard --run-dir {run_dir}"

"""The result of one run of the race: a small JSON file, found again by what decided it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from benchmarks.race.entrants import Entrant
from benchmarks.race.wall import WallCurve
from common.config.kinds import Section
from common.errors import LogReadError

FORMAT = 1

RESULTS = Path("study/race")


class RaceResult(Section):
    """One run.

    Attributes:
        given: the entrant as the command line named it, a file where it is one of settings.
        identity: digest of what decided it besides seed and time (`Entrant.identity`).
        minutes: wall time that it had, from the launch of its process.
        cores: cores that it was given.
        settings, versions: as the entrant tells them.
        load: the machine's load average just before.
    """

    format: int = FORMAT
    entrant: str
    given: str
    task: str
    seed: int
    identity: str
    minutes: float
    cores: int
    settings: dict[str, Any]
    versions: dict[str, str]
    curve: WallCurve
    machine: dict[str, str]
    load: float
    commit: str
    finished_at: str


def path_of(folder: Path, entrant: Entrant, task: str, seed: int) -> Path:
    """Where the result of an entrant's run belongs."""
    return folder / task / f"{entrant.name}-s{seed}-{entrant.identity(task)}.json"


def read_result(path: Path) -> RaceResult:
    """The result in a file; LogReadError where it is none of this format."""
    try:
        return RaceResult.model_validate_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise LogReadError(f"{path} cannot be read ({error.strerror}); give a folder of results of the race") from None
    except (UnicodeDecodeError, ValidationError) as error:
        fault = error.errors(include_url=False)[0]["msg"] if isinstance(error, ValidationError) else "not a text file"
        raise LogReadError(
            f"{path} is not a result of the race of format {FORMAT} ({fault}); move it away, and the race makes it "
            "again"
        ) from None


def find(folder: Path, entrant: Entrant, task: str, seed: int, minutes: float) -> RaceResult | None:
    """The result of such a run that lasted at least so long, or None. LogReadError as `read_result`."""
    path = path_of(folder, entrant, task, seed)
    if not path.exists():
        return None
    result = read_result(path)
    return result if result.minutes >= minutes else None


def read_all(folder: Path) -> list[RaceResult]:
    """All results in a folder, by their files' names. LogReadError as `read_result`."""
    return [read_result(path) for path in sorted(folder.rglob("*.json"))]

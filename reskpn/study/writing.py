"""Writes a result of a study or a race to its file; the origin of a result."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from common.config.kinds import Section
from common.errors import LogWriteError
from common.remedies import remedy
from common.runs.directory import write_json
from common.runtime import hardware, software_versions, source_commit


def origin() -> dict[str, Any]:
    """Where and when a result is made, as fields of `Result`."""
    machine = {name: text for name, text in hardware().items() if name != "host"}
    return {
        "commit": source_commit(),
        "versions": software_versions(),
        "machine": machine,
        "finished_at": now(),
    }


def now() -> str:
    """The time as ISO 8601 text, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def write_result(result: Section, path: Path) -> None:
    """Write it whole or not at all; LogWriteError where it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, result.model_dump(mode="json"), indent=None)
    except OSError as error:
        raise LogWriteError(
            f"{path} cannot be written ({error.strerror or error}); {remedy(error)}, then give the command again: the "
            "results that are there are kept"
        ) from None

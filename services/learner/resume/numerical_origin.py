"""The numerical environment of a run: chosen for a new one, taken over and compared for one that is resumed."""

from __future__ import annotations

from pathlib import Path

from common.log.reader import LogReader
from common.log.segments import LOG_DIRECTORY, list_segments
from common.numerical_environment import adopt, factorise_on_one_thread, numerical_environment
from common.runs.origins import differences, origin
from common.runtime import hardware, software_versions, source_commit


def adopt_numerical_origin(run_dir: Path | None) -> list[str]:
    """Compute with the threads and cores that the run had; returns a sentence for each change and each difference.

    To be called before JAX computes anything.

    Args:
        run_dir: of a run that is resumed; None for a new run.
    """
    if run_dir is None:
        factorise_on_one_thread()
        return []
    if not list_segments(run_dir / LOG_DIRECTORY):
        return []
    metadata = LogReader(run_dir).metadata()
    recorded = metadata.get("environment", {})
    notes = adopt(recorded, metadata.get("hardware", {}).get("cores", ""))
    there = origin(
        metadata.get("run", {}).get("commit", "unknown"),
        metadata.get("versions", {}),
        metadata.get("hardware", {}),
        recorded,
    )
    here = origin(source_commit(), software_versions(), hardware(), numerical_environment())
    found = [difference for difference in differences([there], here) if difference.excuses_bits]
    return notes + [f"warning: not as in the run, so other bits are possible: {difference}" for difference in found]

"""The learner kills itself at the moments at which the most can go wrong, and is resumed at the next.

One run goes through several moments, each of which the fault hits for certain (`faulty.py`): after every death its log
must tell the story of the undisturbed run so far, and in the end all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from common.log.reader import LogReader
from tests.chaos.interruptions import OPTIONS, UPDATES, Apart, Processes, audited, small_options, summary

pytestmark = pytest.mark.timeout(600)

TORN = "tear common.log.segment_writer:_Output.write 25 1000"
"""Half of a group's bytes are in the log, and then nothing."""

IN_AN_UPDATE = {
    "half of a group is in the log": TORN,
    "in the log, and its actor has not heard so": "die after common.log.segment_writer:SegmentWriter.commit 25",
    "the batch is in the log, not used": "die before services.learner.training.trainer:Trainer.update 7",
    "updated, nothing said or written": "die after services.learner.training.trainer:Trainer.update 7",
    "in publishing a snapshot": "die before services.learner.endpoints.monitor:RunMonitor.published 8",
    "the snapshot is out, its update is not in the log": "die before services.learner.loop:TrainingLoop._keep 7",
}

IN_A_CHECKPOINT = {
    "a state is written, and has not its name yet": "die before pathlib:Path.replace 1 00000010.ckpt.part",
    "a state has its name, its environments are not there": "die after pathlib:Path.replace 1 00000020.ckpt.part",
    "its environments are written, and have not their name yet": "die before pathlib:Path.replace 1 00000030.env.part",
    "an old state has lost its environments": "die after pathlib:Path.unlink 3 .env",
}

AT_THE_END = {
    "the last update is made, nothing of it is written": "die before services.learner.loop:TrainingLoop._keep 60",
    "in writing the last state": "die before pathlib:Path.replace 1 00000060.ckpt.part",
    "the evaluation has been asked for": "die after services.learner.endpoints.hub:Hub.ask_for_evaluation 1",
    "evaluated, not written": "die before services.learner.service:conclude 1",
    "in writing the summary": "die before pathlib:Path.replace 1 summary.json.part",
    "the summary is written": "die after pathlib:Path.replace 1 summary.json.part",
}

IN_REPAIRING = {
    "in rewriting the torn log": "die before common.log.segment_writer:SegmentWriter.finish 1",
    "rewritten, and not yet in the torn one's place": "die before os:replace 1 .repair",
    "in writing the settings": "die before pathlib:Path.replace 1 settings.json.part",
}

IN_THE_TAIL = {
    "before the second update of the tail is made again": (
        "die before services.learner.training.trainer:Trainer.update 2"
    ),
    "the next time when it is made again": "die after services.learner.training.trainer:Trainer.update 2",
}


def dies_through(apart: Apart, moments: Mapping[str, str], check: Callable[[str], None]) -> None:
    """The learner that runs has the first fault in it; each of its successors has the next, and the last one none."""
    for moment, following in zip(moments, [*list(moments.values())[1:], None], strict=True):
        apart.learner.die()
        check(moment)
        apart.resume_learner(*([following] if following else []))


def story_so_far(run_dir: Path, undisturbed: list[str]) -> Callable[[str], None]:
    """Checks that what is in the log is how the undisturbed run began."""

    def check(moment: str) -> None:
        digests = audited(run_dir, None)
        assert digests == undisturbed[: len(digests)], moment
        print(f"died at update {len(digests)}: {moment}")

    return check


@pytest.mark.parametrize("moments", [IN_AN_UPDATE, IN_A_CHECKPOINT], ids=["update", "checkpoint"])
def test_killed_in_an_update_and_in_a_checkpoint(
    started: Processes,
    tmp_path: Path,
    undisturbed: list[str],
    found: Callable[[str], None],
    moments: Mapping[str, str],
) -> None:
    """The learner killed between log and update, in publishing, in writing a checkpoint: resumed, the run ends in the
    same state, nothing lost, nothing twice. Its actors stay."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, OPTIONS, learner_faults=[next(iter(moments.values()))])
    dies_through(apart, moments, story_so_far(run_dir, undisturbed))
    apart.end()
    assert audited(run_dir, UPDATES) == undisturbed
    found(f"{len(moments)} deaths in one run, {UPDATES} of {UPDATES} digests equal, 0 lost, 0 twice")


def test_killed_at_the_end(
    started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """The learner killed after the last update, in the evaluation, in writing the summary: resumed, the run ends in the
    same state, is evaluated and has one summary, and its actors hear that it is over."""
    run_dir = tmp_path / "run"
    apart = Apart(
        started, run_dir, small_options(UPDATES, episodes=4), learner_faults=[next(iter(AT_THE_END.values()))]
    )
    dies_through(apart, AT_THE_END, story_so_far(run_dir, undisturbed))
    # The last of them was killed before it notified its actors that the run is over: its successor does only that.
    printed = apart.end()
    assert f"this run has finished, with {UPDATES} updates" in printed
    assert "notifying them" in printed
    assert not LogReader(run_dir).torn, "its log is closed"
    assert audited(run_dir, UPDATES) == undisturbed
    (evaluation,) = [message.json() for message in LogReader(run_dir).messages(["/eval"])]
    assert (evaluation["version"], evaluation["episodes"]) == (UPDATES, 4)
    written = summary(run_dir)
    assert (written["complete"], written["state_digest"]) == (True, undisturbed[-1])
    found(f"{len(AT_THE_END)} deaths in one run, {UPDATES} of {UPDATES} digests equal, 1 evaluation, 1 summary")


def test_killed_in_resuming(
    started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """Killed while the torn log is repaired, and twice while the tail is made again: the next resume ends in the same
    state. All processes are lost at first."""
    run_dir = tmp_path / "run"
    check = story_so_far(run_dir, undisturbed)
    apart = Apart(started, run_dir, OPTIONS, learner_faults=[TORN])
    apart.learner.die()
    apart.lose_actors()
    (torn,) = LogReader(run_dir).torn
    assert torn.dropped_bytes > 0, "the log has a torn end"
    moments = IN_REPAIRING | IN_THE_TAIL
    apart.resume_learner(next(iter(moments.values())))
    for _ in range(2):
        apart.add_actor()
    dies_through(apart, moments, check)
    apart.end()
    assert audited(run_dir, UPDATES) == undisturbed
    assert list((run_dir / "log").glob("*.torn")), "what was torn is kept aside"
    found(f"a torn end and {len(moments)} more deaths, {UPDATES} of {UPDATES} digests equal, 0 lost, 0 twice")

"""What the measurement of losses and returns makes of a log."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.recovery import RUN, Recovery, Timeline, compiled_at_s, run_options, table
from common.errors import SettingsError
from common.log.writer import LogWriter
from services.worker.state_file import state_writer


def write_log(run_dir: Path) -> None:
    """Two actors; that of slot 1 is lost 0.25 s before the third update, and used again in the fourth."""
    with LogWriter(run_dir / "log") as log:
        places = [((0, 0), (1, 0)), ((0, 0), (1, 0)), ((0, 0), (0, 0)), ((0, 0), (1, 1))]
        for at_s, used in zip((10.0, 11.0, 14.0, 20.0), places, strict=True):
            if at_s == 14.0:
                text = "slot 1: abcd is gone"
                log.write("/event", {"level": "warning", "name": "actor_lost", "text": text}, t_ns=13_750_000_000)
            rollouts = [{"slot": slot, "generation": generation} for slot, generation in used]
            log.write("/update", {"rollouts": rollouts}, t_ns=int(at_s * 1e9))


def test_a_loss_and_a_return(tmp_path: Path) -> None:
    """Times are the log's own: of the loss, of the update after it, and of the first that used the successor."""
    write_log(tmp_path)
    found = Timeline.of(tmp_path)
    assert found.updates == [10.0, 11.0, 14.0, 20.0]
    assert found.losses == [(13.75, 1)]
    assert found.first_used == {(0, 0): 10.0, (1, 0): 10.0, (1, 1): 20.0}
    assert found.went_on_s(0) == 0.25


def test_a_run_that_has_not_gone_on_yet() -> None:
    """No update after the loss: there is no figure, rather than one of the wrong update."""
    assert Timeline([10.0, 11.0], [(12.0, 1)], {}).went_on_s(0) is None


def test_when_an_actor_has_compiled(tmp_path: Path) -> None:
    """By its state file, once it says that it does something else."""
    path = tmp_path / "state.json"
    assert compiled_at_s(path) is None
    keep = state_writer(path)
    for state in ("starting", "standing by", "compiling"):
        keep(state, -1)
        assert compiled_at_s(path) is None
    keep("waiting", -1)
    found = compiled_at_s(path)
    assert found is not None
    assert abs(found - path.stat().st_mtime) < 5.0


def test_the_table_says_what_was_promised() -> None:
    """Median and worst of three; the worst decides: 2.5 s is more than the 2 s promised, 1 s less than 3 s."""
    rounds = [Recovery(0.01, 0.5, 0.25), Recovery(0.02, 2.5, 1.0), Recovery(0.03, 0.75, 0.5)]
    noticed, goes_on, used = table(rounds)
    assert "median  0.020 s  worst  0.030 s" in noticed
    assert "promised" not in noticed
    assert goes_on.endswith("median  0.750 s  worst  2.500 s  promised 2 s: NOT met")
    assert used.endswith("median  0.500 s  worst  1.000 s  promised 3 s: met")


def test_settings_that_are_given_win() -> None:
    """Each is there once; one without a value is refused."""
    words = run_options(["--num-envs", "512", "--task", "hopper"])
    assert words.count("--num-envs") == 1
    assert words[words.index("--num-envs") + 1] == "512"
    assert words[words.index("--task") + 1] == "hopper"
    assert len(words) == 2 * (len(RUN) + 1)
    with pytest.raises(SettingsError, match="--task has no value"):
        run_options(["--task"])

"""A new run that begins with the state of another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import batch, trainer_settings
from samples import RUN, settings, update_record

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.runs.initial_state import read_initial_state
from common.wire.messages import Snapshot, digest_arrays
from services.learner.reporting.outlets import Beginning, open_outlets
from services.learner.resume.origin import OWN, Origin, begin_from, read_origin
from services.learner.training.checkpoints import write_checkpoint
from services.learner.training.snapshots import make_snapshot
from services.learner.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("in_a_hurry")


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, np.ndarray]]]:
    """A run of four updates with checkpoints of versions 2 and 3, and the states of versions 0 to 4."""
    run_dir = tmp_path_factory.mktemp("run")
    trainer = Trainer(trainer_settings())
    found = [trainer.state_arrays()]
    with LogWriter(run_dir / "log") as log:
        log.write("/spec", {"run": RUN, "settings": trainer_settings().model_dump(mode="json")})
        for version in (1, 2, 3, 4):
            for one in batch(version):
                log.write("/rollout", one.encode())
            trainer.update(batch(version))
            log.write("/update", update_record(version, trainer.digest(), batch(version)))
            found.append(trainer.state_arrays())
            if version in (2, 3):
                write_checkpoint(run_dir, Snapshot(RUN, version, trainer.digest(), trainer.state_arrays()))
    return run_dir, found


@pytest.mark.parametrize(("asked", "version"), [(None, 3), (3, 3), (4, 4), (1, 1), (0, 0)])
def test_the_state_of_a_version(states: Any, asked: int | None, version: int) -> None:
    """Out of its checkpoint, by default the newest; else computed from the one before it, or from the beginning."""
    run_dir, found = states
    origin = read_origin(run_dir, asked)
    assert (origin.run, origin.version, origin.digest) == (RUN, version, digest_arrays(found[version]))


def test_a_version_that_the_run_does_not_have(states: Any) -> None:
    """Named, with the last that there is."""
    with pytest.raises(SettingsError, match=r"@9: the log of that run ends at version 4"):
        read_origin(states[0], 9)


def changed(**changes: Any) -> RunSettings:
    return RunSettings.model_validate(trainer_settings().model_dump() | changes)


def test_a_new_run_begins_with_it(states: Any) -> None:
    """Networks, optimiser, h and normalisers are the origin's; count, random numbers and environments are its own.

    The learning rate and the number of environments are other ones, as the new run wants them.
    """
    origin = Origin(RUN, 3, states[1][3])
    given = changed(seed=7, actors=1, algorithm=trainer_settings().algorithm.model_dump() | {"learning_rate": 1e-5})
    trainer = Trainer(given)
    own = trainer.state_arrays()
    begin_from(origin, trainer)
    begun = trainer.state_arrays()
    assert trainer.version == 0
    for name, array in begun.items():
        np.testing.assert_array_equal(array, (own if name in OWN else origin.arrays)[name], err_msg=name)


def test_a_state_that_does_not_fit(states: Any) -> None:
    """Refused with what differs and what is to stay."""
    other = settings(learner="reskpn", algorithm={"hidden": (8, 4), "minibatches": 2})
    with pytest.raises(SettingsError, match=r"does not fit these settings: .* Leave task, learner, algorithm.hidden"):
        begin_from(Origin(RUN, 3, states[1][3]), Trainer(other))


def test_the_log_has_the_state_and_its_origin(states: Any, tmp_path: Path) -> None:
    """So that it can be verified and resumed by itself, whatever becomes of the origin."""
    import threading

    given = trainer_settings()
    trainer = Trainer(given)
    origin = Origin(RUN, 3, states[1][3])
    begin_from(origin, trainer)
    state = make_snapshot("new-run", 0, trainer.state_arrays())
    with open_outlets("new-run", given, tmp_path, threading.Event(), beginning=Beginning(origin.record, state)):
        pass
    log = LogReader(tmp_path)
    kept = read_initial_state(log)
    assert kept is not None
    assert (kept.run, kept.version, kept.digest) == ("new-run", 0, trainer.digest())
    expected = {"run": RUN, "version": "3", "state_digest": origin.digest}
    assert log.metadata()["origin"] == expected
    assert next(log.messages(["/spec"])).json()["origin"] == expected

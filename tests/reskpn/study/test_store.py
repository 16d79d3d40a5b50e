"""Results in files: which run a file is of, and files that are none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from common.config.settings import RunSettings
from common.errors import LogReadError, LogWriteError, SettingsError
from reskpn.study import results
from reskpn.study.results import identity
from reskpn.study.store import Store
from reskpn.study.writing import write_result
from tests.reskpn.study.made_up import made_up

SETTINGS = RunSettings(task="hopper", learner="dpo", actors=1)


def changed(**values: object) -> RunSettings:
    return RunSettings.model_validate(SETTINGS.model_dump() | values)


def test_a_result_is_found_by_what_decides_it(store: Store) -> None:
    """Seed and rates do, where the run is kept does not, nor do settings of a part that the learner has not."""
    write_result(made_up(SETTINGS), store.path(SETTINGS))
    found = Store(store.folder)
    assert found.find(changed(run_dir="elsewhere")) is not None
    assert found.find(changed(rkhs={"eta": 0.7})) is not None
    assert found.find(changed(seed=1)) is None
    assert found.find(changed(algorithm={"gamma": 0.9})) is None
    assert found.find(changed(learner="reskpn")) is None


def test_a_result_is_the_same_after_reading(store: Store) -> None:
    """Everything of it, to the last digit."""
    result = made_up(SETTINGS)
    write_result(result, store.path(SETTINGS))
    assert Store(store.folder).find(SETTINGS) == result


def test_a_result_from_before_a_setting_existed(store: Store) -> None:
    """Counts with that setting's default."""
    path = store.path(SETTINGS)
    write_result(made_up(SETTINGS), path)
    kept = json.loads(path.read_text())
    del kept["settings"]["algorithm"]["entropy_coefficient"]
    path.write_text(json.dumps(kept))
    assert Store(store.folder).find(SETTINGS) is not None


def test_a_result_of_an_earlier_revision_counts_as_missing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of kernel learners alone when theirs is raised."""
    kernel = changed(learner="reskpn")
    for settings in (SETTINGS, kernel):
        write_result(made_up(settings), store.path(settings))
    monkeypatch.setitem(results.REVISIONS, "kernel", results.REVISIONS["kernel"] + 1)
    found = Store(store.folder)
    assert (found.find(kernel), found.outdated) == (None, 1)
    assert found.find(SETTINGS) is not None


@pytest.mark.parametrize("content", ["", "{", "[]", '{"format": 1}', "\x80"])
def test_a_file_that_is_no_result(tmp_path: Path, content: str) -> None:
    """One sentence that names it."""
    path = tmp_path / "damaged.json"
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(LogReadError, match=r"damaged\.json is not") as caught:
        Store(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_setting_that_this_version_does_not_know(store: Store) -> None:
    """The result is of a later version; the sentence names the setting."""
    path = store.path(SETTINGS)
    write_result(made_up(SETTINGS), path)
    kept = json.loads(path.read_text())
    kept["settings"]["algorithm"]["momentum"] = 1
    path.write_text(json.dumps(kept))
    with pytest.raises(SettingsError, match=r"algorithm\.momentum"):
        Store(store.folder)


def test_a_full_disk(store: Store) -> None:
    """Is one sentence; no half-written result is left."""
    path = Path("/dev/full/result.json")
    with pytest.raises(LogWriteError, match=r"cannot be written .* the results that are there are kept"):
        write_result(made_up(SETTINGS), path)


def test_identity_is_a_hex_digest() -> None:
    """Of 16 digits, and another one for another seed."""
    assert len(identity(SETTINGS)) == 16
    assert identity(SETTINGS) != identity(changed(seed=1))

"""Recorded runs side by side, and as one page."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from common.config.settings import RunSettings
from common.errors import ReskpnError
from reskpn.study.comparison import compare, load_results
from reskpn.study.curves import Curve
from reskpn.study.recorded import RunRecord, Timeline, result_of
from reskpn.study.report.page import page
from reskpn.study.writing import write_result
from tests.reskpn.study.made_up import made_up

SETTINGS = RunSettings(task="hopper", learner="reskpn", num_envs=64, total_steps=64 * 10 * 4)


def record(run: str = "one", updates: int = 4) -> RunRecord:
    """A run of so many of its 4 updates, one second each, a centre more at each."""
    curve, timeline = Curve(SETTINGS.batch_size), Timeline()
    for update in range(updates):
        metrics = {"rkhs/centres": update + 1.0, "variance/gradient": 2.0, "train/kl": 0.01, "policy/std": 1.0}
        curve.add(np.array([10.0, 20.0]) + update, 1.0, metrics)
        timeline.t_s.append(update + 1.0)
        timeline.seconds.append({"wait": 0.6, "learner": 0.4, "actor/physics": 0.5})
        timeline.staleness.append(0.0)
    metadata = {"run": {"commit": "abc"}, "versions": {"jax": "0.10.2"}, "hardware": {"cpu": "x", "host": "secret"}}
    final = {"env_steps": 640.0 * updates, "return_mean": 30.0, "return_std": 2.0, "source": "run"}
    events = [(0.5, "an actor <joined>: 0123456789abcdef0123456789abcdef")]
    return RunRecord(run, SETTINGS, curve, timeline, metadata, "feed", [final], events)


class Elements(HTMLParser):
    """The tags of a page and the addresses in it."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]


def test_a_page_loads_nothing() -> None:
    """No script, no style sheet, no address but those within the page."""
    text, found = page([record(), record("two")]), Elements()
    found.feed(text)
    assert not {"script", "link", "img", "iframe"} & set(found.tags)
    assert all(address.startswith("#") for address in found.addresses)
    assert not re.findall(r"url\((?!#)", text)


def test_a_page_shows_the_run() -> None:
    """Scores of the curve (10..23, last update 13 and 23), digest, settings, versions, events; not where the run is."""
    text = page([record()])
    for shown in (
        "18.0",
        "16.5",
        "feed",
        "0.10.2",
        "an actor &lt;joined&gt;: 01234567...",
        "rkhs.bandwidth",
        "4 of 4",
        "hopper",
    ):
        assert shown in text, shown
    for private in ("secret", "89abcdef", "transport.endpoint", "run_dir"):
        assert private not in text, private
    assert text.count("<figure>") == 7  # return, variance, centres, KL, std, staleness, timeline; no norm was measured


def test_a_run_that_has_only_begun_is_shown() -> None:
    """One update is enough."""
    assert "1 of 4" in page([record(updates=1)])


def test_a_record_is_a_result() -> None:
    """With the scores that the lean driver would have given."""
    result = result_of(record())
    assert (result.scores.last_tenth, result.scores.area, result.scores.evaluation) == (18.0, 16.5, 30.0)
    assert result.timing.env_steps_per_s == 640.0
    assert (result.digest, result.commit, result.machine) == ("feed", "abc", {"cpu": "x"})


def test_runs_are_named_by_what_they_differ_in(tmp_path: Path) -> None:
    """Seeds are one group; the learner and each setting that differs are in the name."""
    for number, (seed, eta) in enumerate([(0, 0.1), (1, 0.1), (0, 0.3)]):
        tree = SETTINGS.model_dump() | {"seed": seed}
        tree["rkhs"]["eta"] = eta
        write_result(made_up(RunSettings.model_validate(tree)), tmp_path / f"{number}.json")
    groups = compare(load_results([tmp_path]))
    assert {each.name: len(each.results["hopper"]) for each in groups} == {
        "reskpn, rkhs.eta=0.1": 2,
        "reskpn, rkhs.eta=0.3": 1,
    }


@pytest.mark.parametrize("name", ["absent", "empty", "other.json"])
def test_what_is_no_run(tmp_path: Path, name: str) -> None:
    """One sentence that says what may be given."""
    (tmp_path / "empty").mkdir()
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(ReskpnError, match=r"give|is not a result") as caught:
        load_results([tmp_path / name])
    assert "\n" not in str(caught.value)

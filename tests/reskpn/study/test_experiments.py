"""Experiment files: what they may say, and one sentence for what they may not."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.errors import SettingsError
from reskpn.study.drawing.document import MARK
from reskpn.study.experiments import SCALES, Experiment, load_catalogue, load_scale, parse_experiment
from reskpn.study.planning import plan, with_needs
from reskpn.study.store import Store
from tests.reskpn.study.conftest import RATES

PAPER = [
    *(f"Figure {number}" for number in ("1a", "1b", "3", "4", "5a", "5b", "6", "8", "9", *range(10, 19))),
    *(f"Table {number}" for number in (1, 2, 3, 4)),
]


def test_the_catalogue_has_what_the_paper_has() -> None:
    """Each figure and table of the paper that shows results, in its order, then the studies of this project."""
    named = [experiment.paper for experiment in load_catalogue().values()]
    assert [paper for paper in named if paper] == PAPER
    assert named[len(PAPER) :] == [""] * (len(named) - len(PAPER))


@pytest.mark.parametrize("name", load_catalogue())
def test_every_experiment_is_possible_at_smoke_scale(name: str, store: Store) -> None:
    """Its settings are those of runs, and it waits for other results only where it says so."""
    catalogue = load_catalogue()
    planned = plan(catalogue[name], "smoke", catalogue, store)
    assert planned.trials
    assert bool(planned.undecided) == bool(catalogue[name].needs)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("seeds: 2}", "arms: [fats]}", "'fats' is not an arm; did you mean 'fast'?"),
        ("reacher]\narms", "reachr]\narms", "'reachr' is not a task; did you mean 'reacher'?"),
        ("learner: dpo", "learner: dqn", "'dqn' is not a learner"),
        ("kind: scores", "kind: pie", "drawing.kind"),
        ("  smoke: {", "  tiny: {", "'tiny' is not a scale"),
        ("title: Learning rates", "titel: Learning rates", "title"),
        ("tasks: [hopper, reacher]\narms", "tasks: []\narms", "tasks"),
        ("title: Learning rates", "title: [", "not valid YAML"),
    ],
)
def test_a_file_that_is_wrong(old: str, new: str, why: str) -> None:
    """One sentence that names the file and the fault."""
    assert old in RATES
    with pytest.raises(SettingsError) as caught:
        parse_experiment("rates", RATES.replace(old, new))
    assert str(caught.value).startswith("experiment rates: ")
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("setting", "why"),
    [
        ("algorithm.learning_rat", "'algorithm.learning_rat' is not a setting; did you mean 'algorithm.learning_rate'"),
        ("nothing.at_all", "'nothing.at_all' is not a setting"),
        ("algorithm.epochs", "arm slow: algorithm.epochs"),
    ],
)
def test_a_setting_that_no_run_has(setting: str, why: str, store: Store) -> None:
    """Is found when the runs are planned, before any is made."""
    text = RATES.replace("algorithm.learning_rate: 1.0e-4", f"{setting}: 0.5")
    text = text.replace("  smoke: {tasks: [hopper, reacher], seeds: 2}", "  smoke: {seeds: 1}")
    with pytest.raises(SettingsError, match="experiment rates, arm slow") as caught:
        plan(parse_experiment("rates", text), "laptop", {}, store)
    assert why in str(caught.value)


def test_a_scale_that_does_not_exist() -> None:
    """The sentence says which do."""
    with pytest.raises(SettingsError, match=f"'huge' is not a scale; .*{', '.join(SCALES)}"):
        load_scale("huge")


def test_an_experiment_that_does_not_exist(catalogue: dict[str, Experiment]) -> None:
    """Also where another experiment names it."""
    with pytest.raises(SettingsError, match=r"'rate' is not a.* experiment; did you mean 'rates'"):
        with_needs(["rate"], catalogue)
    with pytest.raises(SettingsError, match=r"'widths' is not a.* experiment"):
        with_needs(["choice"], {name: each for name, each in catalogue.items() if name != "widths"})


def test_what_an_experiment_needs_comes_first(catalogue: dict[str, Experiment]) -> None:
    """Each once, whatever the order of the names."""
    assert [each.name for each in with_needs(["choice", "rates"], catalogue)] == ["rates", "widths", "choice"]


def test_the_experiment_of_the_page_is_possible(store: Store) -> None:
    """docs/compare.md shows one; its runs are planned as the page says."""
    page = (Path(__file__).parents[3] / "docs" / "compare.md").read_text(encoding="utf-8")
    shown = parse_experiment("shown", page.partition("```yaml\n")[2].partition("```")[0])
    trials = plan(shown, "laptop", {"shown": shown}, store).trials
    assert len(trials) == 2 * 3 * 5
    assert {(t.settings.learner, t.settings.total_steps) for t in trials} == {("reskpn", 10**6), ("dpo", 10**6)}


def test_every_experiment_has_its_place_in_the_study() -> None:
    """A drawing without marks in docs/study.md would be left out without a word."""
    page = (Path(__file__).parents[3] / "docs" / "study.md").read_text(encoding="utf-8")
    assert [name for name in load_catalogue() if MARK.format(name) not in page] == []

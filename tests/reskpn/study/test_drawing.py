"""Figures and tables, from results alone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from common.errors import SettingsError
from reskpn.study.drawing.curves import common_grid
from reskpn.study.drawing.document import draw_all, insert
from reskpn.study.drawing.draw import Drawn, draw_experiment
from reskpn.study.drawing.side_by_side import draw_side_by_side
from reskpn.study.drawing.tables import Table, aggregate_table, comparable, score_table
from reskpn.study.experiments import Drawing, Experiment, load_catalogue
from reskpn.study.groups import Group, group, series
from reskpn.study.planning import plan
from reskpn.study.store import Store
from reskpn.study.writing import write_result
from tests.reskpn.study.made_up import VERSIONS, fill, made_up


def filled(catalogue: dict[str, Experiment], store: Store, *names: str) -> None:
    for name in names:
        fill(store, plan(catalogue[name], "smoke", catalogue, store).trials)


@pytest.mark.parametrize("name", ["figure-1a", "figure-5a", "figure-6", "figure-8", "figure-10", "table-1", "table-4"])
def test_each_kind_is_drawn_from_results_alone(name: str, store: Store, tmp_path: Path) -> None:
    """SVG with text as text and PNG of a figure, Markdown and CSV of a table."""
    catalogue = load_catalogue()
    filled(catalogue, store, name)
    drawn = draw_experiment(catalogue[name], "smoke", catalogue, store, tmp_path)
    assert drawn is not None
    files = sorted(path.name for path in tmp_path.iterdir() if path.is_file())
    endings = ("csv", "md") if name.startswith("table") else ("png", "svg")
    assert files == [f"{name}.{ending}" for ending in endings]
    if name.startswith("figure"):
        assert "<text" in (tmp_path / f"{name}.svg").read_text()


def test_the_same_results_give_the_same_bytes(catalogue: dict[str, Experiment], store: Store, tmp_path: Path) -> None:
    """So that a figure changes in the repository only when its results do."""
    filled(catalogue, store, "rates")
    for folder in ("one", "two"):
        draw_experiment(catalogue["rates"], "smoke", catalogue, Store(store.folder), tmp_path / folder)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes(), path.name


def test_missing_runs_are_counted(catalogue: dict[str, Experiment], store: Store, tmp_path: Path) -> None:
    """What there is is drawn, and the caption says of how many runs."""
    fill(store, plan(catalogue["rates"], "smoke", catalogue, store).trials, missing=3)
    drawn = draw_experiment(catalogue["rates"], "smoke", catalogue, store, tmp_path)
    assert drawn is not None
    assert drawn.caption == "Learning rates. 5 of 8 runs at scale smoke (2,048 environment steps)."


def test_tables_that_are_no_longer_drawn_go(catalogue: dict[str, Experiment], store: Store, tmp_path: Path) -> None:
    """Of an earlier drawing with more of them; files of other names stay."""
    fill(store, plan(catalogue["rates"], "smoke", catalogue, store).trials)
    for name in ("rates-4.csv", "rates-4.md", "rates-5.csv", "rates-notes.md"):
        (tmp_path / name).write_text("old")
    drawn = draw_experiment(catalogue["rates"], "smoke", catalogue, store, tmp_path)
    assert drawn is not None
    assert len(drawn.tables) == 3
    assert sorted(path.name for path in tmp_path.glob("rates-*")) == [
        *(f"rates-{number}.{suffix}" for number in (2, 3) for suffix in ("csv", "md")),
        "rates-notes.md",
    ]


def test_nothing_to_draw(catalogue: dict[str, Experiment], store: Store, tmp_path: Path) -> None:
    """One sentence with the command that makes the runs; no empty picture."""
    said: list[str] = []
    assert draw_all(["rates"], "smoke", catalogue, store, tmp_path / "out", None, said.append) == {}
    assert said == ["rates: no results at scale smoke; `reskpn paper run rates --scale smoke` makes them"]
    assert not (tmp_path / "out").exists()


def test_results_of_different_versions(catalogue: dict[str, Experiment], store: Store, tmp_path: Path) -> None:
    """Are not drawn together; the sentence says which and how many."""
    trials = plan(catalogue["rates"], "smoke", catalogue, store).trials
    fill(store, trials, missing=1)
    write_result(made_up(trials[-1].settings, versions=VERSIONS | {"mujoco": "3.9"}), store.path(trials[-1].settings))
    mixed = Store(store.folder)
    with pytest.raises(SettingsError, match=r"results of rates .* 7 runs with mujoco 4\.0\.0, 1 with 3\.9"):
        draw_experiment(catalogue["rates"], "smoke", catalogue, mixed, tmp_path)


def test_a_table_of_scores(catalogue: dict[str, Experiment], store: Store) -> None:
    """A row an arm, a column a task, each cell the mean with its interval and the number of runs."""
    filled(catalogue, store, "rates")
    groups = group(catalogue["rates"], plan(catalogue["rates"], "smoke", catalogue, store), store)
    table = score_table(groups, ["hopper", "reacher"])
    assert [row[0] for row in table.rows] == ["Slow", "Fast"]
    assert all(re.fullmatch(r"\d+ \[\d+, \d+\] \(2\)", cell) for row in table.rows for cell in row[1:])


def test_the_reference_has_1(catalogue: dict[str, Experiment], store: Store) -> None:
    """In normalised scores; each of two runs that are all better than its own improves on it with probability 1."""
    filled(catalogue, store, "rates")
    slow, fast = group(catalogue["rates"], plan(catalogue["rates"], "smoke", catalogue, store), store)
    table = aggregate_table([slow, fast], slow)
    assert table is not None
    assert table.rows[0][1].startswith("1.00 ")
    assert table.rows[0][3] == "-"
    assert table.rows[1][3] == "1.00 [1.00, 1.00]"


def test_arms_without_a_task_in_common(catalogue: dict[str, Experiment], store: Store) -> None:
    """Those with the tasks of the widest arm are compared, and the note names the others."""
    filled(catalogue, store, "rates")
    slow, fast = group(catalogue["rates"], plan(catalogue["rates"], "smoke", catalogue, store), store)
    elsewhere = Group("third", "Elsewhere", {"walker2d": fast.results["hopper"], "hopper": []})
    assert comparable([slow, fast], fast) == ([slow, fast], fast)
    assert comparable([elsewhere, slow, fast], elsewhere) == ([slow, fast], slow)
    table = aggregate_table([elsewhere, slow, fast], elsewhere)
    assert table is not None
    assert [row[0] for row in table.rows] == ["Slow", "Fast"]
    assert table.note.endswith("Tasks: hopper, reacher. Left out, without runs of all of these: Elsewhere.")


def test_where_no_episode_terminates_the_reward_is_the_measure(catalogue: dict[str, Experiment], store: Store) -> None:
    """Of reacher: mean reward of a step times the length of an episode (40 at smoke scale); of hopper the return."""
    filled(catalogue, store, "rates")
    _, fast = group(catalogue["rates"], plan(catalogue["rates"], "smoke", catalogue, store), store)
    reacher, hopper = fast.results["reacher"][0], fast.results["hopper"][0]
    assert series(reacher, "return")[1][0] == pytest.approx(40 * (reacher.curve["reward"][0] or 0))
    assert series(hopper, "return")[1][0] == hopper.curve["return"][0]


def test_curves_with_points_of_their_own() -> None:
    """Are put on those of the first, where all have values: y = x at 2 and 3; a run without values is left out."""
    one = (np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 2.0, 3.0, 4.0]))
    two = (np.array([1.5, 3.5]), np.array([1.5, 3.5]))
    grid, runs = common_grid([one, two, (np.zeros(0), np.zeros(0))])
    assert grid.tolist() == [2.0, 3.0]
    assert runs.tolist() == [[2.0, 3.0], [2.0, 3.0]]


def test_a_comparison_writes_four_files(catalogue: dict[str, Experiment], store: Store, tmp_path: Path) -> None:
    """Picture twice, tables, and the points of the curves with their intervals."""
    filled(catalogue, store, "rates")
    groups = group(catalogue["rates"], plan(catalogue["rates"], "smoke", catalogue, store), store)
    files, tables = draw_side_by_side(groups, tmp_path / "rates")
    assert sorted(path.suffix for path in files) == [".csv", ".md", ".png", ".svg"]
    assert len(tables) == 3
    lines = (tmp_path / "rates.csv").read_text().splitlines()
    assert lines[0] == "group,task,env_steps,return,low,high,runs"
    assert len(lines) == 1 + 2 * 2 * 8  # two arms, two tasks, 2,048 steps in updates of 256


TEXT = "# Study\n\n<!-- drawn: rates -->\nold\n<!-- end -->\n\nmore\n"


def test_a_document_gets_its_drawings(tmp_path: Path) -> None:
    """Between the marks, in place of what was there; the rest stays, and doing it again changes nothing."""
    drawn = {
        "rates": Drawn("rates", "Caption.", [tmp_path / "study/rates.svg"], [Table(["", "a"], [["x", "1"]], "Note.")])
    }
    text = insert(TEXT, drawn, tmp_path)
    assert text.startswith("# Study\n\n<!-- drawn: rates -->\n\nCaption.\n\n![rates](study/rates.svg)\n\n|  | a |")
    assert text.endswith("Note.\n\n<!-- end -->\n\nmore\n")
    assert insert(text, drawn, tmp_path) == text


def test_a_mark_without_an_end(tmp_path: Path) -> None:
    """Is refused before anything of the document is lost."""
    with pytest.raises(SettingsError, match="without <!-- end -->"):
        insert("<!-- drawn: rates -->\n", {"rates": Drawn("rates", "Caption.", [], [])}, tmp_path)


def test_one_arm_is_compared_with_nobody(catalogue: dict[str, Experiment], store: Store, tmp_path: Path) -> None:
    """As long as there are runs of one arm alone there are tables, and no panel of comparisons without a row."""
    experiment = catalogue["rates"].model_copy(update={"drawing": Drawing(kind="scores")})
    fill(store, [t for t in plan(experiment, "smoke", catalogue, store).trials if t.arm == "slow"])
    drawn = draw_experiment(experiment, "smoke", catalogue, store, tmp_path)
    assert drawn is not None
    assert (drawn.pictures, len(drawn.tables) > 0) == ([], True)

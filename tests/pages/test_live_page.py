"""The live page as a reader sees it, in a browser."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from dashboard_runs import append, evaluation, settings, update, write_run, write_summary
from page_server import Server
from playwright.sync_api import Page, expect
from reports import report

from common.wire.endpoint import free_port
from common.wire.keys import STATUS
from common.wire.session import Session, open_session

RUN = "hopper-ppo-s0-ab12"
Open = Callable[..., Page]
Serve = Callable[..., Server]

PAINTED = """canvas => {
  const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  const colours = new Set();
  for (let at = 0; at < data.length; at += 4)
    if (data[at + 3] > 200) colours.add(data[at] << 16 | data[at + 1] << 8 | data[at + 2]);
  return colours.size;
}"""
"""Colours of a canvas: axes alone have a handful, a curve adds its own and the shades of its edges."""


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder with two runs."""
    write_run(tmp_path / "runs" / "one", updates=20)
    write_run(tmp_path / "runs" / "two", updates=30, given=settings(learner="ppo", seed=4))
    write_summary(tmp_path / "runs" / "two")
    return tmp_path / "runs"


def learner_at(endpoint: str) -> Session:
    session = open_session(listen=[endpoint], max_message_size=1 << 20)
    session.serve(STATUS, lambda request: request.reply(report(endpoint=endpoint).encode()))
    return session


def figure(page: Page, name: str) -> str:
    """The value of one of the figures, without its note."""
    return page.locator("#figures div", has=page.get_by_text(name, exact=True)).locator("dd").inner_text()


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1280, 400])
def test_every_plot_is_drawn_and_nothing_is_wider_than_the_page(
    runs: Path, server: Serve, open_page: Open, width: int, dark: bool
) -> None:
    """With eleven plots of a run, two of its timeline, the figures, the actors and the events, light and dark."""
    page = open_page(f"{server(runs).address}#run=one", width, dark)
    expect(page.locator("#plots .plot:visible")).to_have_count(11)
    expect(page.locator("#timeline-plots .plot:visible")).to_have_count(2)
    expect(page.locator("#connection")).to_have_text("live")
    for canvas in page.locator(".plot:visible canvas").all():
        assert canvas.evaluate(PAINTED) > 5
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    ground = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    assert (max(map(int, ground.removeprefix("rgb(").removesuffix(")").split(","))) < 60) == dark
    assert figure(page, "update") == "20 of 100"
    assert figure(page, "return, evaluation").startswith("220.0")
    assert page.locator("#actors tbody tr").count() == 2
    assert page.locator("#events li").count() == 1


def test_every_axis_and_figure_says_what_it_is(runs: Path, server: Serve, open_page: Open) -> None:
    """Each plot has a title with a unit and a sentence, each figure a name; the x axis is the chosen one."""
    page = open_page(f"{server(runs).address}#run=one")
    expect(page.locator("#plots .plot:visible")).to_have_count(11)
    for plot in page.locator("#plots .plot:visible").all():
        assert plot.locator("h3 .unit").inner_text().strip(" ·")
        assert plot.locator(".what").inner_text().endswith(".")
    assert all(name.inner_text() for name in page.locator("#figures dt").all())
    axes = {"version": "updates", "hours": "minutes since the start", "env_steps": "environment steps"}
    for axis, label in axes.items():
        page.select_option("#axis", axis)
        expect(page.locator(f".plot:visible[data-axis='{label}']")).to_have_count(13)


def test_it_is_updated_while_the_run_goes_on(runs: Path, server: Serve, open_page: Open) -> None:
    """A new update and a new evaluation appear without being asked for."""
    page = open_page(f"{server(runs).address}#run=one")
    expect(page.locator("#figures")).to_contain_text("20 of 100")
    before = page.locator("#plots canvas").first.evaluate("canvas => canvas.toDataURL()")
    append(runs / "one", *((("/update", update(version))) for version in range(21, 41)), ("/eval", evaluation(40)))
    expect(page.locator("#figures")).to_contain_text("40 of 100")
    expect(page.locator("#figures")).to_contain_text("440.0")
    page.wait_for_timeout(400)
    assert page.locator("#plots canvas").first.evaluate("canvas => canvas.toDataURL()") != before


def test_the_fleet_and_a_learner_that_is_restarted(tmp_path: Path, server: Serve, open_page: Open) -> None:
    """Actors with state and age while it answers; a notice while it does not; the actors again when it is back."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    path = write_run(tmp_path / "run", name=RUN, given=settings(transport={"endpoint": endpoint}))
    with learner_at(endpoint):
        page = open_page(server(path).address)
        expect(page.locator("#actors tbody tr").first).to_contain_text("collecting")
        expect(page.locator("#actors tbody tr").first).to_contain_text("0.3 s ago")
        expect(page.locator("#notice")).to_be_hidden()
    expect(page.locator("#notice")).to_contain_text("waiting for the learner")
    expect(page.locator("#fleet-note")).to_contain_text("The learner cannot be asked from here")
    with learner_at(endpoint):
        expect(page.locator("#actors tbody tr").first).to_contain_text("collecting")
        expect(page.locator("#notice")).to_be_hidden()


def test_a_learner_at_an_address_that_is_restarted(server: Serve, open_page: Open) -> None:
    """The same without its directory: what it publishes is drawn."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    page: Page | None = None
    for version in (8, 9):
        with learner_at(endpoint) as learner:
            page = page or open_page(server(endpoint=endpoint).address)
            publisher = learner.publisher(f"reskpn/v1/{RUN}/metrics")
            title = page.locator("#plots .plot:visible")
            for _ in range(200):
                publisher.put(json.dumps(update(version)).encode())
                if title.count() and f"{10 * version}" in title.first.inner_text():
                    break
                page.wait_for_timeout(100)
            assert f"{10 * version}" in title.first.inner_text()
            expect(page.locator("#actors tbody tr")).to_have_count(2)
        expect(page.locator("#notice")).to_contain_text("waiting for the learner at")


def test_a_dashboard_that_is_restarted(runs: Path, server: Serve, open_page: Open) -> None:
    """An open page says so and goes on by itself."""
    serving = server(runs)
    page = open_page(f"{serving.address}#run=one", expected="Failed to load resource")
    expect(page.locator("#figures")).to_contain_text("20 of 100")
    serving.end()
    expect(page.locator("#connection")).to_have_text("no connection to the dashboard; trying again")
    append(runs / "one", ("/update", update(21)))
    serving.start()
    expect(page.locator("#connection")).to_have_text("live")
    expect(page.locator("#figures")).to_contain_text("21 of 100")


def test_runs_side_by_side(runs: Path, server: Serve, open_page: Open) -> None:
    """Chosen with ticks: a legend with a letter for each, both in each plot, and the figures of the one in focus."""
    page = open_page(f"{server(runs).address}#run=one")
    page.locator("#chooser summary").click()
    expect(page.locator("#choices input:checked")).to_have_count(1)
    page.locator("#choices label", has_text="two").locator("input").click()
    expect(page.locator("#legend button")).to_have_text(["A · one", "B · two"])
    series = page.locator("#plots .plot").first.locator("li")
    expect(series).to_contain_text(["A training", "A evaluation", "B training", "B evaluation"])
    expect(page.locator("#run-title")).to_contain_text("reskpn on hopper")
    page.locator("#legend button", has_text="two").click()
    expect(page.locator("#run-title")).to_contain_text("ppo on hopper")
    expect(page.locator("#figures")).to_contain_text("finished")
    page.locator("#compared summary").click()
    expect(page.locator("#settings tr", has_text="learner")).to_contain_text(["reskpnppo"])
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    page.reload()
    expect(page.locator("#legend button")).to_have_text(["A · one", "B · two"])


def test_text_of_others_is_shown_as_text(tmp_path: Path, server: Serve, open_page: Open) -> None:
    """Of names, events, settings and the learner's report: no element comes of it, and no script runs."""
    evil = '<img src=x onerror="alert(1)"><script>alert(2)</script>'
    path = write_run(tmp_path / "run", given=settings(task=evil, rkhs={"kernel": evil}))
    append(path, ("/event", {"level": "warning", "name": "x", "text": evil}))
    page = open_page(server(path).address)
    expect(page.locator("#events li").first).to_contain_text("<img src=x")
    expect(page.locator("#run-title")).to_contain_text("<img src=x")
    assert page.locator("img, main script").count() == 0


def test_a_page_behind_a_token(runs: Path, server: Serve, open_page: Open) -> None:
    """The address with it works once opened, and no longer shows it."""
    serving = server(runs, token="a-token-of-some-length")
    page = open_page(serving.address)
    expect(page.locator("#connection")).to_have_text("live")
    assert "token" not in page.url


def test_before_there_is_a_run(tmp_path: Path, server: Serve, open_page: Open) -> None:
    """The page waits; the run appears by itself."""
    (tmp_path / "run").mkdir()
    page = open_page(server(tmp_path / "run").address)
    expect(page.locator("#notice")).to_contain_text("waiting for the learner")
    assert page.locator("#plots .plot:visible").count() == 0
    other = write_run(tmp_path / "made")
    for part in other.iterdir():
        part.rename(tmp_path / "run" / part.name)
    expect(page.locator("#plots .plot:visible")).to_have_count(11)


def test_a_damaged_log_is_a_sentence_on_the_page(runs: Path, server: Serve, open_page: Open) -> None:
    segment = runs / "one" / "log" / "00000.mcap"
    data = bytearray(segment.read_bytes())
    data[data.index(b"actor_joined")] ^= 1
    segment.write_bytes(data)
    page = open_page(f"{server(runs).address}#run=one")
    expect(page.locator("#problem")).to_contain_text("00000.mcap is damaged at byte")

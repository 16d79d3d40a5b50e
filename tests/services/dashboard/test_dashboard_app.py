"""The page's routes, its guard, and the stream."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from dashboard_runs import SECRET, append, sse, update
from prometheus_client.parser import text_string_to_metric_families
from reports import report
from starlette.testclient import TestClient

from common.log.lock import LogLock
from services.dashboard import app
from services.dashboard.app import TYPES, Page
from services.dashboard.collection import RunCollection
from services.dashboard.followed_run import FollowedRun
from services.dashboard.security import Guard

TOKEN = "a-token-of-some-length"
ADDRESS = "http://127.0.0.1:6007"


@pytest.fixture
def client(
    make_run: Callable[..., Path], collection: Callable[..., RunCollection], stop: threading.Event
) -> Callable[..., TestClient]:
    """A client of a page with one run, that keeps its cookies and follows no redirections."""
    make_run("one")

    def make(token: str | None = None, names: frozenset[str] = frozenset(), address: str = ADDRESS) -> TestClient:
        guarded = Guard(Page(collection(), stop).application(), token, names, 6007)
        return TestClient(guarded, base_url=address, follow_redirects=False)

    return make


def test_the_page_and_its_files(client: Callable[..., TestClient]) -> None:
    """All from this server, with their types and headers that let nothing else in."""
    page = client()
    for path, name in [("/", "page.html"), *((f"/static/{name}", name) for name in TYPES)]:
        answer = page.get(path)
        assert answer.status_code == 200
        assert answer.headers["Content-Type"] == TYPES[name]
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        assert "unsafe" not in answer.headers["Content-Security-Policy"]
    assert page.get("/static/../app.py").status_code == 404
    assert page.get("/static/%2e%2e%2fapp.py").status_code == 404


def test_nothing_is_fetched_from_elsewhere_or_set_as_html() -> None:
    """No address of another server in the page's own files, and no way from text to elements."""
    folder = Path(app.__file__).parent / "static"
    for name in ("page.html", "page.css", "page.js", "plots.js", "tables.js", "texts.js"):
        text = (folder / name).read_text()
        assert "//" not in text.replace("// ", "").replace("http://www.w3.org", ""), name
        assert not any(
            word in text for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(")
        )
    assert "MIT" in (folder / "uplot.LICENSE.txt").read_text()


@pytest.mark.parametrize(
    "host", ["127.0.0.1:6007", "[::1]:6007", "localhost:6007", "192.168.0.7", "LOCALHOST", "lab-3"]
)
def test_names_of_this_machine(client: Callable[..., TestClient], host: str) -> None:
    assert client(names=frozenset({"lab-3"})).get("/", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:6007", "127.0.0.1.evil.example", "[::1].evil.example", ""]
)
def test_other_names_are_refused(client: Callable[..., TestClient], host: str) -> None:
    """A page elsewhere could point its own name here and read what comes back."""
    answer = client().get("/stream", headers={"Host": host})
    assert answer.status_code == 421
    assert "hopper" not in answer.text


@pytest.mark.parametrize("path", ["/", "/stream", "/metrics", "/static/page.js", "/none"])
@pytest.mark.parametrize("given", ["", "?token=wrong", "?token="])
def test_without_the_token_nothing_is_served(client: Callable[..., TestClient], path: str, given: str) -> None:
    answer = client(TOKEN).get(path + given, headers={"Authorization": "Bearer wrong"})
    assert answer.status_code == 401
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


def test_the_token_in_the_address_becomes_a_cookie(client: Callable[..., TestClient]) -> None:
    """And is taken out of the address; scripts cannot read it, and other sites cannot send it along."""
    page = client(TOKEN)
    answer = page.get(f"/?run=one&token={TOKEN}")
    assert (answer.status_code, answer.headers["Location"]) == (303, "/?run=one")
    assert {"httponly", "samesite=lax", "path=/"} <= {
        part.strip().lower() for part in answer.headers["Set-Cookie"].split(";")
    }
    assert page.get("/").status_code == 200
    page.cookies.clear()
    assert page.get("/").status_code == 401


def test_the_token_as_a_header(client: Callable[..., TestClient]) -> None:
    """As Prometheus sends it. The health check needs none, and tells nothing."""
    page = client(TOKEN)
    assert page.get("/metrics", headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200
    assert page.get("/health").text == "ok\n"


def test_the_way_back_is_to_this_server(client: Callable[..., TestClient]) -> None:
    answer = client(TOKEN).get(f"http://127.0.0.1:6007//evil.example/?token={TOKEN}")
    assert answer.headers["Location"].startswith("/evil.example/")


# -- the stream ----------------------------------------------------------------------------------------------


async def _take(page: Page, chosen: list[str], count: int, between: Callable[[int], None]) -> list[str]:
    found: list[str] = []
    messages = page.messages(chosen)
    async for message in messages:
        found.append(message)
        between(len(found))
        if len(found) == count:
            break
    await messages.aclose()
    return found


def test_the_stream_begins_with_everything_and_goes_on_with_what_is_new(
    make_run: Callable[..., Path],
    collection: Callable[..., RunCollection],
    stop: threading.Event,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The list of runs, then the run, then its next update alone."""
    monkeypatch.setattr(app, "TICK_S", 0.01)
    path = make_run("one")
    runs = collection()
    (run,) = runs.looked_at(["one"])
    run.poll()

    def between(count: int) -> None:
        if count == 2:
            append(path, ("/update", update(4)))
            run.poll()

    events = sse(asyncio.run(_take(Page(runs, stop), [], 3, between)))
    assert [name for name, _ in events] == ["runs", "run", "run"]
    assert events[0][1]["shown"] == ["one"]
    assert events[1][1]["columns"]["version"] == [1, 2, 3]
    assert (events[2][1]["start"], events[2][1]["columns"]["version"]) == (3, [4])
    assert SECRET not in str(events)


def test_a_run_that_is_not_there_is_replaced_by_the_newest(
    make_run: Callable[..., Path], collection: Callable[..., RunCollection], stop: threading.Event
) -> None:
    """An address that was kept may name a run that was deleted."""
    make_run("one")
    (event,) = sse(asyncio.run(_take(Page(collection(), stop), ["gone"], 1, lambda _: None)))
    assert event[1]["shown"] == ["one"]


def test_pages_beyond_a_number_are_refused(client: Callable[..., TestClient], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "MOST_STREAMS", 0)
    assert client().get("/stream").status_code == 503


# -- for Prometheus ------------------------------------------------------------------------------------------


def test_figures_for_prometheus(
    make_run: Callable[..., Path], collection: Callable[..., RunCollection], stop: threading.Event
) -> None:
    """Of runs that are running: curves from the log, the fleet from the learner's report."""
    path = make_run("one", name="hopper-ppo-s0-ab12")
    with LogLock(path / "log"):
        runs = collection()
        (run,) = runs.looked_at(["one"])
        run.poll()
        assert isinstance(run, FollowedRun)
        run._on_report(report())
        page = TestClient(Page(runs, stop).application(), base_url=ADDRESS)
        answer = page.get("/metrics")
    families = {family.name: family for family in text_string_to_metric_families(answer.text)}

    def value(name: str, **labels: str) -> Any:
        wanted = {"run": "one", "task": "hopper", "learner": "reskpn", **labels}
        return next(sample.value for sample in families[name].samples if sample.labels == wanted)

    assert value("reskpn_update") == 3
    assert value("reskpn_return") == 30.0
    assert value("reskpn_centres") == 3
    assert value("reskpn_evaluation_return") == 33.0
    assert value("reskpn_update_seconds", phase="learner") == 0.25
    assert value("reskpn_learner_up") == 1
    assert value("reskpn_actors") == 2
    assert value("reskpn_rollouts", outcome="accepted") == 82
    assert value("reskpn_actor_heard_seconds", slot="1") == 0.25

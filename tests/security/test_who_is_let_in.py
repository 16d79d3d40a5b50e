"""Who is let in, who is not, and that both sides can tell why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from guarded_sides import REFUSED_S, GuardedLearner, Outside, until
from samples import rollout

from common.config.settings import TransportSettings
from common.errors import SessionError
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.endpoint import free_port

Learners = Callable[[TransportSettings], GuardedLearner]
Outsiders = Callable[..., Outside]
TLS = "transport/link/tls"


def test_an_actor_with_a_certificate_works(
    secured: TransportSettings, certificates: Path, learners: Learners, outside: Outsiders
) -> None:
    """It joins, gets the policy though it comes late, and its rollout is taken; nobody is counted as refused."""
    learner = learners(secured)
    actor = outside(secured.endpoint, Credentials(certificates / "actor"))
    assert actor.join("a").accepted
    assert actor.ask("reskpn/v1/run-1/policy/latest")
    assert actor.push(rollout(0, "a")).status == "accepted"
    assert learner.logged() == 1
    assert learner.counted() == {}


@pytest.mark.parametrize(
    ("changes", "seen", "counted"),
    [
        ({"bare": True}, "a certificate, user or password was not accepted", "no_certificate"),
        ({"ca": "run", "own": "foreign"}, "did not accept the certificate", "bad_certificate"),
        ({"ca": "foreign", "own": "foreign"}, "the certificate that the learner shows was not accepted", "untrusted"),
        ({"plain": True}, "it speaks TLS", "no_tls"),
    ],
    ids=["no certificate", "a certificate of another authority", "a stranger to this authority", "no TLS"],
)
def test_an_outsider_is_refused(
    secured: TransportSettings,
    certificates: Path,
    foreign: Path,
    tmp_path: Path,
    learners: Learners,
    outside: Outsiders,
    changes: dict[str, Any],
    seen: str,
    counted: str,
) -> None:
    """He learns why, in words; the learner counts him by reason, and tells once."""
    learner = learners(secured)
    endpoint, credentials = secured.endpoint, NO_CREDENTIALS
    options: dict[str, object] | None = None
    if changes.get("plain"):
        endpoint = endpoint.replace("tls/", "tcp/")
    elif changes.get("bare"):
        # Our own processes say that they have none before they ask Zenoh.
        folder = certificates / "actor"
        credentials = Credentials(folder)
        shown = {f"{TLS}/connect_certificate": None, f"{TLS}/connect_private_key": None}
        options = {f"{TLS}/enable_mtls": False, **shown}
    else:
        trusted = certificates if changes["ca"] == "run" else foreign
        credentials = Credentials(_mixed(tmp_path, trusted / "actor", foreign / "actor"))
    with pytest.raises(SessionError) as caught:
        outside(endpoint, credentials, options, REFUSED_S)
    assert seen in str(caught.value)
    until(lambda: counted in learner.counted())
    assert set(learner.counted()) == {counted}
    report = learner.hub.report()
    assert report.last_refusal is not None
    assert report.last_refusal.kind == "connection"
    assert [event[1] for event in list(learner.events.queue)] == ["connection_refused"]


def test_a_learner_that_was_not_made_for_the_address(
    certificates: Path, foreign: Path, tmp_path: Path, outside: Outsiders, learners: Learners
) -> None:
    """Nobody can pass for the learner with an actor's certificate."""
    transport = TransportSettings(endpoint=f"tls/127.0.0.1:{free_port()}", certificates=certificates / "actor")
    learners(transport)
    with pytest.raises(SessionError, match="the certificate that the learner shows was not accepted here"):
        outside(transport.endpoint, Credentials(certificates / "viewer"), None, REFUSED_S)


def test_a_name_without_a_role(
    secured: TransportSettings, certificates: Path, learners: Learners, outside: Outsiders
) -> None:
    """The authority vouches for it, the learner does not know it: it gets no answer, hears why, and is counted."""
    learner = learners(secured)
    other = outside(secured.endpoint, Credentials(certificates / "other"))
    until(lambda: learner.counted() == {"stranger": 1})
    with pytest.raises(SessionError):
        other.session.ask("reskpn/v1/join", b"", REFUSED_S)
    assert "does not give the name in this certificate" in other.session.explain()
    assert learner.hub.report().last_refusal.text.endswith("without a role: other")  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("user", "counted"),
    [("actor:wrong", "bad_password"), ("mallory:secret", "bad_user"), (None, "no_user")],
    ids=["a wrong password", "an unknown user", "no user"],
)
def test_passwords(tmp_path: Path, learners: Learners, outside: Outsiders, user: str | None, counted: str) -> None:
    """Who has the right one works; who has not is refused, hears why, and is counted by reason."""
    everyone, own, wrong = tmp_path / "users", tmp_path / "own", tmp_path / "wrong"
    everyone.write_text("actor:secret\nviewer:other\n")
    own.write_text("actor:secret\n")
    transport = TransportSettings(endpoint=f"tcp/127.0.0.1:{free_port()}", users=everyone)
    learner = learners(transport)
    actor = outside(transport.endpoint, Credentials(users=own))
    assert actor.join("a").accepted
    if user is not None:
        wrong.write_text(f"{user}\n")
    with pytest.raises(SessionError, match="password"):
        outside(transport.endpoint, Credentials(users=wrong) if user else NO_CREDENTIALS, None, REFUSED_S)
    until(lambda: counted in learner.counted())
    assert set(learner.counted()) == {counted}


def test_passwords_over_tls(certificates: Path, tmp_path: Path, learners: Learners, outside: Outsiders) -> None:
    """The learner shows a certificate; an actor needs to know its authority, and a password in place of its own."""
    everyone, trusted = tmp_path / "users", tmp_path / "trusted"
    everyone.write_text("actor:secret\n")
    trusted.mkdir()
    (trusted / "ca.crt").write_bytes((certificates / "actor" / "ca.crt").read_bytes())
    endpoint = f"tls/127.0.0.1:{free_port()}"
    learner = learners(TransportSettings(endpoint=endpoint, certificates=certificates / "learner", users=everyone))
    assert outside(endpoint, Credentials(trusted, everyone)).join("a").accepted
    assert learner.counted() == {}


def _mixed(folder: Path, trusted: Path, own: Path) -> Path:
    """Certificates of two runs in one folder."""
    made = folder / "mixed"
    made.mkdir()
    for name, source in (("ca.crt", trusted), ("tls.crt", own), ("tls.key", own)):
        (made / name).write_bytes((source / name).read_bytes())
    return made

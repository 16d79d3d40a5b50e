"""Access control: who is named in it, and what it denies when nobody is."""

from __future__ import annotations

from typing import Any

from common.wire.access import LEARNER, Names, access_control, player_access_control


def control(**changes: Any) -> dict[str, Any]:
    names = {"actors": ("actor", "actor-7"), "viewers": ("viewer",)}
    settings = access_control(Names(**names | changes), by_password=False)
    made = settings["access_control"]
    assert isinstance(made, dict)
    return made


def rights(made: dict[str, Any], role: str, flow: str, message: str) -> set[str]:
    """Keys on which a role's messages may pass in one direction."""
    (policy,) = [policy for policy in made["policies"] if policy["subjects"] == [role]]
    return {
        key
        for rule in made["rules"]
        if rule["id"] in policy["rules"] and flow in rule["flows"] and message in rule["messages"]
        for key in rule["key_exprs"]
    }


def test_what_is_not_allowed_is_denied() -> None:
    """Every rule allows; the names are those of the settings."""
    made = control()
    assert (made["enabled"], made["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in made["rules"]} == {"allow"}
    subjects = {subject["id"]: subject["cert_common_names"] for subject in made["subjects"]}
    assert subjects == {"actor": ["actor", "actor-7"], "viewer": ["viewer"], LEARNER: ["learner"]}


def test_what_others_may_send() -> None:
    """The only puts are an actor's heartbeats; nobody answers, and nobody declares a queryable."""
    made = control()
    for role in ("actor", "viewer", LEARNER):
        puts = {"reskpn/v1/*/heartbeat/*"} if role == "actor" else set()
        assert rights(made, role, "ingress", "put") == puts
        for message in ("reply", "declare_queryable", "delete"):
            assert not rights(made, role, "ingress", message)
    tokens = rights(made, "actor", "ingress", "liveliness_token")
    assert tokens == {"reskpn/v1/*/alive/actor/*", "reskpn/v1/*/alive/evaluator/*"}
    assert rights(made, "viewer", "ingress", "query") == {"reskpn/v1/status"}


def test_a_role_without_names_is_nobody() -> None:
    """To Zenoh a subject without names is everyone: there must be none."""
    made = control(viewers=())
    assert "viewer" not in {subject["id"] for subject in made["subjects"]}
    assert all(policy["subjects"] != ["viewer"] for policy in made["policies"])


def test_users() -> None:
    """Names of users take the place of those in certificates; a player lets all listen and actors evaluate."""
    made: Any = player_access_control(Names(("actor",), ("viewer",)), by_password=True)["access_control"]
    assert made["subjects"] == [
        {"id": "listener", "usernames": ["actor", "viewer", "learner"]},
        {"id": "evaluator", "usernames": ["actor"]},
    ]
    assert rights(made, "listener", "ingress", "declare_subscriber") == {"reskpn/v1/**"}
    assert not rights(made, "listener", "ingress", "put")

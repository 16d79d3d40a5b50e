"""Access control: the messages that each role may send and receive. What is not allowed is denied.

Roles go by the names in certificates, or of users. Zenoh checks every message of a connection when it comes in and
before it goes out, so that a client without permission for a key neither reaches the learner with it nor, through the
learner, any other client.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from common.wire.keys import JOIN, ROOT, STATUS

LEARNER = "learner"
"""The name of the learner itself, and of its health check."""

_POLICY = (f"{ROOT}/*/policy/notify",)
_LATEST = (f"{ROOT}/*/policy/latest",)
_PUSHED = tuple(f"{ROOT}/*/{kind}/*" for kind in ("rollout", "evaluation", "environment", "assessment", "divergence"))
_HEARTBEATS = (f"{ROOT}/*/heartbeat/*",)
_PUBLISHED = (f"{ROOT}/*/metrics", f"{ROOT}/*/status")
_WORKERS = tuple(f"{ROOT}/*/alive/{role}/*" for role in ("actor", "evaluator"))
_PRESENT = (f"{ROOT}/*/alive/learner/learner",)
_ALL_ALIVE = (f"{ROOT}/*/alive/*/*",)

_LOOK = ["liveliness_query", "declare_liveliness_subscriber"]


@dataclass(frozen=True)
class Names:
    """The names of a run's actors (evaluators among them) and of its viewers."""

    actors: tuple[str, ...]
    viewers: tuple[str, ...]


@dataclass(frozen=True)
class Permission:
    """Messages on keys that may pass: those that a client sends, `ask`, and those that are sent to it, `answer`."""

    name: str
    keys: Sequence[str]
    ask: Sequence[str] = ()
    answer: Sequence[str] = ()

    def rules(self) -> list[dict[str, object]]:
        """Zenoh's form of the permission: a rule for each direction."""
        flows = {"ingress": self.ask, "egress": self.answer}
        return [
            {
                "id": f"{self.name}-{flow}",
                "permission": "allow",
                "flows": [flow],
                "messages": list(messages),
                "key_exprs": list(self.keys),
            }
            for flow, messages in flows.items()
            if messages
        ]

    def rules_for_owner(self) -> list[dict[str, object]]:
        """The same permission from the learner's side: what it sends to a router, and what the router sends to it."""
        return Permission(f"own-{self.name}", self.keys, self.answer, self.ask).rules()


_REPLY = ["reply", "declare_queryable"]

JOINING = Permission("join", [JOIN], ["query"], _REPLY)
LOOKING = Permission("status", [STATUS], ["query"], _REPLY)
WATCHING = Permission("told", _PUBLISHED, ["declare_subscriber"], ["put"])
WORKING = (
    Permission("push", _PUSHED, ["query"], _REPLY),
    Permission("latest", _LATEST, ["query"], _REPLY),
    Permission("orders", _POLICY, ["declare_subscriber"], ["put"]),
    # A heartbeat holds the incarnation of a slot's actor: it goes to the learner and to no other client.
    Permission("heartbeat", _HEARTBEATS, ["put"], ["declare_subscriber"]),
    Permission("presence", _WORKERS, ["liveliness_token"]),
    Permission("roll-call", _ALL_ALIVE, [], _LOOK),
    Permission("learner-alive", _PRESENT, _LOOK, ["liveliness_token"]),
)

PERMISSIONS = {
    "actor": (JOINING, LOOKING, *WORKING),
    "viewer": (LOOKING, WATCHING),
    LEARNER: (JOINING, LOOKING),
}
"""By role."""

PLAYING = (Permission("played", [f"{ROOT}/**"], ["declare_subscriber"], ["put"]),)
"""The permission of every client of a recorded run that is played: to subscribe."""

EVALUATING = (
    JOINING,
    Permission("latest", _LATEST, ["query"], _REPLY),
    Permission("assess", (f"{ROOT}/*/assessment/*",), ["query"], _REPLY),
    Permission("presence", (f"{ROOT}/*/alive/evaluator/*",), ["liveliness_token"]),
    Permission("roll-call", _ALL_ALIVE, [], _LOOK),
    Permission("learner-alive", _PRESENT, _LOOK, ["liveliness_token"]),
)
"""Additional permissions of a player's evaluators."""


def access_control(names: Names, *, by_password: bool) -> dict[str, object]:
    """Zenoh's settings by path, for a learner with these clients; `by_password`: the names are of users."""
    roles = {"actor": names.actors, "viewer": names.viewers, LEARNER: (LEARNER,)}
    return _settings(PERMISSIONS, roles, by_password=by_password)


def player_access_control(names: Names, *, by_password: bool) -> dict[str, object]:
    """As `access_control`, for a player: all of them may listen, and those with an actor's name may evaluate."""
    everyone = (*names.actors, *names.viewers, LEARNER)
    permissions = {"listener": PLAYING, "evaluator": EVALUATING}
    return _settings(permissions, {"listener": everyone, "evaluator": names.actors}, by_password=by_password)


def router_access_control(names: Names, *, by_password: bool) -> dict[str, object]:
    """As `access_control`, for a router between clients and the learner, which has its own name there."""
    settings = access_control(names, by_password=by_password)
    control: Any = settings["access_control"]
    owned = {permission.name: permission for granted in PERMISSIONS.values() for permission in granted}
    rules = [rule for permission in owned.values() for rule in permission.rules_for_owner()]
    control["rules"] += rules
    control["policies"].append({"subjects": [LEARNER], "rules": [rule["id"] for rule in rules]})
    return settings


def _settings(
    permissions: dict[str, tuple[Permission, ...]], roles: dict[str, tuple[str, ...]], *, by_password: bool
) -> dict[str, object]:
    named = "usernames" if by_password else "cert_common_names"
    rules = {permission.name: permission.rules() for granted in permissions.values() for permission in granted}
    # A subject without names would match everyone.
    present = [role for role in permissions if roles[role]]
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule for made in rules.values() for rule in made],
            "subjects": [{"id": role, named: list(roles[role])} for role in present],
            "policies": [
                {"subjects": [role], "rules": [rule["id"] for one in permissions[role] for rule in rules[one.name]]}
                for role in present
            ],
        }
    }

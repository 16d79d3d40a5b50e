"""Who may do what: the learner's access control, by names of certificates or users. What is not allowed is denied.

Zenoh checks every message of a connection when it comes in and before it goes out, so that who has no right to a key
neither reaches the learner with it nor, through the learner, anybody else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from common.wire.keys import JOIN, ROOT, STATUS

LEARNER = "learner"
"""The name of the learner itself, whose health check asks it how it is."""

_POLICY = (f"{ROOT}/*/policy/notify",)
_LATEST = (f"{ROOT}/*/policy/latest",)
_PUSHED = tuple(f"{ROOT}/*/{kind}/*" for kind in ("rollout", "evaluation", "environment", "assessment"))
_HEARTBEATS = (f"{ROOT}/*/heartbeat/*",)
_TOLD = (f"{ROOT}/*/metrics", f"{ROOT}/*/status")
_WORKERS = tuple(f"{ROOT}/*/alive/{role}/*" for role in ("actor", "evaluator"))
_PRESENT = (f"{ROOT}/*/alive/learner/learner",)
_ALL_ALIVE = (f"{ROOT}/*/alive/*/*",)

_LOOK = ["liveliness_query", "declare_liveliness_subscriber"]


@dataclass(frozen=True)
class Names:
    """The names of a run's actors (evaluators among them) and of those who only watch."""

    actors: tuple[str, ...]
    viewers: tuple[str, ...]


@dataclass(frozen=True)
class Right:
    """Messages on keys that may pass: what the other side sends, `ask`, and what is sent to it, `answer`."""

    name: str
    keys: Sequence[str]
    ask: Sequence[str] = ()
    answer: Sequence[str] = ()

    def rules(self) -> list[dict[str, object]]:
        """As Zenoh writes them, a rule for each direction."""
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
        """The other side of it: what the learner sends to a router, and is sent by it."""
        return Right(f"own-{self.name}", self.keys, self.answer, self.ask).rules()


_REPLY = ["reply", "declare_queryable"]

JOINING = Right("join", [JOIN], ["query"], _REPLY)
LOOKING = Right("status", [STATUS], ["query"], _REPLY)
WATCHING = Right("told", _TOLD, ["declare_subscriber"], ["put"])
WORKING = (
    Right("push", _PUSHED, ["query"], _REPLY),
    Right("latest", _LATEST, ["query"], _REPLY),
    Right("orders", _POLICY, ["declare_subscriber"], ["put"]),
    # A heartbeat says who holds a slot: it goes to the learner and comes back to nobody.
    Right("heartbeat", _HEARTBEATS, ["put"], ["declare_subscriber"]),
    Right("presence", _WORKERS, ["liveliness_token"]),
    Right("roll-call", _ALL_ALIVE, [], _LOOK),
    Right("learner-alive", _PRESENT, _LOOK, ["liveliness_token"]),
)

RIGHTS = {
    "actor": (JOINING, LOOKING, *WORKING),
    "viewer": (LOOKING, WATCHING),
    LEARNER: (JOINING, LOOKING),
}
"""By role."""

PLAYING = (Right("played", [f"{ROOT}/**"], ["declare_subscriber"], ["put"]),)
"""What everyone may do with a recorded run that is played: listen."""

EVALUATING = (
    JOINING,
    Right("latest", _LATEST, ["query"], _REPLY),
    Right("assess", (f"{ROOT}/*/assessment/*",), ["query"], _REPLY),
    Right("presence", (f"{ROOT}/*/alive/evaluator/*",), ["liveliness_token"]),
    Right("roll-call", _ALL_ALIVE, [], _LOOK),
    Right("learner-alive", _PRESENT, _LOOK, ["liveliness_token"]),
)
"""Additional rights of a player's evaluators."""


def access_control(names: Names, *, by_password: bool) -> dict[str, object]:
    """Zenoh's settings by path, for a learner that these may reach; `by_password`: the names are of users."""
    roles = {"actor": names.actors, "viewer": names.viewers, LEARNER: (LEARNER,)}
    return _settings(RIGHTS, roles, by_password=by_password)


def player_access_control(names: Names, *, by_password: bool) -> dict[str, object]:
    """As `access_control`, for a player: all of them may listen, and those with an actor's name may evaluate."""
    everyone = (*names.actors, *names.viewers, LEARNER)
    rights = {"listener": PLAYING, "evaluator": EVALUATING}
    return _settings(rights, {"listener": everyone, "evaluator": names.actors}, by_password=by_password)


def router_access_control(names: Names, *, by_password: bool) -> dict[str, object]:
    """As `access_control`, for a router between them and the learner, which is known by its name there."""
    settings = access_control(names, by_password=by_password)
    control: Any = settings["access_control"]
    owned = {right.name: right for rights in RIGHTS.values() for right in rights}
    rules = [rule for right in owned.values() for rule in right.rules_for_owner()]
    control["rules"] += rules
    control["policies"].append({"subjects": [LEARNER], "rules": [rule["id"] for rule in rules]})
    return settings


def _settings(
    rights: dict[str, tuple[Right, ...]], roles: dict[str, tuple[str, ...]], *, by_password: bool
) -> dict[str, object]:
    named = "usernames" if by_password else "cert_common_names"
    held = {right.name: right for granted in rights.values() for right in granted}
    rules = {name: right.rules() for name, right in held.items()}
    # A subject without names would be everyone.
    manned = [role for role in rights if roles[role]]
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule for made in rules.values() for rule in made],
            "subjects": [{"id": role, named: list(roles[role])} for role in manned],
            "policies": [
                {"subjects": [role], "rules": [rule["id"] for right in rights[role] for rule in rules[right.name]]}
                for role in manned
            ],
        }
    }

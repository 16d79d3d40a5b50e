"""The channels of a run's log as one table, and a message as it is read back.

JSON channels carry a JSON schema, so that Foxglove plots them. Its importer wants one type name for a type,
`properties` for every object and `items` for every array; the schemas keep to that. Fields that a schema does not
name are allowed everywhere. Rollouts and policies are msgpack and stay bytes here; `common.wire` decodes them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from common.errors import LogReadError

Encoding = Literal["json", "msgpack"]
Schema = Mapping[str, Any]


MAX_JSON_BYTES = 64 << 20
"""Of one JSON message: parsed, it takes many times its size."""


@dataclass(frozen=True)
class ChannelSpec:
    """One channel of the log. `schema` is a JSON schema for "json" and None for "msgpack"."""

    topic: str
    encoding: Encoding
    schema: Schema | None = None

    @property
    def schema_name(self) -> str:
        """Name of the schema in the file, as "reskpn.update" for /update."""
        return "reskpn." + self.topic.removeprefix("/")


@dataclass(frozen=True, slots=True)
class LogMessage:
    """One message, as it was written.

    `t_ns` is the writer's clock in nanoseconds; `sequence` counts the messages of one segment from 0.
    """

    topic: str
    t_ns: int
    sequence: int
    data: bytes

    def json(self) -> Any:
        """The content of a message of a JSON channel.

        Raises:
            LogReadError: the bytes are not JSON, as those of /rollout and /policy are not.
        """
        if len(self.data) > MAX_JSON_BYTES:
            raise LogReadError(
                f"message {self.sequence} of {self.topic} has {len(self.data):,} bytes, which no learner writes"
            )
        try:
            return json.loads(self.data)
        except (ValueError, RecursionError) as error:
            raise LogReadError(f"message {self.sequence} of {self.topic} is not JSON: {error}") from error


def _integer(description: str) -> Schema:
    return {"type": "integer", "description": description}


def _number(description: str) -> Schema:
    return {"type": "number", "description": description}


def _string(description: str) -> Schema:
    return {"type": "string", "description": description}


def _object(description: str, **properties: Schema) -> Schema:
    return {"type": "object", "description": description, "properties": properties}


def _numbers(description: str) -> Schema:
    return {**_object(description), "additionalProperties": {"type": "number"}}


def _array(description: str, items: Schema) -> Schema:
    return {"type": "array", "description": description, "items": items}


_SPEC = _object("The settings of the run and the versions of its software.")

_ROLLOUT_USED = _object(
    "Names one message of /rollout.",
    slot=_integer("slot of the actor"),
    incarnation=_string("the actor that brought it"),
    generation=_integer("how often the slot was given to new environments before"),
    seq=_integer("number of the rollout in that generation"),
    policy_version=_integer("version of the policy that acted"),
)

_UPDATE = _object(
    "One update of the learner.",
    version=_integer("version that results"),
    env_steps=_integer("environment steps used since the start of the run"),
    rollouts=_array("the rollouts used, in the order of use", _ROLLOUT_USED),
    state_digest=_string("digest of the state that results, hexadecimal"),
    metrics=_numbers("metrics of the update by name; null where not finite"),
    log_digest=_string("digest of everything in the log before this message, hexadecimal"),
    signature=_string("signature of log_digest, hexadecimal; only in a log that is signed"),
    seconds=_numbers("seconds spent by phase of the update"),
    staleness=_object(
        "Versions between the policy that acted and the one updated.",
        min=_number("least over the rollouts used"),
        mean=_number("mean over the rollouts used"),
        max=_number("greatest over the rollouts used"),
    ),
    diverged=_integer("simulations that diverged in the rollouts used; each ended an episode"),
    progress=_numbers("figures shown with the update: return, step_reward and steps_per_s; null where not known"),
)

_SET_ASIDE = _object(
    "A logged batch that no update is made of: from here on the run goes on without it.",
    version=_integer("version that it would have updated"),
    rollouts=_array("its rollouts", _ROLLOUT_USED),
    reason=_string("the option that set it aside"),
)

_EPISODE = _object(
    "The training episodes that ended in the rollouts of one update.",
    version=_integer("version that resulted from the update"),
    count=_integer("episodes"),
    return_mean=_number("mean return"),
    return_min=_number("least return"),
    return_max=_number("greatest return"),
    length_mean=_number("mean length in steps"),
)

_EVENT = _object(
    "Something that happened to the run. Further fields depend on the name.",
    level=_string("info, warning or error"),
    name=_string("what happened, one slug to filter by"),
    text=_string("the same as a sentence"),
)

_EVAL = _object(
    "Episodes of a published policy without exploration. A version may be there more than once.",
    version=_integer("version of the policy"),
    env_steps=_integer("environment steps that the version was trained with"),
    episodes=_integer("episodes"),
    return_mean=_number("mean return"),
    return_std=_number("standard deviation of the return"),
    return_min=_number("least return"),
    return_max=_number("greatest return"),
    length_mean=_number("mean length in steps"),
    length_std=_number("standard deviation of the length"),
    source=_string(
        "run for the run's own evaluation at its end, else the evaluator with the beginning of its incarnation"
    ),
    behind=_integer("versions published after this one when the evaluation came in"),
)

_TRAJECTORY = _object(
    "The beginning of the first episode of an evaluation.",
    version=_integer("version of the policy"),
    source=_string("as in /eval"),
    steps=_array(
        "the steps in their order",
        _object(
            "The state before one step.",
            time_s=_number("simulated seconds since the start of the episode"),
            qpos=_array("positions of the joints", _number("one coordinate, as MuJoCo orders them")),
        ),
    ),
)

_SEAL = _object(
    "The last message of a log that was closed.",
    log_digest=_string("digest of everything in the log before this message, hexadecimal"),
    signature=_string("signature of log_digest, hexadecimal; only in a log that is signed"),
)

CHANNELS: dict[str, ChannelSpec] = {
    channel.topic: channel
    for channel in (
        ChannelSpec("/spec", "json", _SPEC),
        ChannelSpec("/rollout", "msgpack"),
        ChannelSpec("/update", "json", _UPDATE),
        ChannelSpec("/set_aside", "json", _SET_ASIDE),
        ChannelSpec("/policy", "msgpack"),
        ChannelSpec("/environment", "msgpack"),
        ChannelSpec("/episode", "json", _EPISODE),
        ChannelSpec("/event", "json", _EVENT),
        ChannelSpec("/eval", "json", _EVAL),
        ChannelSpec("/trajectory", "json", _TRAJECTORY),
        ChannelSpec("/motion", "msgpack"),
        ChannelSpec("/divergence", "msgpack"),
        ChannelSpec("/seal", "json", _SEAL),
    )
}
"""Every channel by topic, in the order in which a segment declares them."""


def encode_json(content: Mapping[str, Any]) -> bytes:
    """The bytes of a message of a JSON channel. Numbers that are not finite become null: JSON has no NaN.

    Raises:
        TypeError: a value is not a JSON type (arrays and NumPy scalars are not).
    """
    try:
        text = json.dumps(dict(content), separators=(",", ":"), allow_nan=False)
    except ValueError:
        text = json.dumps(_finite(content), separators=(",", ":"), allow_nan=False)
    return text.encode()


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value

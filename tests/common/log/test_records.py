"""The table of channels, and JSON as the log writes it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from common.errors import LogReadError
from common.log.records import CHANNELS, LogMessage, encode_json

TYPES = {"object", "array", "string", "number", "integer", "boolean"}


def nodes(schema: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The schema and all schemas within it."""
    yield schema
    for child in schema.get("properties", {}).values():
        yield from nodes(child)
    if "items" in schema:
        yield from nodes(schema["items"])


def test_json_channels_have_a_schema_and_msgpack_channels_none() -> None:
    """Rollouts, policies, environments and recorded motion are opaque bytes; everything else says what it holds."""
    opaque = {topic for topic, channel in CHANNELS.items() if channel.schema is None}
    assert opaque == {"/rollout", "/policy", "/environment", "/motion", "/divergence"}
    assert all((channel.encoding == "json") == (channel.schema is not None) for channel in CHANNELS.values())


@pytest.mark.parametrize("topic", [topic for topic, channel in CHANNELS.items() if channel.schema is not None])
def test_schemas_keep_to_what_foxglove_imports(topic: str) -> None:
    """One type name for a type, `properties` for every object, `items` for every array; each field is described."""
    schema = CHANNELS[topic].schema
    assert schema is not None
    assert schema["type"] == "object"
    for node in nodes(schema):
        assert node["type"] in TYPES
        assert node["description"]
        assert ("properties" in node) == (node["type"] == "object")
        assert ("items" in node) == (node["type"] == "array")


def test_numbers_that_are_not_finite_become_null() -> None:
    """JSON has no NaN, and a viewer must be able to read the update in which a metric became one."""
    content = {"version": 3, "metrics": {"loss": math.nan, "kl": 0.5}, "seconds": [math.inf, (1.5, -math.inf)]}
    # every non-finite number by hand -> null; tuples are JSON arrays
    expected = {"version": 3, "metrics": {"loss": None, "kl": 0.5}, "seconds": [None, [1.5, None]]}
    assert json.loads(encode_json(content)) == expected


def test_values_that_json_has_not_are_refused() -> None:
    """Bytes in a JSON message are a mistake of the caller, not something to guess an encoding for."""
    with pytest.raises(TypeError, match="bytes"):
        encode_json({"rollout": b"\x00"})


def test_a_message_of_another_encoding_is_not_json() -> None:
    """The error names the message, so that a wrong topic in a tool is found."""
    with pytest.raises(LogReadError, match="message 7 of /rollout is not JSON"):
        LogMessage("/rollout", 0, 7, b"\x81\xa3abc\x01").json()

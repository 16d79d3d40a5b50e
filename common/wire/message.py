"""The base of all messages: a frozen dataclass to bytes and back, under one schema version."""

from __future__ import annotations

import itertools
from dataclasses import MISSING, fields
from typing import Any, ClassVar, Self, get_type_hints

from common.errors import CodecError
from common.printable import quoted
from common.wire import codec
from common.wire.codec import LIMITS, SCHEMA_VERSION, Limits
from common.wire.fields import Reader


class Message:
    """Subclasses are dataclasses whose fields are annotated `Annotated[type, reader]`; see `common.wire.fields`."""

    OLDEST_SCHEMA: ClassVar[int] = SCHEMA_VERSION
    """The oldest schema version that is read: later ones only added fields with defaults. Logs outlive a release."""

    LIMITS: ClassVar[Limits] = LIMITS
    """The limits that hold where `decode` is given none: small for messages that are always small."""

    def encode(self) -> bytes:
        """The message as msgpack; `CodecError` where a value has no form in it."""
        values = {name: _with_text_keys(getattr(self, name)) for name in _readers(type(self))}
        return codec.encode({"schema": SCHEMA_VERSION, **values})

    @classmethod
    def decode(cls, data: bytes, limits: Limits | None = None) -> Self:
        """Read and check a message.

        Raises `CodecError`: the codec's reasons, `schema` for a message of another schema version, whatever else it
        holds, `missing_field`, `unknown_field`, and the reasons of `common.wire.fields`.
        """
        raw = codec.decode(data, limits or cls.LIMITS)
        _check_schema(cls.__name__, raw, cls.OLDEST_SCHEMA)
        readers = _readers(cls)
        given = raw.keys() - {"schema"}
        missing = readers.keys() - given
        if raw["schema"] < SCHEMA_VERSION:
            # Fields that came later have defaults, which are what the older release meant.
            missing -= {field.name for field in fields(cls) if field.default is not MISSING}  # type: ignore[arg-type]
        if missing:
            raise CodecError("missing_field", f"{cls.__name__} without {', '.join(sorted(missing))}")
        if unknown := given - readers.keys():
            shown = ", ".join(sorted(quoted(name, 40) for name in itertools.islice(unknown, 4)))
            raise CodecError("unknown_field", f"{cls.__name__} with fields it does not have: {shown:.200}")
        return cls(**{name: read(name, raw[name]) for name, read in readers.items() if name in given})


def _check_schema(message: str, raw: dict[str, Any], oldest: int) -> None:
    if "schema" not in raw:
        raise CodecError("missing_field", f"{message} without a schema version")
    given = raw["schema"]
    if type(given) is not int or not oldest <= given <= SCHEMA_VERSION:
        older = f" and reads those from {oldest} on" if oldest < SCHEMA_VERSION else ""
        raise CodecError(
            "schema",
            f"{message} of schema {quoted(given, 40)}, but this side speaks schema {SCHEMA_VERSION}{older}: "
            "run the same release on the learner and on the actors",
        )


_READERS: dict[type, dict[str, Reader]] = {}  # evaluating the annotations costs more than reading a heartbeat


def _readers(message: type[Any]) -> dict[str, Reader]:
    if message not in _READERS:
        hints = get_type_hints(message, include_extras=True)
        _READERS[message] = {field.name: hints[field.name].__metadata__[0] for field in fields(message)}
    return _READERS[message]


def _with_text_keys(value: Any) -> Any:
    return {str(key): item for key, item in value.items()} if isinstance(value, dict) else value

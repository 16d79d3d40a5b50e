"""The tree of settings by dotted names, such as `algorithm.gamma`."""

from __future__ import annotations

from functools import cache

from pydantic.fields import FieldInfo

from common.config.kinds import Section
from common.config.settings import RunSettings


@cache
def leaves() -> dict[str, FieldInfo]:
    """Every setting by its dotted name; the run's own first, then those of each section."""
    own: dict[str, FieldInfo] = {}
    inner: dict[str, FieldInfo] = {}
    for name, field in RunSettings.model_fields.items():
        if isinstance(field.default, Section):
            inner |= {f"{name}.{part}": leaf for part, leaf in type(field.default).model_fields.items()}
        else:
            own[name] = field
    return own | inner


def leaf(name: str) -> FieldInfo | None:
    """The setting with a dotted name; None if there is none."""
    return leaves().get(name)


def value_of(settings: RunSettings, name: str) -> object:
    """The value of the setting with a dotted name."""
    found: object = settings
    for part in name.split("."):
        found = getattr(found, part)
    return found

"""Types of the values of settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def whole(value: Any) -> Any:
    """Convert `3e6`, which YAML and shells hand over as text or float, to a whole number; return others unchanged."""
    if isinstance(value, str) and not value.strip().isdecimal():  # digits alone are exact; a float might not be
        try:
            value = float(value)
        except ValueError:
            return value
    return int(value) if isinstance(value, float) and value.is_integer() else value


def split_list(value: Any) -> Any:
    """The elements of a list that is written as `a,b` or `[a, b]`; return what is not text unchanged."""
    if not isinstance(value, str):
        return value
    text = value.strip()
    if text.startswith("[") and text.endswith("]"):
        text = text[1:-1]
    elements = (element.strip().strip("\"'") for element in text.split(","))
    return [element for element in elements if element]


def widths(value: Any) -> Any:
    """The elements of a list of numbers as `split_list`. A number by itself is refused: it may stand for two layers."""
    alone = str(value).strip()
    if isinstance(value, int | float | str) and alone.replace("_", "").isdecimal():
        raise ValueError(f"write {alone},{alone} for two layers, or [{alone}] for a single one")
    return split_list(value)


def written(value: Any) -> str:
    """A value in the notation that every source takes: `256,256`, `true`, `0.99`; empty for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        text = ",".join(written(element) for element in value)
        return f"[{text}]" if len(value) < 2 and not any(isinstance(element, str) for element in value) else text
    return str(value)


def number_or(word: str, meaning: str) -> Callable[[Any], Any]:
    """A check for a whole number of at least 1, or one word; one sentence for whatever else there is."""

    def check(value: Any) -> Any:
        number = int(value) if isinstance(value, str) and value.strip().isdecimal() else whole(value)
        if value != word and (isinstance(number, bool) or not isinstance(number, int) or number < 1):
            raise ValueError(f"must be a whole number of at least 1, or {word!r} {meaning}")
        return number

    return check


Count = Annotated[int, BeforeValidator(whole), Field(ge=1)]
Natural = Annotated[int, BeforeValidator(whole), Field(ge=0)]
Seed = Annotated[int, BeforeValidator(whole), Field(ge=0, lt=2**32)]  # JAX drops higher bits: two seeds, one run
Staleness = Annotated[int, BeforeValidator(whole), Field(ge=0, le=4)]  # older ones teach little, and take memory
Port = Annotated[int, BeforeValidator(whole), Field(ge=1, le=65535)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Kept = Annotated[int | Literal["everything"], BeforeValidator(number_or("everything", "to delete nothing"))]
Names = Annotated[tuple[Annotated[str, Field(min_length=1, max_length=64)], ...], BeforeValidator(split_list)]
Trackers = Annotated[tuple[Literal["wandb", "trackio"], ...], BeforeValidator(split_list)]
Widths = Annotated[tuple[Count, ...], BeforeValidator(widths)]


class Section(BaseModel):
    """A frozen group of settings; an unknown name is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

"""The kinds of values that settings are made of."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def whole(value: Any) -> Any:
    """Accept `3e6`, which YAML and shells hand over as text or float, as a whole number."""
    if isinstance(value, str) and not value.strip().isdecimal():  # digits alone are exact; a float might not be
        try:
            value = float(value)
        except ValueError:
            return value
    return int(value) if isinstance(value, float) and value.is_integer() else value


Count = Annotated[int, BeforeValidator(whole), Field(ge=1)]
Natural = Annotated[int, BeforeValidator(whole), Field(ge=0)]
Seed = Annotated[int, BeforeValidator(whole), Field(ge=0, lt=2**32)]  # JAX drops higher bits: two seeds, one run
Staleness = Annotated[int, BeforeValidator(whole), Field(ge=0, le=4)]  # what is older teaches little, and must be kept
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Names = tuple[Annotated[str, Field(min_length=1, max_length=64)], ...]


class Section(BaseModel):
    """A frozen group of settings; an unknown name is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

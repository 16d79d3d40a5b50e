"""The learner's records as they may be seen by others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from common.printable import shortened


def public_update(record: Mapping[str, Any]) -> dict[str, Any]:
    """An `/update` record in which incarnations are shortened: whole ones are secrets of their actors."""
    rollouts = [place | {"incarnation": shortened(place["incarnation"])} for place in record["rollouts"]]
    return {**record, "rollouts": rollouts}

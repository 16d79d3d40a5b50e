"""What of the learner's records others may see."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from common.printable import shortened


def public_update(record: Mapping[str, Any]) -> dict[str, Any]:
    """An `/update` record with incarnations of which only the beginning is told."""
    rollouts = [place | {"incarnation": shortened(place["incarnation"])} for place in record["rollouts"]]
    return {**record, "rollouts": rollouts}

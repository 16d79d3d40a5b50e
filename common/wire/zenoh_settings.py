"""Zenoh's settings: peers at the given addresses, and no discovery of others."""

from __future__ import annotations

from collections.abc import Sequence

from common.wire.descriptors import max_sessions, raise_descriptor_limit

_RETRY_MS = 100
STALL_US = 30_000_000
"""The time that a peer may not read before its connection is closed; Zenoh's own 5 s lose data on slow links."""

CLIENT: dict[str, object] = {"mode": "client", "connect/timeout_ms": 500}
"""Overrides for a client of a router: one attempt at connecting."""

ZENOH_LOG = "off,zenoh_link_tls::unicast=warn,zenoh_transport::unicast::establishment::accept=debug"
"""The filter of Zenoh's log that shows the connections it refuses."""

_FRAMING_BYTES = 64 * 1024  # Zenoh's limit counts its own headers


def zenoh_settings(
    listen: Sequence[str], connect: Sequence[str], max_message_size: int, lease_s: float
) -> dict[str, object]:
    """The settings by path. Sizes are in bytes of one message, `lease_s` in seconds."""
    return {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        # Zenoh's own limit on connecting cannot be interrupted, so there is none: open_session waits by itself.
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {
            "period_init_ms": _RETRY_MS,
            "period_max_ms": _RETRY_MS,
            "period_increase_factor": 1,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,  # docs/decisions/0048-no-shared-memory.md
        "transport/link/rx/max_message_size": max_message_size + _FRAMING_BYTES,
        "transport/unicast/max_sessions": max_sessions(raise_descriptor_limit()),
        "transport/link/tx/lease": round(lease_s * 1000),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": STALL_US,
    }

"""How Zenoh is set up: peers at the given addresses and nobody else."""

from __future__ import annotations

from collections.abc import Sequence

_RETRY_MS = 100
_STALL_US = 30_000_000  # how long a reader may stall before its connection is closed; Zenoh's own 5 s lose data
CLIENT: dict[str, object] = {"mode": "client", "connect/timeout_ms": 500}
"""Over the others, for a client of a router: one attempt at connecting."""

ZENOH_LOG = "off,zenoh_link_tls::unicast=warn,zenoh_transport::unicast::establishment::accept=debug"
"""What Zenoh is to log so that connections it refuses can be seen."""

_FRAMING_BYTES = 64 * 1024  # Zenoh's limit counts its own headers


def zenoh_settings(
    listen: Sequence[str], connect: Sequence[str], max_message_size: int, lease_s: float
) -> dict[str, object]:
    """By path: sizes in bytes of one message, `lease_s` in seconds."""
    return {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        # Zenoh's own limit on connecting cannot be interrupted, so it has none: open_session waits by itself.
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {
            "period_init_ms": _RETRY_MS,
            "period_max_ms": _RETRY_MS,
            "period_increase_factor": 1,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": max_message_size + _FRAMING_BYTES,
        "transport/link/tx/lease": round(lease_s * 1000),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": _STALL_US,
    }

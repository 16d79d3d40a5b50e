"""Write deploy/zenohd.json5 from the access control in the code: `python -m scripts.document_router`."""

from __future__ import annotations

import json
from pathlib import Path

from common.config.settings import TransportSettings
from common.wire.access import Names, router_access_control

FILE = Path(__file__).parent.parent / "deploy" / "zenohd.json5"

HEAD = """\
// A Zenoh router between a learner and actors that cannot reach it: docs/security.md.
// Made by `python -m scripts.document_router`; a test holds it against the code.
//
// The router shows the learner's certificates, made for its own address too: `reskpn certs --hosts router.example`.
// Names other than these must be added under `subjects`.
"""


def content() -> str:
    """The whole file."""
    transport = TransportSettings()
    settings = {
        "mode": "router",
        "listen": {"endpoints": ["tls/0.0.0.0:7447"]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "link": {
                "tls": {
                    "root_ca_certificate": "/certs/ca.crt",
                    "listen_certificate": "/certs/tls.crt",
                    "listen_private_key": "/certs/tls.key",
                    "enable_mtls": True,
                    "close_link_on_expiration": True,
                },
                "tx": {"lease": round(1000 * transport.lease_s)},
            },
        },
        **router_access_control(Names(transport.actor_names, transport.viewer_names), by_password=False),
    }
    return HEAD + json.dumps(settings, indent=2) + "\n"


if __name__ == "__main__":
    FILE.write_text(content())

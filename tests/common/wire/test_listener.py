"""Nobody listens beyond loopback without asking who comes, unless that is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.config.settings import TransportSettings
from common.errors import SessionError, SettingsError
from common.wire.listener import require_authentication


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "tcp/localhost:7447"])
def test_loopback_needs_no_authentication(endpoint: str) -> None:
    """Only processes of this machine reach it."""
    require_authentication(TransportSettings(endpoint=endpoint))


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/192.0.2.1:7447", "tcp/learner.example:7447"])
def test_an_open_door_is_refused_unless_it_is_wanted(endpoint: str) -> None:
    """Beyond this machine the user must say that it may be so."""
    with pytest.raises(SettingsError, match=r"has no authentication; listen on .* or say --transport\.insecure true"):
        require_authentication(TransportSettings(endpoint=endpoint))
    with pytest.raises(SettingsError, match=r"--endpoint .* give --users, or say --insecure if"):
        require_authentication(TransportSettings(endpoint=endpoint), as_options=True)
    require_authentication(TransportSettings(endpoint=endpoint, insecure=True))


def test_a_door_with_a_lock_may_be_reached(tmp_path: Path) -> None:
    """Certificates on an encrypted address, or passwords on any."""
    locked = TransportSettings(endpoint="tls/0.0.0.0:7447", certificates=tmp_path)
    require_authentication(locked)
    require_authentication(TransportSettings(endpoint="tcp/0.0.0.0:7447", users=tmp_path / "users"))
    with pytest.raises(SettingsError, match="has no authentication"):
        require_authentication(locked.model_copy(update={"endpoint": "tcp/0.0.0.0:7447"}))


def test_what_is_no_address_is_refused() -> None:
    """With an example of one."""
    with pytest.raises(SessionError, match=r"'7447' is not an address: .* as in tcp/127\.0\.0\.1:7447"):
        require_authentication(TransportSettings(endpoint="7447"))

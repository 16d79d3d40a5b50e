"""Credentials of a process and of its peers: certificates, users and passwords, as files.

A folder of certificates holds `ca.crt`, `tls.crt` and `tls.key` (PEM), as Kubernetes names them in a secret.
The name in a certificate (its common name), or else the user's, is what access control goes by.

With users and certificates both, TLS encrypts and shows who the learner is, and passwords show who the others are;
these need `ca.crt` alone then.
"""

from __future__ import annotations

import secrets
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Self

from common.errors import SettingsError
from common.wire.endpoint import Endpoint

if TYPE_CHECKING:
    from common.config.settings import TransportSettings

CA, CERTIFICATE, KEY = "ca.crt", "tls.crt", "tls.key"

_TLS = "transport/link/tls"
_PASSWORDS = "transport/auth/usrpwd"
_ENCRYPTED = ("tls", "quic")


@dataclass(frozen=True)
class Credentials:
    """Places of the files: the folder of certificates, and the file of users, a line `user:password` each.

    Of that file a listener lets in all, and who connects takes the first.
    """

    certificates: Path | None = None
    users: Path | None = None

    @classmethod
    def of(cls, transport: TransportSettings) -> Self:
        return cls(transport.certificates, transport.users)

    def authenticate(self, endpoint: str) -> bool:
        """True if a listener there with these authenticates its peers. SessionError for what is not an address."""
        encrypted = Endpoint.parse(endpoint).protocol in _ENCRYPTED
        return self.users is not None or (self.certificates is not None and encrypted)

    def options(self, listen: Sequence[str], connect: Sequence[str]) -> dict[str, object]:
        """Zenoh's settings by path.

        Raises:
            SettingsError: a file is absent, cannot be read, is none of its kind or has expired; an address that needs
                certificates has none, or the other way round.
        """
        for address in (*listen, *connect):
            self._check_protocol(address)
        return self._tls(listening=bool(listen)) | self._passwords(listening=bool(listen))

    def _check_protocol(self, address: str) -> None:
        encrypted = Endpoint.parse(address).protocol in _ENCRYPTED
        if encrypted and self.certificates is None:
            raise SettingsError(
                f"{address} needs certificates: give the folder that holds {CA}, {CERTIFICATE} and {KEY} "
                "(transport.certificates, or --certificates); `reskpn certs` makes them"
            )
        if not encrypted and self.certificates is not None:
            raise SettingsError(
                f"certificates are given ({self.certificates}), but {address} is not encrypted and would not use them: "
                f"give tls/{address.partition('/')[2]}, or leave the certificates out"
            )

    def _tls(self, *, listening: bool) -> dict[str, object]:
        folder = self.certificates
        if folder is None:
            return {}
        shown = {"certificate": folder / CERTIFICATE, "private_key": folder / KEY}
        by_password = self.users is not None
        side = "listen" if listening else "connect"
        options: dict[str, object] = {
            f"{_TLS}/close_link_on_expiration": True,
            f"{_TLS}/verify_name_on_connect": True,
            f"{_TLS}/enable_mtls": not by_password,
        }
        if not (listening and by_password):
            check_certificate(folder / CA)
            options[f"{_TLS}/root_ca_certificate"] = str(folder / CA)
        if listening or not by_password:
            check_certificate(folder / CERTIFICATE)
            _read(folder / KEY)
            options |= {f"{_TLS}/{side}_{what}": str(path) for what, path in shown.items()}
        return options

    def _passwords(self, *, listening: bool) -> dict[str, object]:
        if self.users is None:
            return {}
        users = read_users(self.users)
        # Zenoh wants a password of who listens as well, and never compares it with anything.
        user, password = ("learner", secrets.token_hex(16)) if listening else next(iter(users.items()))
        options: dict[str, object] = {f"{_PASSWORDS}/user": user, f"{_PASSWORDS}/password": password}
        if listening:
            options[f"{_PASSWORDS}/dictionary_file"] = str(self.users)
        return options


NO_CREDENTIALS = Credentials()


def read_users(path: Path) -> dict[str, str]:
    """Passwords by user. SettingsError for what is not a file with a `user:password` on each of its lines."""
    lines = [line for line in _read(path).decode("utf-8", "replace").splitlines() if line.strip()]
    pairs = [line.partition(":") for line in lines]
    if not pairs or not all(user.strip() and password for user, _, password in pairs):
        raise SettingsError(f"{path} is not a file of users: write user:password on every line, as in actor:secret")
    return {user.strip(): password for user, _, password in pairs}


def check_certificate(path: Path) -> None:
    """SettingsError unless the file holds a certificate that is valid now."""
    from cryptography import x509  # takes a while to load, and most sessions have no certificates

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of flaws in how a foreign certificate is written
            certificate = x509.load_pem_x509_certificate(_read(path))
    except ValueError:
        raise SettingsError(f"{path} is not a certificate in PEM form; `reskpn certs` makes such files") from None
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    now = datetime.now(UTC)
    if now > end:
        raise SettingsError(f"the certificate {path} has expired on {_time(end)}: make a new one")
    if now < begin:
        raise SettingsError(
            f"the certificate {path} is valid from {_time(begin)} only, and by the clock here it is {_time(now)}: "
            "set the clock of this machine, or of the one that made it"
        )


def _time(moment: datetime) -> str:
    return f"{moment:%Y-%m-%d %H:%M} UTC"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be read ({error.strerror}): name a file that is there and that this user may read"
        ) from None

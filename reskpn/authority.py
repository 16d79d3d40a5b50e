"""A certificate authority for the processes of one run: only processes with its certificates are let in.

Keys are on the curve P-256. A learner's certificate is valid for a server and for a client (its health check is one);
all others are valid for clients alone, so that they cannot be used to impersonate the learner.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from common.errors import SettingsError
from common.wire.access import LEARNER
from common.wire.credentials import CA, CERTIFICATE, KEY

AUTHORITY = "authority"
"""The folder of the authority itself; its key signs certificates, and no process of a run needs it."""

AUTHORITY_KEY = "ca.key"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
_HOST = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9_]([A-Za-z0-9_-]*[A-Za-z0-9])?(\.[A-Za-z0-9_]([A-Za-z0-9_-]*[A-Za-z0-9])?)*"
)
_CLOCKS_DIFFER = timedelta(hours=1)
"""Time that another machine's clock may be behind."""


@dataclass(frozen=True)
class Authority:
    """The authority in the folder `out`, which also has a folder for each certificate."""

    out: Path
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @classmethod
    def new(cls, out: Path, days: int) -> Self:
        """Make an authority; SettingsError if `out` has one already, or cannot be written."""
        _refuse_existing(out / AUTHORITY)
        key = ec.generate_private_key(ec.SECP256R1())
        # A unique name, so that a certificate of another run is reported as one of an unknown authority.
        name = _named(f"ReskPN {os.urandom(4).hex()}")
        builder = (
            _builder(name, name, key, days)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        )
        authority = cls(out, builder.sign(key, hashes.SHA256()), key)
        _write(out / AUTHORITY, {CA: _pem(authority.certificate), AUTHORITY_KEY: _secret(key)})
        return authority

    @classmethod
    def load(cls, out: Path) -> Self:
        """Read the authority in `out`; SettingsError if there is none."""
        folder = out / AUTHORITY
        try:
            certificate = x509.load_pem_x509_certificate((folder / CA).read_bytes())
            key = serialization.load_pem_private_key((folder / AUTHORITY_KEY).read_bytes(), None)
        except OSError as error:
            raise SettingsError(
                f"{error.filename} cannot be read ({error.strerror}): give the folder that `reskpn certs --out` made"
            ) from None
        except ValueError:
            raise SettingsError(f"{folder} does not hold an authority that `reskpn certs --out` made") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise SettingsError(f"{folder} does not hold an authority that `reskpn certs --out` made")
        return cls(out, certificate, key)

    def issue(self, name: str, days: int, hosts: Sequence[str] = ()) -> Path:
        """Make the folder with the certificate of a name, and return it; `hosts` are a learner's names and addresses.

        Raises:
            SettingsError: the name or a host is not possible, or the folder exists.
        """
        if not NAME.fullmatch(name) or name == AUTHORITY:
            raise SettingsError(
                f"{name!r} cannot be a name: use up to 63 letters, digits, '.', '_' and '-', and not {AUTHORITY!r}"
            )
        folder = self.out / name
        _refuse_existing(folder)
        key = ec.generate_private_key(ec.SECP256R1())
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if hosts:
            uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
        names = [_address(host) for host in hosts] or [x509.DNSName(name)]
        own = x509.AuthorityKeyIdentifier.from_issuer_public_key(self.key.public_key())
        builder = (
            _builder(_named(name), self.certificate.subject, key, days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .add_extension(own, critical=False)
        )
        made = builder.sign(self.key, hashes.SHA256())
        _write(folder, {CA: _pem(self.certificate), CERTIFICATE: _pem(made), KEY: _secret(key)})
        return folder


def make_all(out: Path, hosts: Sequence[str], days: int) -> list[Path]:
    """Make a new authority with a learner, an actor and a viewer; returns the folders. SettingsError as `issue`.

    Nothing is made if anything is refused.
    """
    for host in hosts:
        _address(host)
    for name in (AUTHORITY, LEARNER, "actor", "viewer"):
        _refuse_existing(out / name)
    authority = Authority.new(out, days)
    # Processes on the learner's own machine may use loopback.
    own = list(dict.fromkeys([*hosts, "localhost", "127.0.0.1", "::1"]))
    return [authority.issue(LEARNER, days, own), authority.issue("actor", days), authority.issue("viewer", days)]


def _address(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        pass
    if not _HOST.fullmatch(host) or host.replace(".", "").isdecimal():
        raise SettingsError(f"{host!r} is not a host: give names and addresses, as in --hosts learner,10.0.0.5")
    return x509.DNSName(host)


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_DIFFER)
        .not_valid_after(now + timedelta(days=days))
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _secret(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _refuse_existing(folder: Path) -> None:
    try:
        exists = folder.exists()
    except OSError as error:
        raise _cannot_write(folder, error) from None
    if exists:
        raise SettingsError(f"{folder} exists and is not overwritten: give another --out, or move it away")


def _write(folder: Path, files: dict[str, bytes]) -> None:
    """Write files: certificates readable by all, keys by their owner alone from the moment they exist."""
    try:
        folder.mkdir(parents=True, mode=0o755)
        for name, data in files.items():
            mode = 0o600 if name.endswith(".key") else 0o644
            descriptor = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
    except OSError as error:
        raise _cannot_write(folder, error) from None


def _cannot_write(folder: Path, error: OSError) -> SettingsError:
    return SettingsError(f"{folder} cannot be written ({error.strerror}); give another --out")

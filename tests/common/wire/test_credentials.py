"""Credentials: what is wrong with them is said before Zenoh is asked, and never by Zenoh."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from common.errors import SettingsError
from common.wire.credentials import Credentials, read_users

ENDPOINT = "tls/127.0.0.1:7447"
LISTEN, CONNECT = ([ENDPOINT], []), ([], [ENDPOINT])


def certificate(begin_days: float, end_days: float) -> bytes:
    """One that vouches for itself, valid between so many days from now."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "x")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now + timedelta(days=begin_days))
        .not_valid_after(now + timedelta(days=end_days))
        .sign(key, hashes.SHA256())
    )
    return made.public_bytes(serialization.Encoding.PEM)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With a certificate that is valid today."""
    for name in ("ca.crt", "tls.crt"):
        (tmp_path / name).write_bytes(certificate(-1, 1))
    (tmp_path / "tls.key").write_text("a key")
    return tmp_path


def test_what_zenoh_is_told(folder: Path) -> None:
    """A listener shows its certificate and wants one; who connects checks the name and shows his own."""
    listening = Credentials(folder).options(*LISTEN)
    assert listening["transport/link/tls/listen_certificate"] == str(folder / "tls.crt")
    assert listening["transport/link/tls/root_ca_certificate"] == str(folder / "ca.crt")
    assert listening["transport/link/tls/enable_mtls"] is True
    connecting = Credentials(folder).options(*CONNECT)
    assert connecting["transport/link/tls/connect_private_key"] == str(folder / "tls.key")
    assert connecting["transport/link/tls/verify_name_on_connect"] is True
    assert not any("listen" in path for path in connecting)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("ca.crt", None, r"ca\.crt cannot be read \(No such file or directory\)"),
        ("tls.key", None, r"tls\.key cannot be read"),
        ("tls.crt", b"nonsense", r"tls\.crt is not a certificate in PEM form"),
        ("tls.crt", certificate(-2, -1), r"tls\.crt has expired on \d{4}-.* UTC: make a new one"),
        ("ca.crt", certificate(1, 2), r"ca\.crt is valid from .* only, .* set the clock"),
    ],
    ids=["absent", "no key", "no certificate", "expired", "not yet valid"],
)
@pytest.mark.parametrize("ends", [LISTEN, CONNECT], ids=["listening", "connecting"])
def test_files_that_cannot_be_used(
    folder: Path, ends: tuple[list[str], list[str]], name: str, content: bytes | None, words: str
) -> None:
    """One sentence names the file and what is wrong with it."""
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    with pytest.raises(SettingsError, match=words):
        Credentials(folder).options(*ends)


def test_address_and_certificates_go_together(folder: Path) -> None:
    """TLS without certificates cannot be; certificates without TLS would protect nothing."""
    with pytest.raises(SettingsError, match=r"tls/127\.0\.0\.1:7447 needs certificates: .*`reskpn certs` makes them"):
        Credentials().options(*CONNECT)
    with pytest.raises(SettingsError, match=r"tcp/127\.0\.0\.1:7447 is not encrypted .* give tls/127\.0\.0\.1:7447"):
        Credentials(folder).options([], ["tcp/127.0.0.1:7447"])


def test_who_is_asked_for_his_name(folder: Path) -> None:
    """Certificates count on an encrypted address, users on any."""
    assert Credentials(folder).authenticate(ENDPOINT)
    assert not Credentials(folder).authenticate("tcp/10.0.0.5:7447")
    assert Credentials(users=folder / "users").authenticate("tcp/10.0.0.5:7447")
    assert not Credentials().authenticate(ENDPOINT)


def test_a_file_of_users(tmp_path: Path) -> None:
    """A line each; a password may hold a colon."""
    users = tmp_path / "users"
    users.write_text("actor:se:cret\n\nviewer:other\n")
    assert read_users(users) == {"actor": "se:cret", "viewer": "other"}
    options = Credentials(users=users).options([], ["tcp/127.0.0.1:7447"])
    assert options == {"transport/auth/usrpwd/user": "actor", "transport/auth/usrpwd/password": "se:cret"}
    listening = Credentials(users=users).options(["tcp/127.0.0.1:7447"], [])
    assert listening["transport/auth/usrpwd/dictionary_file"] == str(users)


@pytest.mark.parametrize("text", ["", "actor\n", "actor:secret\nviewer:\n", ":secret\n"])
def test_what_is_no_file_of_users(tmp_path: Path, text: str) -> None:
    """An empty password, or none, is no protection."""
    (tmp_path / "users").write_text(text)
    with pytest.raises(SettingsError, match="is not a file of users: write user:password on every line"):
        read_users(tmp_path / "users")

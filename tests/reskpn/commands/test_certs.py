"""`reskpn certs`: what it makes, for whom, and what it does not do."""

from __future__ import annotations

import stat
from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from reskpn.cli import main


def read(folder: Path, name: str = "tls.crt") -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / name).read_bytes())


def uses(certificate: x509.Certificate) -> set[x509.ObjectIdentifier]:
    return set(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    assert main(["certs", "--out", str(tmp_path / "c"), "--hosts", "learner.example,10.0.0.5", "--days", "7"]) == 0
    return tmp_path / "c"


def test_what_is_made(out: Path) -> None:
    """A folder for each, with names by which the learner knows them; nobody but the owner reads a key."""
    assert sorted(path.name for path in out.iterdir()) == ["actor", "authority", "learner", "viewer"]
    authority = read(out / "authority", "ca.crt")
    for role in ("actor", "learner", "viewer"):
        made = read(out / role)
        made.verify_directly_issued_by(authority)
        assert made.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == role
        assert (out / role / "ca.crt").read_bytes() == (out / "authority" / "ca.crt").read_bytes()
        assert isinstance(made.public_key(), ec.EllipticCurvePublicKey)
        # Seven days, and an hour for clocks that are behind.
        assert (made.not_valid_after_utc - made.not_valid_before_utc).total_seconds() == 7 * 86400 + 3600
    keys = [*out.glob("*/*.key")]
    assert len(keys) == 4
    assert {stat.S_IMODE(key.stat().st_mode) for key in keys} == {0o600}


def test_who_may_be_a_server(out: Path) -> None:
    """The learner alone, under the names it was made for; none of them may sign others."""
    client, server = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH
    assert uses(read(out / "learner")) == {client, server}
    assert uses(read(out / "actor")) == uses(read(out / "viewer")) == {client}
    names = read(out / "learner").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "learner.example" in names.get_values_for_type(x509.DNSName)
    assert ip_address("10.0.0.5") in names.get_values_for_type(x509.IPAddress)
    for role, signs in (("learner", False), ("actor", False)):
        assert read(out / role).extensions.get_extension_for_class(x509.BasicConstraints).value.ca is signs
    assert read(out / "authority", "ca.crt").extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_one_more(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a name of its own, of the same authority; the learner has to be told."""
    assert main(["certs", "--out", str(out), "--add", "actor-7"]) == 0
    assert "transport.actor_names" in capsys.readouterr().out
    read(out / "actor-7").verify_directly_issued_by(read(out / "authority", "ca.crt"))
    assert uses(read(out / "actor-7")) == {ExtendedKeyUsageOID.CLIENT_AUTH}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--hosts", "learner"], "authority exists and is not overwritten"),
        (["--add", "actor"], "actor exists and is not overwritten"),
        (["--add", "a/b"], "'a/b' cannot be a name"),
        (["--add", "authority"], "'authority' cannot be a name"),
        (["--add", "new", "--days", "0"], "--days 0: certificates are made for 1 to 3650 days"),
    ],
)
def test_what_is_not_done(out: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str) -> None:
    """Nothing is overwritten, and what cannot be is said in one sentence."""
    before = {path: path.read_bytes() for path in out.glob("*/*")}
    assert main(["certs", "--out", str(out), *options]) == 2
    assert words in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.glob("*/*")} == before


@pytest.mark.parametrize("host", ["a b", "300.1.1.1", "-x", "tcp/learner"])
def test_what_is_no_host(tmp_path: Path, capsys: pytest.CaptureFixture[str], host: str) -> None:
    """And nothing is left behind."""
    assert main(["certs", "--out", str(tmp_path / "c"), f"--hosts={host}"]) == 2
    assert f"{host!r} is not a host" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_an_authority_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One more needs the first."""
    assert main(["certs", "--out", str(tmp_path), "--add", "actor-7"]) == 2
    assert "give the folder that `reskpn certs --out` made" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["x" * 300, "x" * 5000])
def test_a_directory_whose_name_is_too_long(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    """A sentence, no traceback."""
    assert main(["certs", "--out", str(tmp_path / name), "--hosts", "a"]) == 2
    assert "cannot be written (File name too long); give another --out" in capsys.readouterr().err


def test_a_directory_that_may_not_be_looked_into(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of another user; whether something is there cannot even be asked."""

    def exists(path: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "exists", exists)
    assert main(["certs", "--out", str(tmp_path / "c"), "--hosts", "a"]) == 2
    assert "cannot be written (Permission denied); give another --out" in capsys.readouterr().err

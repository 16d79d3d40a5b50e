"""Signatures of a log's digests: Ed25519, with keys in PEM files."""

from __future__ import annotations

from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from common.errors import SettingsError

_CONTEXT = b"reskpn log digest "
"""Signed before a digest, so that no signature made for something else fits."""


class Signer:
    """Signs digests with the private key in a file.

    Raises:
        SettingsError: the file cannot be read, or holds no Ed25519 private key without a password.
    """

    def __init__(self, path: Path) -> None:
        try:
            key = load_pem_private_key(path.read_bytes(), None)
        except (OSError, ValueError, TypeError) as error:
            raise _refusal(path, "private", str(error)) from None
        if not isinstance(key, Ed25519PrivateKey):
            raise _refusal(path, "private", "it is of another kind")
        self._key = key

    def sign(self, digest: str) -> str:
        """The signature, hexadecimal."""
        return self._key.sign(_CONTEXT + digest.encode()).hex()


class Verifier:
    """Checks signatures against the public key in a file. SettingsError as `Signer`."""

    def __init__(self, path: Path) -> None:
        try:
            key = load_pem_public_key(path.read_bytes())
        except (OSError, ValueError) as error:
            raise _refusal(path, "public", str(error)) from None
        if not isinstance(key, Ed25519PublicKey):
            raise _refusal(path, "public", "it is of another kind")
        self._key = key

    def accepts(self, digest: str, signature: str) -> bool:
        """True if the signature was made over the digest with this key's private half."""
        try:
            self._key.verify(bytes.fromhex(signature), _CONTEXT + digest.encode())
        except (InvalidSignature, ValueError):
            return False
        return True


def _refusal(path: Path, half: str, why: str) -> SettingsError:
    return SettingsError(
        f"{path} is not the {half} half of an Ed25519 key in PEM form ({why}); make one with: "
        "openssl genpkey -algorithm ed25519 -out log.key && openssl pkey -in log.key -pubout -out log.pub"
    )

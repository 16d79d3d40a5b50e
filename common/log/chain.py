"""The chain of a log: one digest over all that was written so far, which every `/update` and the closing `/seal` name.

The digest starts from `START`. Every record replaces it by a hash over itself and the record: a message with its topic
and time, or the metadata and attachments at the beginning of a segment. So whoever changes, removes, adds or reorders
a record has to change every digest that is named after it; a signature over them makes that impossible without the
key. Times of attachments and the framing of the file are left out, since a repair changes them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from common.log.records import LogMessage
from common.log.signatures import Signer, Verifier

Metadata = Mapping[str, Mapping[str, str]]
Attachments = Mapping[str, tuple[str, bytes]]

START = "00" * 32
METADATA = "chain"
"""Name of the metadata that holds the digest at the beginning of a segment, as `start`."""

SEALED = ("/update", "/seal")
"""Topics whose messages name the digest of everything before them."""

_DIGEST = "log_digest"
_SIGNATURE = "signature"


class Chain:
    """The digest of a log that is written or read.

    Args:
        digest: where the chain goes on, hexadecimal.
    """

    def __init__(self, digest: str = START) -> None:
        self._digest = bytes.fromhex(digest)

    @property
    def digest(self) -> str:
        """Of all records so far."""
        return self._digest.hex()

    def go_on_from(self, digest: str) -> None:
        """Take a digest for that of all records so far."""
        self._digest = bytes.fromhex(digest)

    def begin_segment(self, metadata: Metadata, attachments: Attachments) -> None:
        """Add the beginning of a segment."""
        content = {name: dict(values) for name, values in metadata.items() if name != METADATA}
        self._add(b"metadata", json.dumps(content, sort_keys=True).encode())
        for name, (media_type, data) in attachments.items():
            self._add(json.dumps(["attachment", name, media_type]).encode(), data)

    def add(self, topic: str, t_ns: int, data: bytes) -> None:
        """Add a message."""
        self._add(f"{topic} {t_ns}".encode(), data)

    def _add(self, head: bytes, data: bytes) -> None:
        hashed = hashlib.blake2b(self._digest, digest_size=32)
        hashed.update(len(head).to_bytes(4, "little") + head)
        hashed.update(data)
        self._digest = hashed.digest()


def seal(record: bytes, chain: Chain, signer: Signer | None) -> bytes:
    """The JSON object `record` with the digest of everything before it, and a signature where there is a signer."""
    fields = {_DIGEST: chain.digest}
    if signer is not None:
        fields[_SIGNATURE] = signer.sign(chain.digest)
    # Put in as text: the numbers of the record stay as they were encoded.
    inner = record.rstrip()[:-1].rstrip()
    return inner + (b"" if inner.endswith(b"{") else b",") + json.dumps(fields, separators=(",", ":"))[1:].encode()


class ChainCheck:
    """Follows the chain of a log as it is read, and keeps what does not fit.

    Args:
        verifier: checks the signatures; None where nobody gave a key.

    Attributes:
        findings: a sentence for each break.
        sealed: messages that name the digest of what is before them.
        unsealed: messages after the last of those.
        first: the path of the first segment, where that is not the beginning of its log; else None.
    """

    def __init__(self, verifier: Verifier | None = None) -> None:
        self.findings: list[str] = []
        self.sealed = 0
        self.unsealed = 0
        self.first: Path | None = None
        self._verifier = verifier
        self._closed = False
        self._chain: Chain | None = None

    @property
    def digest(self) -> str:
        """Of all that was read: where a writer goes on."""
        return START if self._chain is None else self._chain.digest

    @property
    def closed(self) -> bool:
        """True if the last message is the seal that a writer leaves when it closes a log."""
        return self._closed

    def begin_segment(self, path: Path, metadata: Metadata, attachments: Attachments) -> None:
        """Read the beginning of the next segment."""
        start = metadata.get(METADATA, {}).get("start")
        if self._chain is None:
            self._chain = Chain(start if start is not None and _is_digest(start) else START)
            self.first = path if start not in (None, START) else None
        elif start is None and self.sealed:
            self.findings.append(f"{path} does not name the digest of the records before it, as the files before do")
        elif start is not None and start != self._chain.digest:
            self.findings.append(
                f"{path} begins after other records than those before it: some were changed, removed or added"
            )
            if _is_digest(start):
                self._chain.go_on_from(start)
        self._chain.begin_segment(metadata, attachments)

    def read(self, message: LogMessage) -> None:
        """Read the next message."""
        assert self._chain is not None
        self._closed = message.topic == "/seal"
        if message.topic in SEALED:
            self._check(message, self._chain)
        else:
            self.unsealed += 1
        self._chain.add(message.topic, message.t_ns, message.data)

    def _check(self, message: LogMessage, chain: Chain) -> None:
        content = message.json()
        digest = content.get(_DIGEST) if isinstance(content, dict) else None
        name = f"{message.topic} {content['version']}" if digest and "version" in content else message.topic
        if digest is None:
            if self.sealed or self._verifier is not None:
                self.findings.append(f"message {message.sequence} of {message.topic} does not name what is before it")
            self.unsealed += 1
            return
        self.sealed += 1
        self.unsealed = 0
        if self._verifier is not None and not self._verifier.accepts(str(digest), str(content.get(_SIGNATURE, ""))):
            self.findings.append(f"{name} is not signed by the key that was given")
        if digest != chain.digest:
            self.findings.append(
                f"{name} was written after other records than those before it: some were changed, removed or added, "
                "metadata included"
            )
            # One break is one finding: what follows is held against what the log itself says from here on.
            if _is_digest(str(digest)):
                chain.go_on_from(str(digest))


def _is_digest(text: str) -> bool:
    return len(text) == len(START) and set(text) <= set("0123456789abcdef")

"""The chain of a log: what was changed after it was written is found."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from common.errors import SettingsError
from common.log.chain import START, Chain, ChainCheck, seal
from common.log.reader import LogReader
from common.log.repair import repair
from common.log.segment_writer import SegmentWriter
from common.log.signatures import Signer, Verifier
from common.log.writer import LogWriter

METADATA = {"hardware": {"cpu": "A"}}
ATTACHMENTS = {"model.xml": ("application/xml", b"<mujoco/>")}
Message = tuple[str, int, bytes]


@pytest.fixture
def keys(tmp_path: Path) -> tuple[Path, Path]:
    """Files of a private and a public key."""
    key = Ed25519PrivateKey.generate()
    private, public = tmp_path / "log.key", tmp_path / "log.pub"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return private, public


def write(directory: Path, *, chain: Chain | None = None, first: int = 1, **options: Any) -> Path:
    """A log of three updates, each after an event and a rollout; every message in a commit of its own."""
    chain = chain or Chain()
    with LogWriter(directory, chain=chain, metadata=METADATA, attachments=ATTACHMENTS, **options) as log:
        for version in range(first, first + 3):
            log.write("/event", {"level": "info", "name": "a", "text": str(version)}, t_ns=version)
            log.write("/rollout", bytes([version]) * 10, t_ns=version)
            log.write("/update", {"version": version, "metrics": {"kl": 0.1}}, t_ns=version)
            log.flush(20.0)
        log.write("/eval", {"return_mean": 5.0}, t_ns=9)
    return directory


def check(path: Path, verifier: Verifier | None = None) -> ChainCheck:
    chain = ChainCheck(verifier)
    for _ in LogReader(path).messages(chain=chain):
        pass
    return chain


def rewritten(
    source: Path,
    target: Path,
    change: Callable[[list[Message]], list[Message]],
    metadata: dict[str, dict[str, str]] | None = None,
) -> Path:
    """A log with the messages of another one changed, and everything else as it was; what an attacker can write."""
    reader = LogReader(source)
    messages = change([(message.topic, message.t_ns, message.data) for message in reader.messages()])
    target.mkdir()
    segment = SegmentWriter(
        target / "00000.mcap",
        compression="none",
        metadata=reader.metadata() | (metadata or {}),
        attachments=reader.attachments(),
        t_ns=0,
    )
    for topic, t_ns, data in messages:
        segment.add(topic, t_ns, data)
    segment.finish()
    return target


def test_a_log_as_it_was_written(tmp_path: Path) -> None:
    """Every update and the seal name what is before them; the link of the first, worked out by hand."""
    found = check(write(tmp_path))
    assert (found.findings, found.sealed, found.unsealed, found.closed, found.first) == ([], 4, 0, True, None)

    def link(digest: bytes, head: bytes, data: bytes) -> bytes:
        return hashlib.blake2b(digest + len(head).to_bytes(4, "little") + head + data, digest_size=32).digest()

    digest = link(bytes(32), b"metadata", json.dumps(METADATA).encode())
    digest = link(digest, b'["attachment", "model.xml", "application/xml"]', b"<mujoco/>")
    digest = link(digest, b"/event 1", b'{"level":"info","name":"a","text":"1"}')
    digest = link(digest, b"/rollout 1", bytes([1]) * 10)
    first = next(LogReader(tmp_path).messages(["/update"]))
    assert first.data == b'{"version":1,"metrics":{"kl":0.1},"log_digest":"%s"}' % digest.hex().encode()


@pytest.mark.parametrize("number", range(11))
def test_a_message_that_was_changed_or_removed(tmp_path: Path, number: int) -> None:
    """Whichever it is, but for the seal at the end: once, at the first record after it."""
    source = write(tmp_path / "a")

    def changed(messages: list[Message]) -> list[Message]:
        topic, t_ns, data = messages[number]
        return [*messages[:number], (topic, t_ns, data.replace(b"1", b"2") + b" "), *messages[number + 1 :]]

    removed = rewritten(source, tmp_path / "b", lambda messages: messages[:number] + messages[number + 1 :])
    found = check(rewritten(source, tmp_path / "c", changed)), check(removed)
    if number < 10:
        assert [len(one.findings) for one in found] in ([1, 1], [2, 1])
        assert all("some were changed, removed or added" in one.findings[0] for one in found)
    else:
        assert (found[1].findings, found[1].closed) == ([], False)


def test_metadata_that_was_changed(tmp_path: Path) -> None:
    """Another processor's name is found at the first update."""
    source = write(tmp_path / "a")
    found = check(rewritten(source, tmp_path / "b", lambda messages: messages, {"hardware": {"cpu": "B"}}))
    assert found.findings == [
        "/update 1 was written after other records than those before it: some were changed, removed or added, "
        "metadata included"
    ]


def test_a_chain_goes_on_over_segments_and_writers(tmp_path: Path) -> None:
    """As they roll, and as a resumed run begins another one."""
    write(tmp_path, segment_bytes=10)
    found = check(tmp_path)
    assert (found.findings, found.closed) == ([], True)
    write(tmp_path, chain=Chain(found.digest), first=4)
    found = check(tmp_path)
    assert (found.findings, found.sealed, found.closed) == ([], 8, True)
    segments = sorted(tmp_path.glob("*.mcap"))
    segments[0].unlink()
    found = check(tmp_path)
    assert (found.findings, found.first) == ([], segments[1])


def test_a_segment_that_was_put_in_the_place_of_another(tmp_path: Path) -> None:
    """It does not begin where the one before it ends."""
    write(tmp_path / "a")
    write(tmp_path / "a", chain=Chain(check(tmp_path / "a").digest), first=4)
    write(tmp_path / "b", first=5)
    (tmp_path / "b" / "00000.mcap").replace(tmp_path / "a" / "00001.mcap")
    (finding,) = check(tmp_path / "a").findings
    assert "00001.mcap begins after other records than those before it" in finding


def test_a_repair_does_not_break_it(tmp_path: Path) -> None:
    """It writes the same records anew."""
    (path,) = write(tmp_path).glob("*.mcap")
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b'"version":3')])
    assert len(repair(tmp_path).segments) == 1
    found = check(tmp_path)
    assert (found.findings, found.sealed, found.closed) == ([], 2, False)


def test_a_log_without_a_chain(tmp_path: Path) -> None:
    """Of an earlier release: nothing is found, and nothing is sealed. What is written to it from now on seals it."""
    with LogWriter(tmp_path, metadata=METADATA) as log:
        log.write("/update", {"version": 1})
    found = check(tmp_path)
    assert (found.findings, found.sealed, found.unsealed) == ([], 0, 1)
    write(tmp_path, chain=Chain(found.digest), first=2)
    found = check(tmp_path)
    assert (found.findings, found.sealed) == ([], 4)
    assert found.digest != START


def test_signatures(tmp_path: Path, keys: tuple[Path, Path]) -> None:
    """Of every link by the key that was given; another key, or none in the log, is a finding."""
    private, public = keys
    write(tmp_path / "a", signer=Signer(private))
    assert check(tmp_path / "a", Verifier(public)).findings == []
    write(tmp_path / "b")
    findings = check(tmp_path / "b", Verifier(public)).findings
    assert findings[0] == "/update 1 is not signed by the key that was given"
    assert len(findings) == 4
    with LogWriter(tmp_path / "c") as log:
        log.write("/update", {"version": 1})
    assert len(check(tmp_path / "c", Verifier(public)).findings) == 1


def test_a_chain_that_was_made_anew_is_found_by_its_signatures(tmp_path: Path, keys: tuple[Path, Path]) -> None:
    """Who changes a log and all digests after it cannot sign them."""
    private, public = keys
    source = write(tmp_path / "a", signer=Signer(private))
    forged = Chain()
    forged.begin_segment(LogReader(source).metadata(), LogReader(source).attachments())

    def forge(messages: list[Message]) -> list[Message]:
        made = []
        for topic, t_ns, data in messages:
            if topic in ("/update", "/seal"):
                content = json.loads(data)
                signature = content.pop("signature")
                del content["log_digest"]
                data = seal(json.dumps(content).encode(), forged, None)[:-1] + f',"signature":"{signature}"}}'.encode()
            elif topic == "/rollout":
                data = b"x" + data
            forged.add(topic, t_ns, data)
            made.append((topic, t_ns, data))
        return made

    rewritten(source, tmp_path / "b", forge)
    assert check(tmp_path / "b").findings == []
    assert len(check(tmp_path / "b", Verifier(public)).findings) == 4


def test_files_that_are_no_keys(tmp_path: Path, keys: tuple[Path, Path]) -> None:
    """A sentence with the command that makes one."""
    private, public = keys
    for make, path, half in ((Signer, public, "private"), (Verifier, private, "public"), (Signer, tmp_path, "private")):
        with pytest.raises(SettingsError, match=f"is not the {half} half of an Ed25519 key .* openssl genpkey"):
            make(path)

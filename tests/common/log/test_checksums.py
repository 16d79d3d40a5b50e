"""The CRC of the log is MCAP's, which is zlib's."""

from __future__ import annotations

import zlib
from pathlib import Path

import mcap.writer
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.log.checksums import crc32
from common.log.writer import LogWriter


@given(st.binary(max_size=5000), st.integers(0, 2**32 - 1))
def test_it_is_that_of_zlib(data: bytes, start: int) -> None:
    """For any bytes, also going on from those before them."""
    assert crc32(data, start) == zlib.crc32(data, start)


def test_the_check_value() -> None:
    """Of CRC-32/ISO-HDLC, as the catalogues of CRCs have it."""
    assert crc32(b"123456789") == 0xCBF43926


def test_the_writer_takes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A release of mcap that computes its CRC in another way would be slow without a word."""
    sizes: list[int] = []

    class Counting:
        @staticmethod
        def crc32(data: bytes, start: int = 0) -> int:
            sizes.append(len(data))
            return crc32(data, start)

    assert mcap.writer.zlib.crc32 is crc32
    monkeypatch.setattr(mcap.writer, "zlib", Counting)
    with LogWriter(tmp_path) as log:
        log.write("/rollout", bytes(100_000))
    assert max(sizes) > 100_000  # its chunk

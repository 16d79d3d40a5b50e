"""CRC-32 as MCAP has it, which is zlib's, computed by ISA-L: the same numbers at eight times the speed.

A run's log is CRCs and copies, so this is what it costs (docs/decisions/0022-a-faster-crc.md).
"""

from __future__ import annotations

import mcap.writer
from isal import isal_zlib

crc32 = isal_zlib.crc32


def use_in_writer() -> None:
    """Have mcap's writer take the same. It has no setting for it and calls nothing else of its `zlib`."""
    mcap.writer.zlib = isal_zlib

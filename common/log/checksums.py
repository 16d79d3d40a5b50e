"""CRC-32 as MCAP has it, which is zlib's, computed by ISA-L: the same numbers at eight times the speed.

Writing a log is copying and CRCs, so the CRC dominates its cost (docs/decisions/0022-a-faster-crc.md).
"""

from __future__ import annotations

import mcap.writer
from isal import isal_zlib

crc32 = isal_zlib.crc32


def use_in_writer() -> None:
    """Make mcap's writer use ISA-L, too. It has no setting for it and calls nothing else of its `zlib`."""
    mcap.writer.zlib = isal_zlib

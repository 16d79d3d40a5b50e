"""The allocator's settings, tried in a process of their own."""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys

import pytest

from common.memory import CHOSEN_BY_USER

PROGRAM = """
import resource
from common.memory import keep_large_blocks

print(keep_large_blocks())
bytes(8 << 20)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    bytes(8 << 20)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def run(**environment: str) -> tuple[str, int]:
    """What `keep_large_blocks` returned, and the page faults of 20 blocks of 8 MiB after it."""
    bare = {name: value for name, value in os.environ.items() if name not in CHOSEN_BY_USER}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=bare | environment, capture_output=True, text=True, check=True
    )
    kept, faults = done.stdout.split()
    return kept, int(faults)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has these settings")
def test_blocks_are_used_again() -> None:
    """After the first one, large blocks cost no new pages."""
    assert run() == ("True", pytest.approx(0, abs=20 * (8 << 20) // resource.getpagesize() // 10))


@pytest.mark.parametrize("name", CHOSEN_BY_USER)
def test_the_users_choice_stays(name: str) -> None:
    """Whoever sets the allocator by the environment is left alone."""
    assert run(**{name: "" if name == "GLIBC_TUNABLES" else "131072"})[0] == "False"

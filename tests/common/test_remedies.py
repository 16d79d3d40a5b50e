"""One table of remedies for every file that cannot be written: log, checkpoint, summary, result and drawing."""

from __future__ import annotations

import errno
import os
import resource
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from common.errors import ReskpnError
from common.log.failures import write_failure
from common.remedies import remedy
from common.wire.messages import Snapshot, digest_arrays
from reskpn.study.drawing.style import save
from reskpn.study.drawing.tables import write_text
from services.learner.training.checkpoints import write_checkpoint


@pytest.fixture
def small_files() -> Iterator[None]:
    """No file of this process may grow beyond 1,000 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def a_checkpoint(folder: Path) -> None:
    state = {"params": np.zeros(1000, np.float32)}
    write_checkpoint(folder, Snapshot("run", 1, digest_arrays(state), state))


def a_table(folder: Path) -> None:
    write_text(folder / "table.md", "x" * 5000)


def a_figure(folder: Path) -> None:
    figure = plt.figure()
    save(figure, folder / "figure")


@pytest.mark.parametrize("write", [a_checkpoint, a_table, a_figure])
def test_a_limit_on_file_size_is_named(write: Callable[[Path], None], small_files: None, tmp_path: Path) -> None:
    """It is not the disk's room, nor the permissions: `ulimit -f` is what the user must raise."""
    with pytest.raises(ReskpnError, match=r"File too large\)?; raise the limit on file size \(ulimit -f\)"):
        write(tmp_path)


def test_only_a_log_has_segments_to_make_smaller(tmp_path: Path) -> None:
    """`log.segment_bytes` is no remedy for a checkpoint."""
    error = OSError(errno.EFBIG, os.strerror(errno.EFBIG))
    assert "or lower log.segment_bytes" in str(write_failure(tmp_path, error))
    assert "segment_bytes" not in remedy(error)


def test_a_cause_without_a_name() -> None:
    """Libraries raise an OSError with a text alone."""
    assert remedy(OSError("the encoder gave up")) == "remove the cause or choose another directory"

"""Every `reskpn` command in a block of README or docs does what its reader expects: typed in order, for real."""

from __future__ import annotations

import shutil
import subprocess
import sys
from itertools import groupby
from pathlib import Path

import pytest

from tests.documents.commands import ROOT, shown_commands
from tests.documents_run.reader import SMALL, TASK, Reader, clean_environment, left_out, of_page

PAGES = sorted({one.page for one in shown_commands() if one.program == "reskpn" and one.in_block})
pytestmark = pytest.mark.timeout(1200)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run, as the reader has it from the first page."""
    made: Path = tmp_path_factory.mktemp("reader") / "runs" / "x"
    command = [sys.executable, "-m", "reskpn", "train", "--task", TASK, "--run-dir", str(made)]
    subprocess.run(command, cwd=made.parents[1], env=clean_environment() | SMALL, check=True, timeout=300.0)
    return made


@pytest.mark.parametrize("page", PAGES)
def test_a_page(page: str, run: Path, tmp_path: Path) -> None:
    """Its commands, one after the other."""
    folder, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    elsewhere.mkdir()
    copied = folder / "runs" / run.name
    shutil.copytree(run, copied)
    for beside in ("docs", "examples"):  # a reader stands in a copy of the tree
        shutil.copytree(ROOT / beside, folder / beside)
    shutil.copytree(ROOT / "examples", folder, dirs_exist_ok=True)  # the page of tasks is read in there
    (folder / "users.txt").write_text("actor:one\nviewer:two\n")
    (folder / "actor.txt").write_text("actor:one\n")
    reader = Reader(folder, elsewhere, copied, clean_environment())
    try:
        for _, block in groupby(of_page(page), key=lambda shown: shown.block):
            for shown in block:
                if why := left_out(shown):
                    print(f"not run here: {shown}: {why}")
                    continue
                reader.type(shown)
            reader.stop()
    finally:
        reader.leave()

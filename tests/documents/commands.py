"""The commands that README and the pages of docs/ show, read from their code."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAMS = ("reskpn", "make", "python", "docker", "kubectl", "openssl", "pip", "tensorboard")
INLINE = re.compile(r"`((?:reskpn|make|docker|python -m) [^`]+)`")
SETTING = re.compile(r"[A-Z][A-Z0-9_]*=\S*")


@dataclass(frozen=True)
class Shown:
    """One command as a page shows it."""

    page: str
    line: int
    text: str
    block: int
    """The number of its block of code on the page, which readers copy whole; 0 within a sentence."""

    @property
    def in_block(self) -> bool:
        """Whether it stands in a block of code."""
        return self.block > 0

    @property
    def words(self) -> list[str]:
        """Its words, without settings of the environment before it and the folder of the program."""
        words = shlex.split(self.text, comments=True)
        while words and SETTING.fullmatch(words[0]):
            words.pop(0)
        return [words[0].removeprefix(".venv/bin/"), *words[1:]] if words else []

    @property
    def program(self) -> str:
        """The first word, or nothing where the line is no command of `PROGRAMS`."""
        return self.words[0] if self.words and self.words[0] in PROGRAMS else ""

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


def pages() -> list[Path]:
    """README, CONTRIBUTING and the pages of docs/, decisions included."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def shown_commands() -> list[Shown]:
    """Every command of every page."""
    return [one for page in pages() for one in _of_page(str(page.relative_to(ROOT)), page.read_text())]


def _of_page(page: str, text: str) -> Iterator[Shown]:
    fenced = False
    pending = ""
    block, in_code = 0, False
    for number, line in enumerate(text.splitlines(), 1):
        fence = line.lstrip().startswith("```")
        fenced ^= fence
        if fence:
            continue
        in_code, before = fenced or line.startswith("    "), in_code
        if not in_code:
            pending = ""
            for found in INLINE.finditer(line):
                yield from _command(page, number, found.group(1).replace("\\|", "|"), block=0)
            continue
        block += not before
        joined = f"{pending} {line.strip()}".strip()
        pending = joined[:-1].strip() if joined.endswith("\\") else ""
        if not pending:
            yield from _command(page, number, joined, block=block)


def _command(page: str, line: int, text: str, *, block: int) -> Iterator[Shown]:
    shown = Shown(page, line, text.removeprefix("$ "), block)
    try:
        program = shown.program
    except ValueError:  # an apostrophe in a line of output
        return
    if program:
        yield shown

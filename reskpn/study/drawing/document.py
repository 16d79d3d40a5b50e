"""Drawings of many experiments, and the document that shows them between marks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from common.errors import SettingsError
from reskpn.study.drawing.draw import Drawn, draw_experiment
from reskpn.study.drawing.tables import write_text
from reskpn.study.experiments import Experiment
from reskpn.study.store import Store

MARK, END = "<!-- drawn: {} -->", "<!-- end -->"
"""What stands before and after a drawing in a document."""


def draw_all(
    names: Sequence[str],
    scale: str,
    catalogue: Mapping[str, Experiment],
    store: Store,
    out: Path,
    document: Path | None,
    say: Callable[[str], None],
) -> dict[str, Drawn]:
    """Draw these experiments into `out` and, where one is given, between the marks of a document.

    Raises:
        SettingsError: results of different versions are mixed, or the document cannot be read.
        LogWriteError: a file cannot be written.
    """
    drawn: dict[str, Drawn] = {}
    for name in names:
        each = draw_experiment(catalogue[name], scale, catalogue, store, out)
        if each is None:
            say(f"{name}: no results at scale {scale}; `reskpn paper run {name} --scale {scale}` makes them")
            continue
        drawn[name] = each
        say(f"{name}: {each.caption}")
    if document is not None:
        write_text(document, insert(_read(document), drawn, document.parent))
    return drawn


def _read(document: Path) -> str:
    try:
        return document.read_text(encoding="utf-8")
    except OSError as error:
        raise SettingsError(f"--into {document}: cannot be read ({error.strerror}); give a Markdown file") from None


def insert(document: str, drawn: Mapping[str, Drawn], pictures_from: Path) -> str:
    """The document with what is between the marks of each drawn experiment replaced.

    Args:
        pictures_from: the folder that links to pictures are relative to.

    Raises:
        SettingsError: a mark without an end.
    """
    for name, each in drawn.items():
        mark = MARK.format(name)
        start = document.find(mark)
        if start < 0:
            continue
        end = document.find(END, start)
        if end < 0:
            raise SettingsError(f"the document has {mark} without {END} after it; add one where the drawing ends")
        document = document[:start] + mark + "\n\n" + _block(each, pictures_from) + "\n" + document[end:]
    return document


def _block(drawn: Drawn, pictures_from: Path) -> str:
    parts = [drawn.caption]
    parts += [f"![{drawn.name}]({path.relative_to(pictures_from).as_posix()})" for path in drawn.pictures]
    parts += [table.markdown().rstrip() for table in drawn.tables]
    return "\n\n".join(parts) + "\n"

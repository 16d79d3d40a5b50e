"""Draws the standings of the race from its results alone.

python -m benchmarks.race.draw --into docs/study.md
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.race.records import RESULTS, read_all
from benchmarks.race.standings import current, draw
from common.errors import LogReadError, ReskpnError, SettingsError
from reskpn.study.drawing.document import insert
from reskpn.study.drawing.tables import write_text

OUT = Path("docs/study")


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    try:
        results, left_out = current(read_all(given.results))
        drawn = draw(results, left_out, given.out)
        if drawn is None:
            raise LogReadError(
                f"{given.results} has no results of the present settings and versions ({left_out} of others); "
                "`python -m benchmarks.race` makes them"
            )
        print(drawn.tables[0].markdown(), end="")
        if given.into is not None:
            write_text(given.into, insert(_read(given.into), {drawn.name: drawn}, given.into.parent))
    except ReskpnError as error:
        print(f"race: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _read(document: Path) -> str:
    try:
        return document.read_text(encoding="utf-8")
    except OSError as error:
        raise SettingsError(f"--into {document}: cannot be read ({error.strerror}); give a Markdown file") from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.race.draw",
        description="Table and picture of the race, from its results.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--results", type=Path, default=RESULTS, metavar="DIR", help="results of the race")
    parser.add_argument("--out", type=Path, default=OUT, metavar="DIR", help="where table and picture are written")
    parser.add_argument("--into", type=Path, metavar="FILE", help="document with the mark <!-- drawn: race -->")
    return parser


if __name__ == "__main__":
    sys.exit(main())

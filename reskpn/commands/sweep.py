"""`reskpn sweep`: an experiment of one's own: several settings and seeds, run and drawn."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.errors import SettingsError
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.study.experiments import SCALES

EPILOG = f"""\
FILE is an experiment in YAML:

  title: Step sizes of the functional gradient
  tasks: [hopper]
  settings: {{learner: reskpn}}
  arms:
    eta-0.1: {{label: eta 0.1}}
    eta-0.3: {{label: eta 0.3, settings: {{rkhs.eta: 0.3}}}}
  drawing: {{kind: curves}}
  scales:
    laptop: {{steps: 1e6, seeds: 3}}

The command may be stopped and given again: it makes the runs whose results are missing, then draws all of them.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", type=Path, metavar="FILE", help="the experiment")
    add("--scale", default="laptop", metavar="SCALE", help=f"{', '.join(SCALES)} (default: %(default)s)")
    add("--jobs", type=int, default=1, metavar="N", help="runs at a time (default: %(default)s)")
    add("--service", action="store_true", help="train through learner and actor processes")
    add("--out", type=Path, default=Path("build/sweep"), metavar="DIR", help="default: %(default)s")


def run(given: argparse.Namespace) -> int:
    """Make the runs that are missing and draw all; returns exit code 0."""
    from reskpn.study.drawing.side_by_side import draw_side_by_side
    from reskpn.study.experiments import read_experiment
    from reskpn.study.groups import group
    from reskpn.study.planning import plan
    from reskpn.study.run_process import fresh
    from reskpn.study.session import make_runs
    from reskpn.study.store import Store
    from reskpn.study.through_service import through_service

    if given.jobs < 1:
        raise SettingsError(f"--jobs is {given.jobs}; allowed: 1 or more")
    experiment = read_experiment(given.file)
    catalogue, store = {experiment.name: experiment}, Store(given.out / "results")
    make_runs(
        [experiment.name],
        given.scale,
        catalogue,
        store,
        only={},
        jobs=given.jobs,
        say=lambda text: print(text, flush=True),
        runner=through_service if given.service else fresh,
    )
    groups = group(experiment, plan(experiment, given.scale, catalogue, store), store)
    files, tables = draw_side_by_side(groups, given.out / experiment.name)
    print("\n".join(table.markdown() for table in tables))
    print(f"{', '.join(file.name for file in files)} in {given.out}")
    return 0


COMMAND = Command(add_options, run, EPILOG, usage="reskpn sweep FILE [options]")

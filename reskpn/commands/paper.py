"""`reskpn paper`: the experiments of the paper and of the study: list them, make their runs, draw them."""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path

from common.errors import SettingsError
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.study.experiments import SCALES

RESULTS = Path("study/results")
OUT = Path("docs/study")

EPILOG = f"""\
`run` makes the runs whose results are missing and may be stopped at any time: every finished run is a file of its own.
An experiment that needs the results of another one (a tuned learning rate) makes those first. A run that two
experiments have in common is made once.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    uses = parser.add_subparsers(dest="use", required=True, metavar="{list,run,draw}")
    listing = uses.add_parser("list", help="the experiments, with the runs that each has and needs")
    running = uses.add_parser("run", help="make the runs that are missing")
    drawing = uses.add_parser("draw", help="draw figures and tables from the results that there are")
    for use in (listing, running, drawing):
        use.add_argument("names", nargs="*", metavar="EXPERIMENT", help="default: all")
        use.add_argument("--scale", default="laptop", metavar="SCALE", help=f"{', '.join(SCALES)} (default: laptop)")
        use.add_argument("--results", type=Path, default=RESULTS, metavar="DIR", help=f"default: {RESULTS}")
    running.add_argument("--jobs", type=int, default=1, metavar="N", help="runs at a time (default: 1)")
    running.add_argument("--tasks", nargs="+", metavar="TASK", help="only runs on these tasks")
    running.add_argument("--arms", nargs="+", metavar="ARM", help="only runs of these arms")
    running.add_argument("--seeds", type=int, nargs="+", metavar="SEED", help="only runs with these seeds")
    drawing.add_argument("--out", type=Path, default=OUT, metavar="DIR", help=f"default: {OUT}")
    drawing.add_argument("--into", type=Path, metavar="FILE", help="also put them between the marks of this document")
    where = running.add_mutually_exclusive_group()
    where.add_argument("--service", action="store_true", help="train through learner and actor processes, with logs")
    where.add_argument("--warm", action="store_true", help="many runs in each process: quicker where they are small")


def run(given: argparse.Namespace) -> int:
    """List, run or draw; returns exit code 0."""
    return {"list": _list, "run": _run, "draw": _draw}[given.use](given)


def _list(given: argparse.Namespace) -> int:
    from reskpn.study.experiments import load_catalogue
    from reskpn.study.planning import plan, with_needs
    from reskpn.study.store import Store

    catalogue, store = load_catalogue(), Store(given.results)
    for experiment in with_needs(given.names or list(catalogue), catalogue):
        planned = plan(experiment, given.scale, catalogue, store)
        made = sum(store.find(trial.settings) is not None for trial in planned.trials)
        waiting = f", and those of {', '.join(planned.undecided)}" if planned.undecided else ""
        print(f"{experiment.name:11} {made:4} of {len(planned.trials):4} runs{waiting}  {experiment.title}")
    return 0


def _run(given: argparse.Namespace) -> int:
    from reskpn.study.experiments import load_catalogue
    from reskpn.study.run_process import Warm, fresh
    from reskpn.study.session import make_runs
    from reskpn.study.store import Store
    from reskpn.study.through_service import through_service

    if given.jobs < 1:
        raise SettingsError(f"--jobs is {given.jobs}; allowed: 1 or more")
    catalogue, store = load_catalogue(), Store(given.results)
    only = {"task": given.tasks, "arm": given.arms, "seed": given.seeds}
    with closing(Warm()) as warm:
        made = make_runs(
            given.names or list(catalogue),
            given.scale,
            catalogue,
            store,
            only={name: values for name, values in only.items() if values},
            jobs=given.jobs,
            say=lambda text: print(text, flush=True),
            runner=through_service if given.service else warm if given.warm else fresh,
        )
    print(f"{made} runs made, {len(store)} results in {given.results}")
    return 0


def _draw(given: argparse.Namespace) -> int:
    from reskpn.study.drawing.document import draw_all
    from reskpn.study.experiments import load_catalogue
    from reskpn.study.planning import with_needs
    from reskpn.study.store import Store

    catalogue = load_catalogue()
    names = given.names or list(catalogue)
    with_needs(names, catalogue)
    draw_all(names, given.scale, catalogue, Store(given.results), given.out, given.into, print)
    return 0


COMMAND = Command(add_options, run, EPILOG, usage="reskpn paper {list,run,draw} [EXPERIMENT ...] [options]")

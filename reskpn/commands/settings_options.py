"""Options of commands that take the settings of a run, and what their `--help` says about settings."""

from __future__ import annotations

import argparse
from functools import partial

from common.config.faults import PREFIX
from common.config.settings import RunSettings
from common.config.sources import add_options, load, load_over
from common.engine_names import PHYSICS
from common.learners import LEARNERS
from common.tasks import TASKS
from reskpn.commands.command import EXIT_CODES


def add_settings(parser: argparse.ArgumentParser) -> None:
    """An option for every setting of a run, and `--config`."""
    parser.set_defaults(options=add_options(parser))


def settings_given(given: argparse.Namespace) -> RunSettings:
    """The settings of a new run: what was given, and defaults. SettingsError as `load`."""
    return load(given.options, given, config=given.config)


def settings_given_over(given: argparse.Namespace) -> partial[RunSettings]:
    """A function that puts what was given over the settings of a run that exists: `load_over` without its base."""
    return partial(load_over, options=given.options, arguments=given, config=given.config)


def settings_epilog() -> str:
    """The paragraph of `--help` about settings as a whole."""
    width = max(len(name) for name in LEARNERS)
    learners = "\n".join(f"  {learner.name:{width}}  {learner.text}" for learner in LEARNERS.values())
    return f"""\
Settings come from the command line, then the environment ({PREFIX}TASK,
{PREFIX}ALGORITHM__GAMMA), then the file given by --config, then the defaults
shown here: the first source that sets a value takes precedence.

tasks:    {", ".join(list(TASKS)[:4])},
          {", ".join(list(TASKS)[4:])}
physics:  {", ".join(PHYSICS)}
learners:
{learners}

{EXIT_CODES}
"""

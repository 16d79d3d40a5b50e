"""Options of commands that take the settings of a run, and what their `--help` says about settings."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from common.config.faults import PREFIX
from common.config.settings import RunSettings
from common.config.sources import add_options, load, load_over, task_given
from common.engine_names import PHYSICS
from common.learners import LEARNERS
from common.tasks import GYMNASIUM, TASKS, is_own
from reskpn.commands.command import EXIT_CODES


def add_settings(parser: argparse.ArgumentParser) -> None:
    """An option for every setting of a run, and `--config`."""
    parser.set_defaults(options=add_options(parser))


def settings_given(given: argparse.Namespace) -> RunSettings:
    """The settings of a new run: what was given, and defaults; a task of one's own is imported.

    SettingsError as `load`, or as `pinned`.
    """
    settings = load(given.options, given, config=given.config)
    return own_task(settings, settings.task)


def settings_given_over(given: argparse.Namespace) -> Callable[..., RunSettings]:
    """A function that puts what was given over the settings of a run that exists: `load_over` without its base.

    A task of one's own is imported only if it was given here, too.
    """

    def over(base: RunSettings, *, own_endpoint: bool = True) -> RunSettings:
        settings = load_over(base, given.options, given, config=given.config, own_endpoint=own_endpoint)
        return own_task(settings, task_given(given.options, given, config=given.config))

    return over


def own_task(settings: RunSettings, allowed: str | None) -> RunSettings:
    """The settings with the pin of their task, if it is one's own; `allowed` is the class that may be imported.

    SettingsError as `pinned`.
    """
    if not is_own(settings.task):
        return settings
    from common.physics.lookup import allow_import
    from common.physics.pinning import pinned

    if allowed is not None:
        allow_import(allowed)
    return pinned(settings)


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
          {", ".join(list(GYMNASIUM)[:5])}
          {", ".join(list(GYMNASIUM)[5:9])}
          {", ".join(list(GYMNASIUM)[9:])}
          module:Class for a task of your own
physics:  {", ".join(PHYSICS)}
learners:
{learners}

{EXIT_CODES}
"""

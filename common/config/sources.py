"""Sources of settings: command line, environment, YAML file, default preset. The first that sets a value wins.

A `Section` stays a plain frozen model; `load` reads the sources with pydantic-settings, merges them and turns each
fault into a sentence that says what was given, what is allowed and where it came from.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    EnvSettingsSource,
    SettingsConfigDict,
)
from pydantic_settings import SettingsError as SourceError

from common.config.faults import CALL, COMMAND_LINE, ENVIRONMENT, PREFIX, Source, explain, unknown_setting
from common.config.kinds import written
from common.config.presets import PRESETS, default_settings, default_values, read_preset
from common.config.settings import RunSettings, Section
from common.config.tree import leaf, value_of
from common.errors import SettingsError

OTHER_VARIABLES = frozenset({"RESKPN_CACHE_DIR", "RESKPN_DASHBOARD_TOKEN"})
"""Variables with the prefix that are not settings of a run."""

METAVARS = {
    "bool": "true|false",
    "float": "X",
    "int": "N",
    "str": "NAME",
    "Path": "PATH",
    "{int,batch}": "N|batch",
    "{float,on-demand}": "X|on-demand",
}
"""Placeholders of options by type; those of lists are below, and choices stand as they are."""


class _Sources(RunSettings, BaseSettings):
    """The same fields as `RunSettings`, by which pydantic-settings reads sources."""

    model_config = SettingsConfigDict(
        frozen=True,
        extra="forbid",
        env_prefix=PREFIX,
        env_nested_delimiter="__",
        cli_kebab_case=True,
        cli_hide_none_type=True,
        cli_avoid_json=True,
    )


class _ListsAsText:
    """Leaves lists to the settings' validators, so that they have one notation in all sources; sections are JSON."""

    def decode_complex_value(self, field_name: str, field: FieldInfo, value: Any) -> Any:
        if not isinstance(field.default, Section):
            return value
        return super().decode_complex_value(field_name, field, value)  # type: ignore[misc]


class _Environment(_ListsAsText, EnvSettingsSource):
    pass


class _CommandLine(_ListsAsText, CliSettingsSource[Any]):
    pass


def add_options(parser: argparse.ArgumentParser) -> CliSettingsSource[Any]:
    """Give the parser an option for every setting; the result goes to `load` with the parsed arguments."""
    parser.add_argument(
        "--config",
        metavar="FILE",
        help=f"YAML file of settings, or the name of a preset ({', '.join(PRESETS)})",
    )
    return _CommandLine(_Sources, root_parser=parser, cli_parse_args=False, add_argument_method=_add_option)


def _add_option(parser: Any, *names: str, **given: Any) -> Any:
    """Add an option as pydantic-settings describes it, with the help, placeholder and lists of this project."""
    name = names[0].removeprefix("--").replace("-", "_")
    field = leaf(name)
    if field is None:
        return parser.add_argument(*names, **given)
    default = written(value_of(default_settings(), name))
    given["help"] = f"{field.description}{f' (default: {default})' if default else ''}".replace("%", "%%")
    metavar = str(given.get("metavar"))
    given["metavar"] = METAVARS.get(metavar, metavar)
    if isinstance(field.default, tuple):
        given["action"] = "store"
        given["metavar"] = "N,N,..." if isinstance(next(iter(field.default), None), int) else "NAME,..."
    return parser.add_argument(*names, **given)


def load(
    options: CliSettingsSource[Any] | None = None,
    arguments: argparse.Namespace | None = None,
    *,
    config: str | None = None,
    environment: Mapping[str, str] | None = None,
) -> RunSettings:
    """The settings of a run from all sources, or SettingsError with every fault found.

    Args:
        options, arguments: the result of `add_options`, and of the parser.
        config: a YAML file or the name of a preset.
        environment: default `os.environ`.
    """
    return _validated(_over_defaults(_sources(options, arguments, config, environment)))


def from_values(values: Mapping[str, Any]) -> RunSettings:
    """The settings of a run from values in the shape of the tree, and defaults; SettingsError as from `load`."""
    return _validated(_over_defaults([Source(CALL, values)]))


def load_over(
    base: RunSettings,
    options: CliSettingsSource[Any] | None = None,
    arguments: argparse.Namespace | None = None,
    *,
    config: str | None = None,
    environment: Mapping[str, str] | None = None,
    own_endpoint: bool = True,
) -> RunSettings:
    """The settings of a run like `load`, with those of an existing run, `base`, in place of the defaults.

    `own_endpoint`: keep its transport.endpoint, too.
    """
    sources = _sources(options, arguments, config, environment)
    exclude = None if own_endpoint else {"transport": {"endpoint"}}
    return _validated([*sources, Source("the run", base.model_dump(mode="json", exclude=exclude))])


def task_given(
    options: CliSettingsSource[Any] | None, arguments: argparse.Namespace | None, *, config: str | None = None
) -> str | None:
    """The task that the command line, the environment or the file names; None where none does."""
    sources = _sources(options, arguments, config, None)
    return next((str(source.values["task"]) for source in sources if "task" in source.values), None)


def _sources(
    options: CliSettingsSource[Any] | None,
    arguments: argparse.Namespace | None,
    config: str | None,
    environment: Mapping[str, str] | None,
) -> list[Source]:
    """The values of every source, in order of precedence."""
    return [
        Source(COMMAND_LINE, _from_command_line(options, arguments)),
        Source(ENVIRONMENT, _from_environment(os.environ if environment is None else environment)),
        Source(f"{config}", _from_file(config) if config else {}),
    ]


def _over_defaults(sources: list[Source]) -> list[Source]:
    """The sources, and below them the default preset for the learner that they name."""
    learner = next((source.values["learner"] for source in sources if "learner" in source.values), None)
    return [*sources, Source("the defaults", default_values(None if learner is None else str(learner)))]


def _validated(sources: list[Source]) -> RunSettings:
    merged: dict[str, Any] = {}
    for source in reversed(sources):
        merged = _merge(merged, source.values)
    try:
        return RunSettings.model_validate(merged)
    except ValidationError as error:
        raise SettingsError(explain(error, sources)) from None


def parse_json(text: str) -> RunSettings:
    """Settings as the learner sends them to an actor (`RunSettings.model_dump_json`); SettingsError for others."""
    try:
        return RunSettings.model_validate_json(text)
    except ValidationError as error:
        raise SettingsError(f"settings that a learner wrote cannot be used here: {explain(error, [])}") from None


def _from_command_line(options: CliSettingsSource[Any] | None, arguments: argparse.Namespace | None) -> dict[str, Any]:
    if options is None or arguments is None:
        return {}
    given = {name: value for name, value in vars(arguments).items() if name.split(".")[0] in RunSettings.model_fields}
    return dict(options(parsed_args=argparse.Namespace(**given))())


def _from_environment(environment: Mapping[str, str]) -> dict[str, Any]:
    unknown = [name for name in environment if name.startswith(PREFIX) and not _is_known(name)]
    if unknown:
        raise SettingsError("\n".join(unknown_setting(name, ENVIRONMENT) for name in unknown))
    source = _Environment(_Sources)
    source.env_vars = {key.lower(): value for key, value in environment.items()}
    try:
        return dict(source())
    except SourceError as error:
        raise SettingsError(
            f"the environment's {PREFIX}... variables cannot be read: {error}; a whole section is written as JSON, "
            f'as in {PREFIX}ALGORITHM={{"gamma": 0.99}}'
        ) from None


def _is_known(name: str) -> bool:
    """Return whether a variable with the prefix is a setting, something inside a section, or one of the others."""
    head, _, rest = name[len(PREFIX) :].lower().partition("__")
    field = RunSettings.model_fields.get(head)
    if field is None:
        return name in OTHER_VARIABLES
    return not rest or isinstance(field.default, Section)


def _from_file(config: str) -> dict[str, Any]:
    if config in PRESETS:
        return read_preset(config)
    try:
        text = Path(config).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise SettingsError(f"--config {config}: not a text file; give a YAML file of settings") from None
    except OSError as error:
        raise SettingsError(
            f"--config {config}: cannot be read ({error.strerror}); give a YAML file or one of the presets: "
            f"{', '.join(PRESETS)}"
        ) from None
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise SettingsError(f"--config {config}: not valid YAML: {' '.join(str(error).split())}") from None
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise SettingsError(f"--config {config}: must be a mapping of settings, such as 'task: hopper'")
    return values


def _merge(below: dict[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for name, value in above.items():
        old = merged.get(name)
        merged[name] = _merge(old, value) if isinstance(old, dict) and isinstance(value, Mapping) else value
    return merged

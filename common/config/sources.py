"""Where settings come from, and which place wins: command line, environment, YAML file, defaults.

A `Section` stays a plain frozen model; `load` reads the places with pydantic-settings, merges them and turns what
cannot be into one sentence per fault that says what was given, what is allowed and where it came from.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    EnvSettingsSource,
    SettingsConfigDict,
)
from pydantic_settings import SettingsError as SourceError

from common.config.settings import RunSettings, Section
from common.errors import SettingsError
from common.tasks import unknown_name

PREFIX = "RESKPN_"
PRESETS = ("paper",)


class _Sources(RunSettings, BaseSettings):
    """The same fields as `RunSettings`, for pydantic-settings to read places by."""

    model_config = SettingsConfigDict(
        frozen=True,
        extra="forbid",
        env_prefix=PREFIX,
        env_nested_delimiter="__",
        cli_kebab_case=True,
        cli_hide_none_type=True,
        cli_avoid_json=True,
    )


def add_options(parser: argparse.ArgumentParser) -> CliSettingsSource[Any]:
    """Give the parser an option for every setting; the result goes to `load` with the parsed arguments."""
    parser.add_argument(
        "--config",
        metavar="FILE",
        help=f"YAML file of settings, or the name of a preset ({', '.join(PRESETS)})",
    )
    return CliSettingsSource(_Sources, root_parser=parser, cli_parse_args=False)


def load(
    options: CliSettingsSource[Any] | None = None,
    arguments: argparse.Namespace | None = None,
    *,
    config: str | None = None,
    environment: Mapping[str, str] | None = None,
) -> RunSettings:
    """The settings of a run out of all places, or SettingsError with every fault found.

    Args:
        options, arguments: what `add_options` gave, and what the parser made of the command line.
        config: a YAML file or the name of a preset.
        environment: default `os.environ`.
    """
    return _validated(_places(options, arguments, config, environment))


def load_over(
    base: RunSettings,
    options: CliSettingsSource[Any] | None = None,
    arguments: argparse.Namespace | None = None,
    *,
    config: str | None = None,
    environment: Mapping[str, str] | None = None,
    own_endpoint: bool = True,
) -> RunSettings:
    """As `load`, but what no place gives is as in `base`: the settings of a run that was made before.

    `own_endpoint`: this goes for transport.endpoint, too.
    """
    places = _places(options, arguments, config, environment)
    exclude = None if own_endpoint else {"transport": {"endpoint"}}
    return _validated([*places, ("the run", base.model_dump(mode="json", exclude=exclude))])


def _places(
    options: CliSettingsSource[Any] | None,
    arguments: argparse.Namespace | None,
    config: str | None,
    environment: Mapping[str, str] | None,
) -> list[tuple[str, dict[str, Any]]]:
    """What every place gives, the one that wins first."""
    return [
        ("the command line", _from_command_line(options, arguments)),
        ("the environment", _from_environment(os.environ if environment is None else environment)),
        (f"{config}", _from_file(config) if config else {}),
    ]


def _validated(places: list[tuple[str, dict[str, Any]]]) -> RunSettings:
    merged: dict[str, Any] = {}
    for _, values in reversed(places):
        merged = _merge(merged, values)
    try:
        return RunSettings.model_validate(merged)
    except ValidationError as error:
        raise SettingsError(_explain(error, places)) from None


def parse_json(text: str) -> RunSettings:
    """Settings as the learner sends them to an actor (`RunSettings.model_dump_json`); SettingsError for others."""
    try:
        return RunSettings.model_validate_json(text)
    except ValidationError as error:
        raise SettingsError(f"settings that a learner wrote cannot be used here: {_explain(error, [])}") from None


def _from_command_line(options: CliSettingsSource[Any] | None, arguments: argparse.Namespace | None) -> dict[str, Any]:
    if options is None or arguments is None:
        return {}
    given = {name: value for name, value in vars(arguments).items() if name.split(".")[0] in RunSettings.model_fields}
    return dict(options(parsed_args=argparse.Namespace(**given))())


def _from_environment(environment: Mapping[str, str]) -> dict[str, Any]:
    unknown = [name for name in environment if name.startswith(PREFIX) and _is_stray(name)]
    if unknown:
        name = unknown[0]
        known = [f"{PREFIX}{field.upper()}" for field in RunSettings.model_fields]
        raise SettingsError(unknown_name("setting (environment)", name, known))
    source = EnvSettingsSource(_Sources)
    source.env_vars = {key.lower(): value for key, value in environment.items()}
    try:
        return dict(source())
    except SourceError as error:
        raise SettingsError(
            f"the environment's {PREFIX}... variables cannot be read: {error}; lists and sections are written as JSON, "
            f"as in {PREFIX}ALGORITHM__HIDDEN=[256,256]"
        ) from None


def _is_stray(name: str) -> bool:
    """Whether a RESKPN_ variable is no setting; RESKPN_HOME_... of other tools would be a typo as well."""
    head, _, rest = name[len(PREFIX) :].lower().partition("__")
    field = RunSettings.model_fields.get(head)
    if field is None:
        return name not in OTHER_VARIABLES
    return bool(rest) and not isinstance(field.default, Section)


OTHER_VARIABLES = frozenset({"RESKPN_CACHE_DIR"})
"""Variables that are no setting of a run."""


def _from_file(config: str) -> dict[str, Any]:
    if config in PRESETS:
        text = resources.files("reskpn").joinpath(f"presets/{config}.yaml").read_text()
    else:
        path = Path(config)
        try:
            text = path.read_text(encoding="utf-8")
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


def _explain(error: ValidationError, places: list[tuple[str, dict[str, Any]]]) -> str:
    """One line a fault: setting, what was given and where, what is wrong with it."""
    lines = []
    for fault in error.errors(include_url=False, include_context=False):
        name = ".".join(str(part) for part in fault["loc"])
        text = fault["msg"].removeprefix("Value error, ")
        if fault["type"] == "extra_forbidden":
            text = _unknown_setting(fault["loc"])
        elif name and not text.startswith(repr(fault["input"])):
            text = f"{fault['input']!r}: {text}"
        source = next((place for place, values in places if _holds(values, fault["loc"])), None)
        where = f" (from {source})" if source else ""
        lines.append(f"{name}{where}: {text}" if name else text)
    return "\n".join(lines)


def _holds(values: Any, loc: tuple[int | str, ...]) -> bool:
    """Whether a place gave the setting, or the list that it is an element of."""
    if not loc:
        return False
    for part in loc:
        if isinstance(values, list | tuple):
            return True
        if not isinstance(values, Mapping) or part not in values:
            return False
        values = values[part]
    return True


def _unknown_setting(loc: tuple[int | str, ...]) -> str:
    """The sentence for a name that is no setting of its section."""
    model: Any = RunSettings
    for part in loc[:-1]:
        model = model.model_fields[part].annotation
    given = str(loc[-1])
    section, _, rest = given.partition(".")
    if rest and section in model.model_fields:
        return f"{given!r} is not a setting; in a file, write {rest!r} indented under {section!r}:"
    return unknown_name("setting", given, model.model_fields)

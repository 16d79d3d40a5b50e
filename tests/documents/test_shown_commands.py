"""What README and docs tell a reader to type exists: commands, options, make targets, modules, compose profiles."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
from collections.abc import Iterator
from itertools import pairwise

import pytest
import yaml

from common.errors import ReskpnError
from reskpn.cli import parse
from tests.documents.commands import ROOT, Shown, shown_commands

SHOWN = shown_commands()


def of(program: str) -> list[Shown]:
    """The commands of one program."""
    return [one for one in SHOWN if one.program == program]


def plain(words: list[str]) -> Iterator[str]:
    """The words of a `reskpn` command without the notation of optional parts and of what is left out."""
    for word in words:
        if word in ("...", "|", ">", "&"):
            return
        word = word.strip("[]").removesuffix("...").replace("[@VERSION]", "")
        if word:
            yield word


def test_commands_are_found() -> None:
    """A page whose blocks were no longer recognised would pass every test below."""
    assert len(of("reskpn")) > 60
    assert len([one for one in of("reskpn") if one.in_block]) > 25
    assert len(of("make")) > 15


@pytest.mark.parametrize("shown", of("reskpn"), ids=str)
def test_command_lines_are_taken(shown: Shown, capsys: pytest.CaptureFixture[str]) -> None:
    """By the program's own parser: commands, options and choices exist under these names.

    A command within a sentence may leave out what it needs beside the option that the sentence is about.
    """
    words = list(plain(shown.words[1:]))
    refused: BaseException | None = None
    try:
        parse(stand_ins(words))
    except (SystemExit, ReskpnError) as error:
        refused = None if getattr(error, "code", 1) == 0 else error
    said = capsys.readouterr().err
    left_out = "arguments are required" in said or "expected " in said
    assert refused is None or (left_out and not shown.in_block), f"{shown}: {said or refused}"


def stand_ins(words: list[str]) -> list[str]:
    """A number for each word that stands for one."""
    numbers = {"N", "V", "R", "S", "K"}
    return ["1" if word in numbers else word for word in words]


@pytest.mark.parametrize("shown", of("make"), ids=str)
def test_make_targets_exist(shown: Shown) -> None:
    """And so do the variables that are set for them."""
    makefile = (ROOT / "Makefile").read_text()
    for word in plain(shown.words[1:]):
        name, given, _ = word.partition("=")
        pattern = rf"^{re.escape(name)} \?=" if given else rf"^{re.escape(name)}:"
        assert re.search(pattern, makefile, re.M), f"{shown}: {word}"


@pytest.mark.parametrize("shown", of("python"), ids=str)
def test_modules_exist(shown: Shown) -> None:
    """Those run by `python -m`, and the files run without it."""
    words = list(plain(shown.words[1:]))
    if words[0] == "-m":
        assert importlib.util.find_spec(words[1]), str(shown)
    else:
        assert (ROOT / words[0]).is_file(), str(shown)


@pytest.mark.parametrize("shown", of("docker"), ids=str)
def test_compose_profiles_and_services_exist(shown: Shown) -> None:
    """What is named after `--profile`, `--scale` and `up`."""
    if shown.words[1:2] != ["compose"]:
        return
    services = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    profiles = {profile for service in services.values() for profile in service.get("profiles", [])}
    words = shown.words[2:]
    for option, word in pairwise(words):
        if option == "--profile":
            assert word in profiles, str(shown)
        if option == "--scale":
            assert word.split("=")[0] in services, str(shown)
        if option == "-f":
            assert (ROOT / word).is_file(), str(shown)


def test_help_of_make_lists_every_target() -> None:
    """`make help` is the page of the targets, so none is missing on it."""
    makefile = (ROOT / "Makefile").read_text()
    phony = shlex.split(re.search(r"^\.PHONY: (.*)$", makefile, re.M).group(1))  # type: ignore[union-attr]
    listed = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    missing = [name for name in phony if not re.search(rf"^{name}\s", listed, re.M)]
    assert not missing

"""A reader who types every command of a page, one after the other, into one folder, with runs small enough for a test.

Commands that end by themselves must do so with exit code 0. Those that serve (a learner, an actor, a page) are started,
must say that they work, go on beside the others of their block, and are stopped by Ctrl-C at its end.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from common.wire.endpoint import free_port
from tests.documents.commands import ROOT, Shown, shown_commands
from tests.integration.small_runs import TICK

TASK, UPDATES = "halfcheetah", 12
"""Of the run that a reader has: its episodes do not end early."""

SMALL = {
    "RESKPN_NUM_ENVS": "32",
    "RESKPN_NUM_STEPS": "8",
    "RESKPN_TOTAL_STEPS": str(UPDATES * 256),
    "RESKPN_ACTORS": "1",
    "RESKPN_PHYSICS": "native",
    "RESKPN_EPISODE_LENGTH": "80",
    "RESKPN_ALGORITHM__HIDDEN": "[16,16]",
    "RESKPN_ALGORITHM__MINIBATCHES": "4",
    "RESKPN_ALGORITHM__EPOCHS": "2",
    "RESKPN_RKHS__CAPACITY": "64",
    "RESKPN_EVALUATION__EPISODES": "4",
}
TRAINING = ["--num-envs", "32", "--num-steps", "8", "--total-steps", str(UPDATES * 256)]
"""After a page's own sizes, which they replace."""

LEARNER_STEPS = str(100_000 * 256)
"""A learner that serves is to outlive the commands of its page."""

SERVES = {
    "learner": r"actor|listen|waiting",
    "actor": r"slot \d",
    "evaluator": r"following|policy \d",
    "router": r"listen|router",
    "dashboard": r"http://127\.0\.0\.1",
    "view": r"http://127\.0\.0\.1",
}
"""What a command that serves says once it works."""

NOT_RUN = {
    "paper run": "hours: `make paper-smoke` runs it at the scale smoke",
    "film --span": "seconds of a policy that was trained for longer: tests/reskpn/viewing",
    "film --diverged": "no simulation of a small run diverges: tests/reskpn/viewing",
    "view --diverged": "no simulation of a small run diverges: tests/reskpn/viewing",
    "doctor --full": "compiles MJX for a minute: tests/reskpn/doctor does",
    "sweep": "runs of full size: tests/reskpn/study has small ones",
    "runs --delete": "asks a person: tests/reskpn/commands answers it",
    "actor --task": "`reskpn train` on the same page starts its actors like that",
    "train --track": "needs wandb or trackio: tests/services/learner/reporting",
    "train --dashboard": "tests/pages has it, in a browser",
}
"""Commands that are left out here, each with where it is run instead."""


@dataclass
class Reader:
    """One page's commands in one folder."""

    folder: Path
    elsewhere: Path
    """Where the learner that is no part of the page keeps its run."""

    run: Path
    environment: dict[str, str]
    serving: list[tuple[str, subprocess.Popen[str], Path]] = field(default_factory=list)
    beside: list[subprocess.Popen[str]] = field(default_factory=list)
    port: int = 0

    def words(self, shown: Shown) -> list[str]:
        """The words after `reskpn`, with this folder's run and this machine's addresses in the place of names."""
        run = str(self.run)
        places = {"RUN": run, "RUN_DIR": run, "DIR": "made", "NAME": self.run.name, "FILE": "made.txt"}
        text = shown.text
        text = text.replace("tcp/learner:7447", "tcp/HOST:PORT")
        if "HOST:PORT" in text:
            text = text.replace("HOST:PORT", f"127.0.0.1:{self.learner_port()}")
        for host in ("10.0.0.5:7447", "router.example:7447"):
            text = text.replace(host, "127.0.0.1:7447")
        text = re.sub(r"learner\.example,10\.0\.0\.5|router\.example", "127.0.0.1", text)
        text = text.replace("/0.0.0.0:", "/127.0.0.1:")
        # The page's run may have more versions than the small one, and another task.
        text = re.sub(r"--version \d+", f"--version {UPDATES}", text)
        text = re.sub(r"\bhopper-reskpn-v\d+\.", f"{TASK}-reskpn-v{UPDATES}.", text)
        if " play " in text:
            text = text.replace("--task hopper", f"--task {TASK}")
        words = [word for word in shlex.split(text, comments=True) if word != "..."]
        while "=" in words[0]:
            words.pop(0)
        fresh = "train" in words and "--resume" not in words
        return [self._place(re.sub(r"^RUN(?=@|$)", run, places.get(word, word)), fresh) for word in words[1:]]

    def _place(self, word: str, fresh: bool) -> str:
        """A run of the page: the one that was made here under this name, or the small one."""
        if re.fullmatch(r"runs/[^/]+", word) and not fresh and not (self.folder / word).is_dir():
            return str(self.run)
        return word

    def learner_port(self) -> int:
        """The port of a learner with an actor, started when a page first speaks of HOST:PORT."""
        if not self.port:
            self.port = free_port()
            endpoint = f"tcp/127.0.0.1:{self.port}"
            serve = [sys.executable, "-m", "reskpn", "learner", "--transport.endpoint", endpoint]
            act = [sys.executable, "-m", "reskpn", "actor", "--endpoint", endpoint]
            settings = self.environment | SMALL | {"RESKPN_TOTAL_STEPS": LEARNER_STEPS}
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            for command in (serve, act):
                self.beside.append(subprocess.Popen(command, cwd=self.elsewhere, env=settings, text=True, **quiet))
            ask = [sys.executable, "-m", "reskpn", "status", "--endpoint", endpoint]
            end = time.monotonic() + 120.0
            while subprocess.run(ask, env=settings, capture_output=True).returncode:
                assert time.monotonic() < end, "the learner beside the page does not answer"
        return self.port

    def settings(self, shown: Shown) -> dict[str, str]:
        """The settings before the command, over the small ones."""
        before = {}
        for word in shlex.split(shown.text, comments=True):
            name, given, value = word.partition("=")
            if not given or not name.isupper():
                break
            before[name] = value
        steps = {"RESKPN_TOTAL_STEPS": LEARNER_STEPS} if shown.words[1:2] == ["learner"] else {}
        return self.environment | SMALL | steps | before

    def type(self, shown: Shown) -> None:
        """Run the command, or start it where it serves."""
        words = self.words(shown)
        command = [sys.executable, "-m", "reskpn", *words]
        if words[0] == "train" and "--resume" not in words and "--help" not in words:
            command += TRAINING
        watches = words[0] in SERVES or "--watch" in words or "--publish" in words
        if watches and "--help" not in words:
            self._serve(shown, command)
            return
        done = subprocess.run(
            command, cwd=self.folder, env=self.settings(shown), capture_output=True, text=True, timeout=300.0
        )
        # What a doctor finds depends on the machine: the disk may be too small for the run that the page speaks of.
        found_something = words[0] == "doctor" and "problem " in done.stdout
        assert done.returncode == 0 or found_something, f"{shown}\n{shlex.join(command)}\n{done.stdout}\n{done.stderr}"

    def _serve(self, shown: Shown, command: list[str]) -> None:
        said = self.folder / f"said-{len(self.serving)}.txt"
        with said.open("w") as output:
            process = subprocess.Popen(
                command, cwd=self.folder, env=self.settings(shown), stdout=output, stderr=subprocess.STDOUT, text=True
            )
        self.serving.append((str(shown), process, said))
        pattern = SERVES.get(command[3], r"\S")
        end = time.monotonic() + 120.0
        while not re.search(pattern, said.read_text()):
            assert process.poll() is None, f"{shown}\n{said.read_text()}"
            assert time.monotonic() < end, f"{shown} does not say that it works:\n{said.read_text()}"
            TICK.wait(0.1)

    def stop(self) -> None:
        """Ctrl-C for all that a block started, the last one first; each ends by itself."""
        serving, self.serving = self.serving, []
        for _, process, _ in reversed(serving):
            process.send_signal(signal.SIGINT)
        for shown, process, said in serving:
            code = process.wait(timeout=60.0)
            assert code in (0, 130), f"{shown} ended with {code}:\n{said.read_text()}"

    def leave(self) -> None:
        """End all that is still running, for the page is read."""
        for process in [*self.beside, *(process for _, process, _ in self.serving)]:
            process.kill()
            process.wait()


def left_out(shown: Shown) -> str:
    """Why the command is not run here, or nothing."""
    words = shown.words[1:]
    for name, why in NOT_RUN.items():
        command, *options = name.split()
        if words[:1] == [command] and set(options) <= set(words):
            return why
    return ""


def of_page(page: str) -> list[Shown]:
    """The `reskpn` commands in the blocks of a page, in its order."""
    return [one for one in shown_commands() if one.page == page and one.program == "reskpn" and one.in_block]


def clean_environment() -> dict[str, str]:
    """This process's environment without the product's settings, with the tree on Python's path."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RESKPN_")}
    return kept | {"PYTHONPATH": str(ROOT), "COLUMNS": "120"}

"""One Compose project: started, inspected and removed."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scripts.docker_test.engine import Engine, run

ROOT = Path(__file__).parent.parent.parent
POLL_S = 0.25
SERVICES = ("learner", "actor", "evaluator")
UPDATE = re.compile(r"update (\d+)/\d+")


@dataclass(frozen=True)
class Project:
    """docker-compose.yml on an engine, under a separate project name and with given settings."""

    engine: Engine
    environment: Mapping[str, str]

    def compose(self, *words: str, timeout_s: float = 300.0) -> str:
        command = [*self.engine.compose, "-f", str(ROOT / "docker-compose.yml"), *words]
        return run(command, self.environment, timeout_s)

    def docker(self, *words: str) -> str:
        return run(["docker", *words], self.environment)

    def containers(self, service: str) -> list[str]:
        """Ids of a service's containers, including exited ones."""
        name = self.environment["COMPOSE_PROJECT_NAME"]
        labels = [f"label=com.docker.compose.{key}={value}" for key, value in (("project", name), ("service", service))]
        return self.docker("ps", "-aq", "--no-trunc", "--filter", labels[0], "--filter", labels[1]).split()

    def state(self, container: str) -> dict[str, Any]:
        """The container's state: Status, ExitCode, Pid, StartedAt, Health."""
        found: list[dict[str, Any]] = json.loads(self.docker("inspect", container))
        return found[0]["State"] | {"RestartCount": found[0]["RestartCount"]}

    def health(self, container: str) -> str:
        return str(self.state(container)["Health"]["Status"])

    def words(self, container: str) -> str:
        """The container's output so far."""
        return self.docker("logs", container)

    def learner_words(self) -> str:
        """The learner's container, if it has been created."""
        return "".join(self.words(container) for container in self.containers("learner"))

    def updates(self) -> int:
        """The number of updates that the learner has reported so far."""
        return max((int(found) for found in UPDATE.findall(self.learner_words())), default=0)

    def running(self) -> list[str]:
        everyone = [container for service in SERVICES for container in self.containers(service)]
        return [container for container in everyone if self.state(container)["Status"] in ("running", "restarting")]

    def wait_for(self, what: str, condition: Callable[[], object], deadline_s: float = 300.0) -> None:
        """Wait until the condition holds. Raises AssertionError with the containers' output after the time."""
        end = time.monotonic() + deadline_s
        while not condition():
            assert time.monotonic() < end, f"{what}: not within {deadline_s:.0f} s.\n{self.last_words()}"
            time.sleep(POLL_S)

    def last_words(self, lines: int = 8) -> str:
        parts = []
        for service in (*SERVICES, "router"):
            for container in self.containers(service):
                last = "\n".join(f"  {line}" for line in self.words(container).splitlines()[-lines:])
                parts.append(f"{service} {container[:12]} {self.state(container)['Status']}:\n{last}")
        return "\n".join(parts)


def build(engine: Engine, image: str, target: str = "service") -> None:
    """Build the image; with the host's network, since only the build downloads anything."""
    base = engine.environment.get("BASE_IMAGE")
    arguments = ["--build-arg", f"BASE_IMAGE={base}"] if base else []
    command = ["docker", "build", "--network=host", *arguments, "--target", target, "-t", image, str(ROOT)]
    run(command, engine.environment, timeout_s=3000.0)


@contextmanager
def project(engine: Engine, name: str, **settings: str) -> Iterator[Project]:
    """A project whose containers, networks and volumes are removed at the end."""
    clean = {key: value for key, value in engine.environment.items() if not key.startswith("RESKPN_")}
    made = Project(engine, {**clean, **settings, "COMPOSE_PROJECT_NAME": name})
    try:
        yield made
    finally:
        profiles = ["--profile", "tensorboard", "--profile", "router"]
        subprocess.run(
            [*engine.compose, "-f", str(ROOT / "docker-compose.yml"), *profiles, "down", "-v", "-t", "2"],
            env=made.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

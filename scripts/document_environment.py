"""Write .env.example and deploy/settings.env from the settings themselves: `python -m scripts.document_environment`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic.fields import FieldInfo

from common.config.faults import PREFIX
from common.config.kinds import written
from common.config.presets import default_settings
from common.config.settings import RunSettings, Section
from common.config.tree import value_of

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / ".env.example"
PASSED_ON = ROOT / "deploy" / "settings.env"

OWN = frozenset({f"{PREFIX}{name}" for name in ("ACTORS", "SLOT_WAIT_S", "TRANSPORT__ENDPOINT", "TRANSPORT__INSECURE")})
"""What docker-compose.yml sets by itself."""

HEAD = """\
# What `docker compose up` can be told: copy this file to .env and take out the # of what you set. A variable of the
# shell wins over .env. Made by `python -m scripts.document_environment`; a test holds it against the code.

# Actors to start. `docker compose up --scale actor=3` says it for once, and during a run, too.
# ACTOR_REPLICAS=2
# Slots of the run: more actors than this stand by. What docker-compose.yml takes instead of the settings' defaults.
# RESKPN_ACTORS=4
# RESKPN_SLOT_WAIT_S=15

# Evaluators (0 for none), the versions they play (every tenth) and the episodes of each.
# EVALUATOR_REPLICAS=1
# EVALUATOR_EVERY=10
# EVALUATOR_EPISODES=16

# Threads of each one's physics, and seconds after which an actor or evaluator that finds no learner gives up.
# ACTOR_THREADS=1
# EVALUATOR_THREADS=1
# ACTOR_CONNECT_TIMEOUT_S=60
# ACTOR_REJOIN_TIMEOUT_S=300

# Limits of each container: processors (0: all), memory (as in 4g; 0: all).
# LEARNER_CPUS=0
# LEARNER_MEMORY=0
# ACTOR_CPUS=0
# ACTOR_MEMORY=0
# EVALUATOR_CPUS=0
# EVALUATOR_MEMORY=0
# TENSORBOARD_CPUS=0
# TENSORBOARD_MEMORY=0
# DASHBOARD_CPUS=0
# DASHBOARD_MEMORY=0
# ROUTER_CPUS=0
# ROUTER_MEMORY=0

# Of `docker compose --profile tensorboard up`: the port of this machine, on 127.0.0.1, that shows the curves.
# TENSORBOARD_PORT=6006

# Of `docker compose --profile dashboard up`: the port of this machine, on 127.0.0.1, that shows the live page, and the
# token that it asks for; without one it makes one, which `docker compose logs dashboard` shows.
# DASHBOARD_PORT=6007
# DASHBOARD_TOKEN=

# Of `docker compose --profile router up router`: the port of this machine that other hosts reach, and the folder that
# `reskpn certs` made, whose learner/ user 10001 must be able to read.
# ROUTER_PORT=7447
# CERTIFICATES=./certs

# Where runs are kept: a volume, or a folder of this machine (./runs), which user 10001 must be able to write.
# RUNS=runs

# The image that is built, and the one it is built on.
# IMAGE=reskpn:cpu
# GPU_IMAGE=reskpn:cuda
# TENSORBOARD_IMAGE=reskpn:tensorboard
# BASE_IMAGE=python:3.11-slim-bookworm

# Settings of the run, with their defaults; docs/settings.md explains them at more length.
"""

PASSED_ON_HEAD = """\
# The settings that docker-compose.yml passes on to its services: names alone, so each has the value of the shell or
# of .env, and none where it is set in neither. Made by `python -m scripts.document_environment`.
"""


def example() -> str:
    """The whole of .env.example."""
    return HEAD + "".join(_section_example(title, fields) for title, fields in _sections())


def passed_on() -> str:
    """The whole of deploy/settings.env."""
    names = [name for _, fields in _sections() for name in fields]
    return PASSED_ON_HEAD + "".join(f"{name}\n" for name in names)


def _sections() -> Iterator[tuple[str, dict[str, FieldInfo]]]:
    """The sections' names with their settings by variable; the run's own first."""
    own = {name: field for name, field in RunSettings.model_fields.items() if not isinstance(field.default, Section)}
    yield "the run", _variables(own, PREFIX)
    for section, field in RunSettings.model_fields.items():
        if isinstance(field.default, Section):
            yield section, _variables(type(field.default).model_fields, f"{PREFIX}{section.upper()}__")


def _variables(fields: Mapping[str, FieldInfo], prefix: str) -> dict[str, FieldInfo]:
    named = {f"{prefix}{name.upper()}": field for name, field in fields.items()}
    return {name: field for name, field in named.items() if name not in OWN}


def _section_example(title: str, fields: dict[str, FieldInfo]) -> str:
    lines = [f"# {field.description}\n# {name}={_default(name)}\n" for name, field in fields.items()]
    return f"\n# -- {title}\n" + "".join(lines)


def _default(variable: str) -> str:
    return written(value_of(default_settings(), variable.removeprefix(PREFIX).replace("__", ".").lower()))


if __name__ == "__main__":
    EXAMPLE.write_text(example())
    PASSED_ON.write_text(passed_on())

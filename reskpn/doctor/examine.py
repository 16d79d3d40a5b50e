"""All checks in order, printed as they are made."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from functools import cache

from common.config.settings import RunSettings, TransportSettings
from common.wire.credentials import Credentials
from reskpn.doctor.engines import check_jax, check_mjx, check_native, state_sizes
from reskpn.doctor.findings import Finding, guarded
from reskpn.doctor.machine import check_cores, check_disk, check_memory, check_packages, check_python, check_writing
from reskpn.doctor.needs import Needs, needs
from reskpn.doctor.reach import Answer, check_clock, check_port, check_zenoh
from reskpn.doctor.task import examine_task

PROBLEM = 1
"""Exit code where a problem was found."""


def doctor(settings: RunSettings, *, as_json: bool, full: bool, joins: bool = False, task: bool = False) -> int:
    """Print the findings, one a line or as one JSON object; returns 0, or 1 if there is a problem.

    `joins`: an actor is to be started here, so that a learner must answer at the endpoint. `task`: examine the task.
    """
    found = []
    for finding in examine(settings, full=full, joins=joins, task=task):
        found.append(finding)
        if not as_json:
            print(finding.line, flush=True)
    problems = sum(finding.level == "problem" for finding in found)
    if as_json:
        print(json.dumps({"problems": problems, "findings": [asdict(finding) for finding in found]}))
    return PROBLEM if problems else 0


def examine(settings: RunSettings, *, full: bool, joins: bool = False, task: bool = False) -> Iterator[Finding]:
    """The findings for a run with these settings on this machine; `full` compiles MJX as well, `task` looks at it."""
    yield guarded("python", check_python)
    yield guarded("packages", check_packages)
    jax = guarded("jax", check_jax)
    yield jax

    @cache
    def needed() -> Needs:
        return needs(settings, *(state_sizes(settings) if jax.level == "ok" else (0, 0)))

    yield guarded("cores", lambda: check_cores(settings))
    yield guarded("memory", lambda: check_memory(needed()))
    yield guarded("disk", lambda: check_disk(settings, needed()))
    yield guarded("writing", lambda: check_writing(settings))
    port, answer = _port(settings.transport, joins=joins)
    yield port
    yield guarded("clock", lambda: check_clock(answer))
    yield guarded("zenoh", check_zenoh)
    yield guarded("native", check_native)
    yield guarded("mjx", lambda: check_mjx(full=full))
    if task:
        yield from examine_task(settings)


def _port(transport: TransportSettings, *, joins: bool) -> tuple[Finding, Answer | None]:
    answers: list[Answer | None] = []

    def check() -> Finding:
        finding, answer = check_port(transport.endpoint, Credentials.of(transport), joins=joins)
        answers.append(answer)
        return finding

    finding = guarded("port", check)
    return finding, answers[0] if answers else None

"""Several hosts on one machine: network namespaces, each with a cable to a switch, which is one more."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Self

PREFIX = "10.77.0"


class CannotBuild(Exception):
    """This machine has no network namespaces for us; the text says what is missing."""


class Network:
    """Hosts by name, with the addresses 10.77.0.1 and on; needs root and iproute2, and leaves nothing behind."""

    def __init__(self, hosts: Sequence[str]) -> None:
        if os.geteuid() != 0:
            raise CannotBuild("network namespaces need root")
        if shutil.which("ip") is None or shutil.which("tc") is None:
            raise CannotBuild("the commands ip and tc are missing: install iproute2")
        self._tag = f"rk{os.getpid() % 100_000}"
        self._hosts = list(hosts)
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        try:
            self._add_namespace(self._switch)
            self._in(self._switch, "ip", "link", "add", "bridge", "type", "bridge")
            self._in(self._switch, "ip", "link", "set", "bridge", "up")
            for number, host in enumerate(self._hosts):
                self._add_host(number, host)
        except subprocess.CalledProcessError as error:
            self._stack.close()
            raise CannotBuild(f"{' '.join(error.cmd)}: {error.stderr.strip()}") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def address(self, host: str) -> str:
        return f"{PREFIX}.{self._hosts.index(host) + 1}"

    def on(self, host: str, command: Sequence[str]) -> list[str]:
        """The command, to be run on that host."""
        return ["ip", "netns", "exec", self._space(host), *command]

    def unplug(self, host: str) -> None:
        """Its cable is out: nothing goes in or out, and no connection is told so."""
        self._in(self._switch, "ip", "link", "set", self._port(host), "down")

    def plug(self, host: str) -> None:
        self._in(self._switch, "ip", "link", "set", self._port(host), "up")

    def slow(self, host: str, rate: str) -> None:
        """Its cable carries only so much each way, as in "2mbit"."""
        how = ("root", "tbf", "rate", rate, "burst", "16kbit", "latency", "300ms")
        self._in(self._switch, "tc", "qdisc", "replace", "dev", self._port(host), *how)
        self._in(self._space(host), "tc", "qdisc", "replace", "dev", "cable", *how)

    @property
    def _switch(self) -> str:
        return f"{self._tag}-switch"

    def _space(self, host: str) -> str:
        return f"{self._tag}-{host}"

    def _port(self, host: str) -> str:
        return f"port{self._hosts.index(host)}"

    def _add_host(self, number: int, host: str) -> None:
        space, port = self._space(host), self._port(host)
        self._add_namespace(space)
        _run("ip", "link", "add", port, "netns", self._switch, "type", "veth", "peer", "name", "cable", "netns", space)
        self._in(self._switch, "ip", "link", "set", port, "master", "bridge", "up")
        self._in(space, "ip", "address", "add", f"{PREFIX}.{number + 1}/24", "dev", "cable")
        for device in ("lo", "cable"):
            self._in(space, "ip", "link", "set", device, "up")

    def _add_namespace(self, name: str) -> None:
        _run("ip", "netns", "add", name)
        self._stack.callback(_run, "ip", "netns", "delete", name)

    def _in(self, space: str, *command: str) -> None:
        _run("ip", "netns", "exec", space, *command)


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True)

"""A Docker engine for the test: the machine's own, or a private one that is removed afterwards.

The private one needs nothing but Debian's packages: its base image is made from them, since there may be no registry
of images to pull one from.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

START_S = 60.0
POLL_S = 0.2

PROGRAMS = {
    "dockerd": "docker.io",
    "iptables": "iptables",
    "docker-compose": "docker-compose",
    "mmdebstrap": "mmdebstrap",
}
"""Commands that a private engine needs, and the Debian packages that contain them."""

BASE_IMAGE = "local/python-base:bookworm"
CERTIFICATES = "etc/ssl/certs/ca-certificates.crt"


class CannotRun(Exception):
    """No engine is available on this machine and none can be started."""


@dataclass(frozen=True)
class Engine:
    """Access to an engine: the environment variables of its clients and the compose command."""

    environment: Mapping[str, str]
    compose: tuple[str, ...]


@contextmanager
def some_engine() -> Iterator[Engine]:
    """The machine's engine if it responds, otherwise a private one.

    Raises:
        CannotRun: neither is to be had; says why.
    """
    if shutil.which("docker") and _quiet(["docker", "info"], os.environ):
        yield Engine(dict(os.environ), _compose_command())
        return
    with _private_engine() as engine:
        yield engine


def run(command: Sequence[str], environment: Mapping[str, str], timeout_s: float = 900.0) -> str:
    """The command's output. Raises RuntimeError with the end of it if the command fails."""
    done = subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=timeout_s
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with exit code {done.returncode}:\n{done.stdout[-3000:]}")
    return done.stdout


def _compose_command() -> tuple[str, ...]:
    if _quiet(["docker", "compose", "version"], os.environ):
        return ("docker", "compose")
    if shutil.which("docker-compose"):
        return ("docker-compose",)
    raise CannotRun("Docker answers, but neither `docker compose` nor docker-compose is there: install one")


@contextmanager
def _private_engine() -> Iterator[Engine]:
    _install_packages()
    folder = Path(tempfile.mkdtemp(prefix="rk"))  # short: the path of a Unix socket has 107 bytes at most
    process: subprocess.Popen[bytes] | None = None
    try:
        environment = {**os.environ, "DOCKER_HOST": f"unix://{folder}/s"}
        process = _start(folder, environment)
        environment["BASE_IMAGE"] = _make_base_image(folder, environment)
        yield Engine(environment, ("docker-compose",))
    finally:
        if process is not None:
            process.terminate()
            process.wait(START_S)
        _remove(folder)


def _install_packages() -> None:
    missing = sorted(package for program, package in PROGRAMS.items() if not shutil.which(program))
    if os.geteuid() != 0:
        raise CannotRun("no Docker engine answers, and only root can start one")
    if not missing:
        return
    if not shutil.which("apt-get"):
        raise CannotRun(f"no Docker engine answers, and {', '.join(missing)} to start one are not here: install them")
    apt = ["apt-get", "-o", "DPkg::Lock::Timeout=300", "-qq"]
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    try:
        run([*apt, "update"], environment)
        run([*apt, "install", "-y", "--no-install-recommends", *missing], environment)
    except RuntimeError as error:
        raise CannotRun(f"no Docker engine answers, and {', '.join(missing)} cannot be installed: {error}") from None


def _start(folder: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """Start the daemon and wait until it responds. It changes neither the machine's firewall nor its bridges."""
    command = ["dockerd", "--data-root", f"{folder}/data", "--exec-root", f"{folder}/x", "-p", f"{folder}/pid"]
    command += ["-H", environment["DOCKER_HOST"], "--bridge=none", "--iptables=false", "--ip6tables=false"]
    command += ["--ip-forward=false", "--ip-masq=false"]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    deadline = time.monotonic() + START_S
    while not _quiet(["docker", "info"], environment):
        if process.poll() is not None or time.monotonic() > deadline:
            process.kill()
            process.wait()
            last = "\n".join((folder / "log").read_text(errors="replace").splitlines()[-5:])
            raise CannotRun(f"dockerd does not start on this machine; its last words:\n{last}")
        time.sleep(POLL_S)
    return process


def _make_base_image(folder: Path, environment: Mapping[str, str]) -> str:
    """Debian 12 with its Python, and this machine's certificates for what the build downloads."""
    sources = [path for path in map(Path, ("/etc/apt/sources.list.d/debian.sources", "/etc/apt/sources.list"))]
    source = next((path for path in sources if path.is_file()), None)
    if source is None:
        raise CannotRun("this machine has no Debian package sources to make a base image from")
    archive = folder / "base.tar"
    command = ["mmdebstrap", "-q", "--variant=minbase", "--mode=root"]
    command += ["--include=python3-minimal,python3-pip,python3-venv,ca-certificates"]
    command += [f"--dpkgopt=path-exclude=/usr/share/{name}/*" for name in ("doc", "man", "locale")]
    command += ['--customize-hook=ln -s python3 "$1/usr/bin/python"']
    if Path(f"/{CERTIFICATES}").is_file():
        command += [f'--customize-hook=cp /{CERTIFICATES} "$1/{CERTIFICATES}"']
    run([*command, "bookworm", str(archive), str(source)], environment)
    run(["docker", "import", "-c", f"ENV PIP_CERT=/{CERTIFICATES}", str(archive), BASE_IMAGE], environment)
    archive.unlink()
    return BASE_IMAGE


def _remove(folder: Path) -> None:
    mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
    for mount in reversed([mount for mount in mounts if mount.startswith(f"{folder}/")]):
        subprocess.run(["umount", "-l", mount], stderr=subprocess.DEVNULL)
    shutil.rmtree(folder, ignore_errors=True)


def _quiet(command: Sequence[str], environment: Mapping[str, str]) -> bool:
    """True if a command succeeds."""
    return (
        subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0
    )

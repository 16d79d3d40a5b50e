#!/bin/sh
# Make .venv with the pinned requirements. Needs Python 3.11 or newer; installs Debian's venv package if it is missing.
set -eu
PYTHON=${PYTHON:-python3.11}

command -v "$PYTHON" >/dev/null 2>&1 || PYTHON=python3
if ! "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    echo "setup: Python 3.11 or newer is needed; say which with 'make setup PYTHON=/path/to/python3.11'" >&2
    exit 1
fi
if ! "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null; then
    version=$("$PYTHON" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
        echo "setup: installing python$version-venv"
        apt-get -o DPkg::Lock::Timeout=300 update -qq
        DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 install -y -qq "python$version-venv" >/dev/null
    else
        echo "setup: $PYTHON has no venv module; run: sudo apt-get install python$version-venv" >&2
        exit 1
    fi
fi

echo "setup: making .venv and installing the pinned requirements (about a minute)"
"$PYTHON" -m venv .venv
.venv/bin/python -m pip install -q --disable-pip-version-check --require-hashes -r requirements/dev.txt
.venv/bin/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .

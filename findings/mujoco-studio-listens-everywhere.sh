#!/bin/sh
# mujoco==4.0.0 (mujoco-studio==4.0.0), numpy==2.4.6; Linux x86-64, Python 3.11, seen 2026-11-28.
# The web viewer of mujoco.studio listens on every interface ("::"), without authentication or encryption, and has no setting for another
# address: ViewerConfig has the port alone. Whoever reaches the port sees the page and may drop a model onto it, which is then parsed here.
# Seen: "listens on ::". Fails if it listens on loopback, or has a setting for the host.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==4.0.0 numpy==2.4.6
cat > listens.py <<'PY'
import contextlib
import dataclasses
import io

import mujoco
from mujoco.studio import launch_web, viewer_protocol
from mujoco.studio.web import web_server

hosts = []
bind = web_server.bind_public_socket


def recorded(host, port=0):
    hosts.append(host)
    return bind("127.0.0.1", port)


web_server.bind_public_socket = recorded
with contextlib.redirect_stdout(io.StringIO()), launch_web.launch() as handle:
    handle.set_model(mujoco.MjModel.from_xml_string("<mujoco/>"))
    while not hosts:
        handle.sync()
settings = {field.name for field in dataclasses.fields(viewer_protocol.ViewerConfig)}
print("listens on", *hosts)
assert hosts == ["::"], hosts
assert not settings & {"host", "address", "http_host", "bind"}, settings
PY
venv/bin/python listens.py

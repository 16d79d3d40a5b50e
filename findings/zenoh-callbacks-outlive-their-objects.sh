#!/bin/sh
# eclipse-zenoh==1.10.2; Python 3.11, Linux, seen 2026-11-27.
# What happens to a declaration that nothing refers to any more depends on how it was declared. A liveliness token and a subscriber with a channel are
# undeclared as soon as the Python object is collected. A subscriber or queryable with a callback is not: it goes on receiving and answering until
# the session closes, and cannot be undeclared by then, since its object is gone.
# Seen: after collection, token 0 alive, callback subscriber received 1 sample, callback queryable gave 1 reply. Fails if any of these changes.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check eclipse-zenoh==1.10.2
cat > declared.py <<'PY'
import gc
import socket
import threading

import zenoh

with socket.socket() as probe:
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
config = zenoh.Config()
config.insert_json5("mode", '"peer"')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
received = threading.Event()
with zenoh.open(config) as session:

    def declare():
        session.declare_subscriber("sample/key", lambda sample: received.set())
        session.declare_queryable("query/key", lambda query: query.reply("query/key", b"reply"))
        session.liveliness().declare_token("token/key")

    declare()
    gc.collect()
    session.put("sample/key", b"1")
    heard = received.wait(5)
    replies = len(list(session.get("query/key")))
    tokens = len(list(session.liveliness().get("token/*")))
    print("subscriber received:", heard, "replies:", replies, "tokens:", tokens)
    assert heard and replies == 1 and tokens == 0
PY
venv/bin/python declared.py

"""The transport over real Zenoh on loopback: answers, publications, liveliness, and what happens when one side goes."""

import contextlib
import gc
import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from queue import Queue

import pytest

from common.errors import SessionError
from common.wire.endpoint import free_port
from common.wire.session import Request, open_session

WAIT_S = 10
MAX_MESSAGE = 10_000_000
SETTLED = itertools.count()

ACTOR = """
import sys
from common.wire.session import open_session
with open_session(connect=[sys.argv[1]], connect_timeout_s=10, max_message_size=1000) as session:
    session.declare_alive("t/alive/actor/child")
    print("alive", flush=True)
    sys.stdin.read()
"""


ASKER = """
import sys, threading
from common.wire.session import open_session
with open_session(connect=[sys.argv[1]], connect_timeout_s=10, max_message_size=10_000_000, lease_s=60) as session:
    def ask():
        session.ask("t/large", b"", 60)
    threads = [threading.Thread(target=ask, daemon=True) for _ in range(int(sys.argv[2]))]
    [thread.start() for thread in threads]
    sys.stdin.read()
"""


@pytest.fixture
def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def sessions(endpoint):
    """Opens sessions that are closed after the test: `sessions(listen=True)` or `sessions()` to connect."""
    with contextlib.ExitStack() as stack:

        def make(*, listen=False, **changes):
            options = {"connect_timeout_s": WAIT_S, "max_message_size": MAX_MESSAGE, **changes}
            ends = {"listen": [endpoint]} if listen else {"connect": [endpoint]}
            return stack.enter_context(open_session(**ends, **options))

        yield make


def within(seconds, attempt):
    """What `attempt` returns once it does not raise `SessionError`, or its error after `seconds`.

    Declarations reach the other side a moment after they are made.
    """
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while True:
        try:
            return attempt()
        except SessionError:
            if time.monotonic() > deadline:
                raise
            pause.wait(0.01)


def settle(declarer, other):
    """Wait until what `declarer` has declared so far is known to `other`: declarations arrive in order."""
    key = f"t/settled/{next(SETTLED)}"
    declarer.serve(key, lambda request: request.reply(b"yes"))
    assert within(WAIT_S, lambda: other.ask(key, b"", 5)) == b"yes"


def test_ask_and_serve(sessions):
    """A question on a key below a wildcard is answered, and the handler sees key and payload."""
    learner, actor = sessions(listen=True), sessions()
    seen = Queue()

    def handler(request):
        seen.put((request.key, request.payload))
        request.reply(request.payload[::-1])

    learner.serve("t/rollout/*", handler)
    settle(learner, actor)
    assert actor.ask("t/rollout/3", b"abc", 5) == b"cba"
    assert seen.get(timeout=WAIT_S) == ("t/rollout/3", b"abc")
    assert actor.ask("t/rollout/4", b"", 5) == b""
    assert seen.get(timeout=WAIT_S) == ("t/rollout/4", b"")


def test_a_deferred_answer(sessions):
    """A request may be answered later by another thread, while the handler takes further requests."""
    learner, actor = sessions(listen=True), sessions()
    requests, answers = Queue(), Queue()
    learner.serve("t/q", requests.put)
    settle(learner, actor)
    askers = [threading.Thread(target=lambda: answers.put(actor.ask("t/q", b"x", WAIT_S))) for _ in range(2)]
    for asker in askers:
        asker.start()
    for answer in (b"first", b"second"):
        requests.get(timeout=WAIT_S).reply(answer)
    for asker in askers:
        asker.join(WAIT_S)
    assert {answers.get(timeout=WAIT_S) for _ in range(2)} == {b"first", b"second"}


def test_a_request_is_answered_once():
    """A second answer is a mistake of the program, and does not go out."""
    answers = []
    request = Request("k", b"", answers.append)
    request.reply(b"1")
    with pytest.raises(RuntimeError, match="a request on k was answered twice"):
        request.reply(b"2")
    assert answers == [b"1"]


def test_a_dropped_request_ends_the_wait(sessions):
    """An asker is told at once when its request was thrown away, long before its timeout."""
    learner, actor = sessions(listen=True), sessions()
    learner.serve("t/q", lambda request: None)
    settle(learner, actor)
    started = time.monotonic()
    with pytest.raises(SessionError, match="no answer on t/q"):
        actor.ask("t/q", b"", 60)
    assert time.monotonic() - started < 30


def test_no_answer_in_time(sessions):
    """A request that nobody answers ends after its timeout, with the key and the time; a late answer does no harm."""
    learner, actor = sessions(listen=True), sessions()
    requests = Queue()
    learner.serve("t/q", requests.put)
    learner.serve("t/ok", lambda request: request.reply(b"ok"))
    settle(learner, actor)
    started = time.monotonic()
    with pytest.raises(SessionError, match=r"no answer on t/q within 0\.3 s: the other side is busy or stopped"):
        actor.ask("t/q", b"", 0.3)
    assert 0.2 < time.monotonic() - started < 5
    requests.get(timeout=WAIT_S).reply(b"late")
    assert actor.ask("t/ok", b"", 5) == b"ok"


def test_nobody_serves(sessions):
    """A key that nobody serves is told at once."""
    sessions(listen=True)
    started = time.monotonic()
    with pytest.raises(SessionError, match="no answer on t/none: nobody connected serves it"):
        sessions().ask("t/none", b"", 60)
    assert time.monotonic() - started < 30


def test_large_payloads(sessions):
    """8 MB travel in both directions, byte for byte."""
    learner, actor = sessions(listen=True), sessions()
    learner.serve("t/echo", lambda request: request.reply(request.payload))
    payload = os.urandom(8_000_000)
    settle(learner, actor)
    assert actor.ask("t/echo", payload, WAIT_S) == payload


def test_the_largest_message(sessions):
    """A message of exactly the agreed size passes; a larger one is refused before it is sent, with both sizes."""
    learner, actor = sessions(listen=True), sessions()
    learner.serve("t/q", lambda request: request.reply(b"ok"))
    settle(learner, actor)
    assert actor.ask("t/q", bytes(MAX_MESSAGE), WAIT_S) == b"ok"
    expected = r"a message of 10,000,001 bytes on t/.; 10,000,000 are allowed"
    with pytest.raises(SessionError, match=expected):
        actor.ask("t/q", bytes(MAX_MESSAGE + 1), WAIT_S)
    with pytest.raises(SessionError, match=expected):
        actor.publisher("t/p").put(bytes(MAX_MESSAGE + 1))


def test_a_peer_that_sends_too_much(sessions):
    """A receiver drops what is larger than it allows, and the sender learns why it may have had no answer."""
    learner, actor = sessions(listen=True, max_message_size=1000), sessions()
    seen = Queue()

    def handler(request):
        seen.put(len(request.payload))
        request.reply(b"ok")

    learner.serve("t/q", handler)
    settle(learner, actor)
    with pytest.raises(SessionError, match="refuses messages as large as 1,000,000 bytes"):
        actor.ask("t/q", bytes(1_000_000), 0.5)
    assert actor.ask("t/q", bytes(10), 5) == b"ok"
    assert seen.get(timeout=WAIT_S) == 10


@pytest.mark.parametrize("options", [{}, {"express": True, "high_priority": True}])
def test_publish_and_subscribe(sessions, options):
    """What is put reaches subscribers of the key and of a wildcard.

    One at a time: a put that finds the line busy is dropped, which a loaded machine may make of ten at once.
    """
    learner, actor = sessions(listen=True), sessions()
    exact, wild = Queue(), Queue()
    actor.subscribe("t/policy/notify", lambda key, data: exact.put((key, data)))
    actor.subscribe("t/policy/*", lambda key, data: wild.put((key, data)))
    settle(actor, learner)
    publisher = learner.publisher("t/policy/notify", **options)
    for i in range(10):
        publisher.put(bytes([i]))
        assert exact.get(timeout=WAIT_S) == ("t/policy/notify", bytes([i]))
        assert wild.get(timeout=WAIT_S) == ("t/policy/notify", bytes([i]))


def test_a_patient_publisher_waits_for_slow_subscribers(sessions):
    """Nothing is lost of 20,000 puts, far more at once than the subscriber takes; others lose a fifth of them."""
    learner, actor = sessions(listen=True), sessions()
    seen = Queue()
    actor.subscribe("t/metrics", lambda key, data: seen.put(int.from_bytes(data[:4], "big")))
    settle(actor, learner)
    publisher = learner.publisher("t/metrics", patient=True)
    for number in range(20_000):
        publisher.put(number.to_bytes(4, "big") + bytes(1000))
    assert [seen.get(timeout=WAIT_S) for _ in range(20_000)] == list(range(20_000))


def test_what_a_handler_raises(sessions):
    """An error in a handler is reported with its key, ends the asker's wait, and the next request is served."""
    errors = Queue()
    learner = sessions(listen=True, on_error=lambda key, error: errors.put((key, error)))
    actor = sessions()

    def handler(request):
        if request.payload == b"bad":
            raise ValueError("boom")
        request.reply(b"ok")

    learner.serve("t/q", handler)
    settle(learner, actor)
    started = time.monotonic()
    with pytest.raises(SessionError, match="no answer on t/q"):
        actor.ask("t/q", b"bad", 60)
    assert time.monotonic() - started < 30
    key, error = errors.get(timeout=WAIT_S)
    assert (key, type(error), str(error)) == ("t/q", ValueError, "boom")
    assert actor.ask("t/q", b"good", 5) == b"ok"


def test_errors_of_handlers_are_logged(sessions, caplog):
    """Without an `on_error` the log has the key and the error."""
    learner, actor = sessions(listen=True), sessions()
    learner.serve("t/q", lambda request: 1 // 0)
    settle(learner, actor)
    with pytest.raises(SessionError):
        actor.ask("t/q", b"", WAIT_S)
    (record,) = caplog.records
    assert record.getMessage() == "a handler of t/q failed"
    assert record.exc_info[0] is ZeroDivisionError


def test_liveliness_of_a_session(sessions):
    """A token is seen when it is declared and when its session closes; a late watcher sees those already there."""
    learner, actor = sessions(listen=True), sessions()
    early, late = Queue(), Queue()
    learner.watch_alive("t/alive/*/*", lambda key, alive: early.put((key, alive)))
    actor.declare_alive("t/alive/actor/1")
    assert early.get(timeout=WAIT_S) == ("t/alive/actor/1", True)
    learner.watch_alive("t/alive/*/*", lambda key, alive: late.put((key, alive)))
    assert late.get(timeout=WAIT_S) == ("t/alive/actor/1", True)
    actor.close()
    assert early.get(timeout=WAIT_S) == ("t/alive/actor/1", False)
    assert late.get(timeout=WAIT_S) == ("t/alive/actor/1", False)


def test_a_late_joiner_sees_history(sessions):
    """A process that connects last learns of tokens declared before it came."""
    learner = sessions(listen=True)
    learner.declare_alive("t/alive/learner/0")
    seen = Queue()
    sessions().watch_alive("t/alive/*/*", lambda key, alive: seen.put((key, alive)))
    assert seen.get(timeout=WAIT_S) == ("t/alive/learner/0", True)


def test_a_killed_process_is_noticed(sessions, endpoint):
    """A process that is killed without warning loses its token."""
    learner = sessions(listen=True)
    seen = Queue()
    learner.watch_alive("t/alive/*/*", lambda key, alive: seen.put((key, alive)))
    command = [sys.executable, "-c", ACTOR, endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout.readline() == b"alive\n"
            assert seen.get(timeout=WAIT_S) == ("t/alive/actor/child", True)
        finally:
            os.kill(child.pid, signal.SIGKILL)
        assert seen.get(timeout=WAIT_S) == ("t/alive/actor/child", False)


def test_a_peer_that_does_not_read_holds_up_nobody(sessions, endpoint):
    """One asks for 16 answers of 8 MB and stops reading: the thread that gives them goes on at once, and others are
    answered on the same key, long before Zenoh gives the first up after 30 s."""
    learner, large = sessions(listen=True, lease_s=60), bytes(8_000_000)
    asked, count = Queue(), 16
    learner.serve("t/large", lambda request: request.reply(b"small") if request.payload else asked.put(request))
    command = [sys.executable, "-c", ASKER, endpoint, str(count)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as child:
        try:
            waiting = [asked.get(timeout=30) for _ in range(count)]
            os.kill(child.pid, signal.SIGSTOP)
            other = sessions()
            began_s = time.monotonic()
            for request in waiting:
                request.reply(large)
            assert within(WAIT_S, lambda: other.ask("t/large", b"?", WAIT_S)) == b"small"
            assert time.monotonic() - began_s < 2 * WAIT_S
        finally:
            os.kill(child.pid, signal.SIGKILL)


def test_actors_wait_for_a_learner_and_for_its_return(sessions):
    """An actor may start first, and works on with the same session when the learner comes back."""
    actor = sessions(connect_timeout_s=None)
    actor.declare_alive("t/alive/actor/1")
    told = Queue()
    actor.subscribe("t/notify", lambda key, data: told.put(data))
    with pytest.raises(SessionError, match="nobody connected serves it"):
        actor.ask("t/join", b"", WAIT_S)
    for life in (b"first", b"second"):
        learner = sessions(listen=True)
        alive = Queue()
        learner.watch_alive("t/alive/*/*", lambda key, is_alive, alive=alive: alive.put((key, is_alive)))
        learner.serve("t/join", lambda request, life=life: request.reply(life))
        assert within(WAIT_S, lambda: actor.ask("t/join", b"", 5)) == life
        assert alive.get(timeout=WAIT_S) == ("t/alive/actor/1", True)
        settle(actor, learner)
        learner.publisher("t/notify").put(life)
        assert told.get(timeout=WAIT_S) == life
        learner.close()


def test_the_answerer_goes_away(sessions):
    """An asker is told at once when the other side leaves before it answers."""
    learner, actor = sessions(listen=True), sessions()
    requests, outcome = Queue(), Queue()
    learner.serve("t/q", requests.put)

    def ask():
        try:
            actor.ask("t/q", b"", 60)
        except SessionError as error:
            outcome.put(str(error))

    settle(learner, actor)
    asker = threading.Thread(target=ask)
    asker.start()
    kept = requests.get(timeout=WAIT_S)
    learner.close()
    assert outcome.get(timeout=WAIT_S) == "no answer on t/q: nobody connected serves it, or left"
    asker.join(WAIT_S)
    with contextlib.suppress(SessionError):
        kept.reply(b"too late")


def test_nobody_at_the_address(endpoint):
    """Without a learner the wait ends in time, in a sentence with the address and the likely causes."""
    started = time.monotonic()
    with pytest.raises(SessionError) as caught:
        open_session(connect=[endpoint], connect_timeout_s=0.6, max_message_size=1000)
    assert 0.5 < time.monotonic() - started < 5
    for part in (endpoint, "0.6 s", "no learner is running", "address or the port", "firewall", "TLS", "password"):
        assert part in str(caught.value)


def test_waiting_can_be_interrupted(endpoint):
    """Ctrl-C ends the wait for a learner."""

    def interrupt(number, frame):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 1)
        started = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            open_session(connect=[endpoint], connect_timeout_s=60, max_message_size=1000)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert time.monotonic() - started < 30


def test_a_busy_port(endpoint, sessions):
    """A port that another process has is named, with what to do."""
    sessions(listen=True)
    port = endpoint.rpartition(":")[2]
    with pytest.raises(SessionError, match=f"port {port} of {endpoint} is in use: stop the process that has it"):
        open_session(listen=[endpoint], max_message_size=1000)


def test_an_address_of_another_machine():
    """An address that this machine does not have is named as such (192.0.2.0/24 is nobody's)."""
    with pytest.raises(SessionError, match="is not an address of this machine"):
        open_session(listen=[f"tcp/192.0.2.1:{free_port()}"], max_message_size=1000)


@pytest.mark.parametrize("ends", [{"listen": ["nonsense"]}, {"connect": ["tcp/127.0.0.1:0"]}])
def test_what_is_not_an_address(ends):
    """An impossible address is refused before anything is opened."""
    with pytest.raises(SessionError, match="is not an address: give <protocol>/<host>:<port>"):
        open_session(**ends, max_message_size=1000)


def test_unknown_options(endpoint):
    """A setting that Zenoh does not have is named."""
    with pytest.raises(SessionError, match="Zenoh has no setting transport/nonsense = 1"):
        open_session(listen=[endpoint], max_message_size=1000, options={"transport/nonsense": 1})


def test_passwords(endpoint, tmp_path, sessions):
    """A user with the right password connects; without it there is no connection."""
    users = tmp_path / "users"
    users.write_text("actor:secret\n")
    known = {"transport/auth/usrpwd/user": "learner", "transport/auth/usrpwd/password": "x"}
    learner = sessions(listen=True, options={**known, "transport/auth/usrpwd/dictionary_file": str(users)})
    learner.serve("t/q", lambda request: request.reply(b"ok"))
    user = {"transport/auth/usrpwd/user": "actor"}
    actor = sessions(options={**user, "transport/auth/usrpwd/password": "secret"})
    settle(learner, actor)
    assert actor.ask("t/q", b"", 5) == b"ok"
    with pytest.raises(SessionError, match="a certificate, user or password was not accepted"):
        sessions(connect_timeout_s=0.6, options={**user, "transport/auth/usrpwd/password": "wrong"})


def test_only_the_given_address_is_listened_on(sessions):
    """A session that only connects accepts nobody, and the listening one only on loopback."""
    sessions(listen=True)
    sessions()
    inodes = {os.readlink(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd") if fd_exists(fd)}
    bound = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        with open(f"/proc/net/{table}") as lines:
            rows = [line.split() for line in lines.readlines()[1:]]
        listening = {"tcp": "0A", "udp": "07"}[table[:3]]
        bound += [row[1] for row in rows if row[3] == listening and f"socket:[{row[9]}]" in inodes]
    # 127.0.0.1 as the kernel writes it.
    assert [address.partition(":")[0] for address in bound] == ["0100007F"]


def fd_exists(fd):
    return os.path.lexists(f"/proc/self/fd/{fd}")


def test_closing_twice_and_using_after(sessions):
    """Closing again is nothing; using a closed session is an error in one sentence."""
    learner = sessions(listen=True)
    publisher = learner.publisher("t/p")
    learner.serve("t/q", lambda request: request.reply(b""))
    learner.close()
    learner.close()
    for use in (
        lambda: learner.ask("t/q", b"", 1),
        lambda: learner.subscribe("t/q", print),
        lambda: learner.declare_alive("t/a"),
        lambda: publisher.put(b""),
    ):
        with pytest.raises(SessionError):
            use()


def test_closing_from_a_handler(sessions):
    """A handler may close its own session."""
    learner, actor = sessions(listen=True), sessions()
    closed = threading.Event()

    def stop(request):
        request.reply(b"bye")
        learner.close()
        closed.set()

    learner.serve("t/stop", stop)
    settle(learner, actor)
    assert actor.ask("t/stop", b"", 5) == b"bye"
    assert closed.wait(WAIT_S)


def test_a_closed_port_is_free_again(sessions, endpoint):
    """After close another process can listen on the port."""
    sessions(listen=True).close()
    gc.collect()
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", int(endpoint.rpartition(":")[2])))

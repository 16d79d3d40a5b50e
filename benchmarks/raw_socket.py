"""Messages over bare TCP on loopback, each acknowledged before the next: the machine's own limit.

`python -m benchmarks.raw_socket PORT BYTES` is a sender, which goes on until the receiver closes the connection.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

from benchmarks.processes import bare_environment

ACKNOWLEDGED = b"!"
_CHUNK = 1 << 20


def receive(size: int, senders: int, seconds: float) -> float:
    """Bytes per second that this process receives from `senders` processes in messages of `size` bytes."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        command = [sys.executable, "-m", "benchmarks.raw_socket", str(port), str(size)]
        processes = [subprocess.Popen(command, env=bare_environment()) for _ in range(senders)]
        try:
            connections = [server.accept()[0] for _ in processes]
            return _count(connections, size, seconds)
        finally:
            for process in processes:
                process.kill()
                process.wait()


def _count(connections: Sequence[socket.socket], size: int, seconds: float) -> float:
    """Receive with one thread per connection, timed together from the first message on."""
    over = threading.Event()
    counts = [0] * len(connections)

    def read(number: int) -> None:
        with suppress(OSError):  # the connection is shut down under it when the time is over
            while not over.is_set() and _take(connections[number], size):
                connections[number].sendall(ACKNOWLEDGED)
                counts[number] += 1

    threads = [threading.Thread(target=read, args=(number,)) for number in range(len(connections))]
    began_s = time.perf_counter()
    for thread in threads:
        thread.start()
    over.wait(seconds)
    total, took_s = sum(counts), time.perf_counter() - began_s
    over.set()
    for thread, connection in zip(threads, connections, strict=True):
        connection.shutdown(socket.SHUT_RDWR)
        thread.join()
        connection.close()
    return total * size / took_s


def _take(connection: socket.socket, size: int) -> bool:
    """Read one message; True if it was complete."""
    buffer = memoryview(bytearray(min(size, _CHUNK)))
    while size:
        got = connection.recv_into(buffer, min(size, _CHUNK))
        if not got:
            return False
        size -= got
    return True


def send(port: int, size: int) -> None:
    """Send messages of `size` bytes until the connection is closed."""
    message = bytes(size)
    with socket.create_connection(("127.0.0.1", port)) as connection:
        try:
            while True:
                connection.sendall(message)
                if connection.recv(1) != ACKNOWLEDGED:
                    return
        except OSError:
            return


if __name__ == "__main__":
    send(int(sys.argv[1]), int(sys.argv[2]))

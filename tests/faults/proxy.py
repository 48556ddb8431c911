"""Test part: a TCP proxy on loopback between a client and a server, which makes the line bad."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from faults import children


@dataclass(frozen=True)
class BadLine:
    """How bad.

    Args:
        delay: Seconds that each piece of data waits.
        after: Bytes from clients after which ``then`` happens; None for never.
        then: ``"cut"`` closes every connection, now and later; ``"hang"`` lets nothing through
            and keeps connections open; ``"kill"`` ends the process group ``victim`` with
            SIGKILL, and so cuts.
        victim: A process group.
    """

    delay: float = 0.0
    after: int | None = None
    then: str = "cut"
    victim: int = 0


@contextmanager
def proxy(target: str, line: BadLine) -> Iterator[str]:
    """The URL of a bad line to ``http://host:port``, in a process of its own."""
    host, port = target.removeprefix("http://").split(":")
    listener = socket.create_server(("127.0.0.1", 0))
    own = listener.getsockname()[1]
    child = children.start(lambda: _serve(listener, (host, int(port)), line))
    listener.close()
    try:
        yield f"http://127.0.0.1:{own}"
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.wait()


class _State:
    def __init__(self, line: BadLine) -> None:
        self.line = line
        self.lock = threading.Lock()
        self.seen = 0
        self.broken = False

    def count(self, size: int) -> None:
        """Note bytes of a client; the line breaks at the one that is too many."""
        with self.lock:
            self.seen += size
            if self.broken or self.line.after is None or self.seen < self.line.after:
                return
            self.broken = True
            if self.line.then == "kill":
                os.killpg(self.line.victim, signal.SIGKILL)


def _serve(listener: socket.socket, target: tuple[str, int], line: BadLine) -> None:
    state = _State(line)
    while True:
        client, _ = listener.accept()
        threading.Thread(target=_connect, args=(client, target, state), daemon=True).start()


def _connect(client: socket.socket, target: tuple[str, int], state: _State) -> None:
    state.count(0)
    try:
        if state.broken and state.line.then != "hang":
            return
        server = socket.create_connection(target)
    except OSError:
        return
    finally:
        if state.broken and state.line.then != "hang":
            client.close()
    back = threading.Thread(
        target=_pass, args=(server, client, state, lambda size: None), daemon=True
    )
    back.start()
    _pass(client, server, state, state.count)


def _pass(
    source: socket.socket, sink: socket.socket, state: _State, count: Callable[[int], None]
) -> None:
    try:
        while data := source.recv(1 << 16):
            count(len(data))
            while state.broken and state.line.then == "hang":
                time.sleep(0.1)  # for ever: this process is killed in the end
            if state.broken:
                break
            time.sleep(state.line.delay)
            sink.sendall(data)
    except OSError:
        pass
    finally:
        for end in (source, sink):
            end.close()

"""Test double of a publisher's server: files over HTTP on 127.0.0.1, with all that can go wrong."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Served:
    """A file on the server, and how the server behaves when it is asked for."""

    content: bytes
    break_after: list[int] = field(default_factory=list)
    """For each of the next answers: how many bytes of the body before the connection is cut."""
    stall_after: int | None = None
    """Send so many bytes of the body, then nothing, until ``resume`` is set."""
    resume: threading.Event = field(default_factory=threading.Event)
    statuses: list[int] = field(default_factory=list)
    """The next answers are these, without a file."""
    ranges: bool = True
    """Whether Range is minded."""
    if_range: bool = True
    """Whether If-Range is minded."""
    shift: int = 0
    """Answers to Range begin so many bytes before what was asked for."""
    etag: bool = True
    weak: bool = False
    """The entity tag is a weak one, which must not be compared."""
    modified: str | None = None
    length: int | None = None
    """A Content-Length that is a lie."""
    chunked: bool = False
    """Say no length."""
    redirect: str | None = None
    """Answer 302 with this place; X-Linked-ETag comes with the redirect, as on Hugging Face."""
    linked: str | None = None
    """X-Linked-ETag."""

    @property
    def tag(self) -> str:
        return f'{"W/" if self.weak else ""}"{hashlib.md5(self.content).hexdigest()}"'

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.content).hexdigest()


class WeightsServer:
    """What runs behind :func:`weights_server`."""

    def __init__(self) -> None:
        self.files: dict[str, Served] = {}
        self.requests: list[tuple[str, dict[str, str]]] = []
        self.port = 0

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self.port}/{name}"

    def ranges(self) -> list[str | None]:
        """The Range header of each request, in order."""
        return [headers.get("Range") for _, headers in self.requests]


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Server

    def do_GET(self) -> None:
        shop = self.server.shop
        name = self.path.lstrip("/")
        shop.requests.append((name, dict(self.headers.items())))
        served = shop.files.get(name)
        if served is None:
            self._bare(404)
        elif served.statuses:
            self._bare(served.statuses.pop(0))
        elif served.redirect is not None:
            self._bare(302, {"Location": served.redirect} | self._linked(served))
        else:
            self._send(served)

    def _send(self, served: Served) -> None:
        total, start = len(served.content), 0
        wanted = self.headers.get("Range")
        condition = self.headers.get("If-Range")
        known = (served.tag if served.etag else None, served.modified)
        if (
            wanted
            and served.ranges
            and (condition is None or not served.if_range or condition in known)
        ):
            start = int(wanted.removeprefix("bytes=").partition("-")[0]) - served.shift
            if start >= total:
                return self._bare(416, {"Content-Range": f"bytes */{total}"})
        body = served.content[start:]
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{total - 1}/{total}")
        if served.etag:
            self.send_header("ETag", served.tag)
        if served.modified:
            self.send_header("Last-Modified", served.modified)
        for key, value in self._linked(served).items():
            self.send_header(key, value)
        if served.chunked:
            self.send_header("Transfer-Encoding", "chunked")
            body = b"%x\r\n%s\r\n0\r\n\r\n" % (len(body), body)
        else:
            self.send_header("Content-Length", str(served.length or len(body)))
        self.end_headers()
        self.close_connection = True
        if served.stall_after is not None:
            self.wfile.write(body[: served.stall_after])
            served.resume.wait(60)
            return None
        cut = served.break_after.pop(0) if served.break_after else len(body)
        self.wfile.write(body[:cut])
        return None

    def _bare(self, code: int, headers: dict[str, str] | None = None) -> None:
        self.send_response(code)
        for key, value in (headers or {}).items():
            self.send_header(key, value)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _linked(self, served: Served) -> dict[str, str]:
        return {"X-Linked-ETag": f'"{served.linked}"'} if served.linked else {}

    def log_message(self, *arguments: object) -> None:
        """Nothing on standard error."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, shop: WeightsServer) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.shop = shop

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that went away is what some tests are about."""


@contextmanager
def weights_server() -> Iterator[WeightsServer]:
    """A server that runs as long as the block."""
    shop = WeightsServer()
    with _Server(shop) as server:
        shop.port = server.server_address[1]
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        try:
            yield shop
        finally:
            for served in shop.files.values():
                served.resume.set()
            server.shutdown()
            thread.join()

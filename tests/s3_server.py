"""An S3 server on 127.0.0.1 (moto's, in a process of its own), that tests may kill and restart."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from typing import Any

import fsspec

KEY, SECRET = "test-key", "test-secret"

_SERVE = """
import sys, threading
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer("127.0.0.1", int(sys.argv[1]), verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
threading.Event().wait()
"""


class S3Server:
    """The server; its content is in memory and gone when it is killed."""

    def __init__(self) -> None:
        self.port = 0
        self._process: subprocess.Popen[str] | None = None
        self._buckets = 0
        self.start()

    @property
    def settings(self) -> dict[str, Any]:
        """What fsspec has to know to reach it."""
        return {"key": KEY, "secret": SECRET, "endpoint_url": f"http://127.0.0.1:{self.port}"}

    @property
    def environment(self) -> dict[str, str]:
        """The same for other processes."""
        named = {f"FSSPEC_S3_{name.upper()}": value for name, value in self.settings.items()}
        return {**os.environ, **named}

    def start(self) -> None:
        """Start it, on the port that it had before."""
        self._process = subprocess.Popen(
            [sys.executable, "-c", _SERVE, str(self.port)],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._process.stdout is not None
        watch = threading.Timer(60, self._process.kill)
        watch.start()
        line = self._process.stdout.readline()
        watch.cancel()
        assert line, "the S3 server did not start"
        self.port = int(line)

    def kill(self) -> None:
        """End it as a crash would."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def files(self) -> Any:
        """An fsspec file system of its own, for looking at and damaging what is stored."""
        return fsspec.filesystem("s3", use_listings_cache=False, **self.settings)

    def new_bucket(self, name: str = "") -> str:
        """Make a bucket; returns its name."""
        self._buckets += 1
        name = name or f"bucket-{self._buckets}"
        self.files().mkdir(name)
        return name

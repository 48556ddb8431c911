"""MLflow's own pages over the project's store, for this machine only."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType, TracebackType
from urllib.error import URLError
from urllib.request import ProxyHandler, build_opener

from gvr_core.errors import GVRError
from reports.addresses import check_address, free_port
from reports.mlflow_store import LocalStore, create_store, local_store, quiet_environment

START_SECONDS = 120.0
"""A first start on a busy two-core machine was seen to take 37 s."""
STOP_SECONDS = 10.0


class ServerError(GVRError):
    """The MLflow server ended or did not answer."""


class MlflowServer:
    """A running server. Leaving its context, or `stop`, ends it and its workers."""

    def __init__(self, process: subprocess.Popen[bytes], url: str, log: Path) -> None:
        self.process = process
        self.url = url
        """Where its pages are."""
        self.log = log
        """What it wrote."""
        self._stopped = False

    def __enter__(self) -> MlflowServer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def wait(self) -> int:
        """Wait until the server ends by itself; return its exit code."""
        return self.process.wait()

    def stop(self) -> None:
        """End the server: politely, and after `STOP_SECONDS` by force. Twice does no harm."""
        if self._stopped:
            return  # by now the number may be that of somebody else's group
        if self.process.poll() is None:
            self._signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(STOP_SECONDS)
        # Workers that outlive their parent would keep the port.
        self._signal(signal.SIGKILL)
        self.process.wait()
        self._stopped = True

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)


def serve_ui(
    port: int = 5000,
    host: str = "127.0.0.1",
    store: LocalStore | None = None,
    announce: Callable[[str], None] = print,
    exposed: bool = False,
) -> None:
    """Show MLflow's pages over a store until Ctrl-C or SIGTERM, then end the server.

    Args:
        port: As for `start_server`.
        host: As for `start_server`.
        store: As for `start_server`.
        announce: Called once with the address, when the pages answer.
        exposed: As for `start_server`.

    Raises:
        ConfigError: as `start_server` does.
        SyncError: as `start_server` does.
        ServerError: as `start_server` does, and if the server ends by itself.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # Without a handler, SIGTERM would end this process alone and leave the server behind.
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        with start_server(port, host, store, exposed=exposed) as server:
            announce(server.url)
            code = server.wait()
            raise ServerError(f"the MLflow server ended with code {code}: {_tail(server)}")
    except KeyboardInterrupt:
        return
    finally:
        signal.signal(signal.SIGTERM, before)


def start_server(
    port: int = 5000,
    host: str = "127.0.0.1",
    store: LocalStore | None = None,
    start_seconds: float = START_SECONDS,
    exposed: bool = False,
) -> MlflowServer:
    """Start a server of MLflow's pages over a store, and wait until they answer.

    Args:
        port: TCP port; 0 takes any free one.
        host: A loopback address. MLflow asks nobody for a password, and whoever reaches it may
            delete runs.
        store: The store; default: the project's own. It is created where missing.
        start_seconds: How long to wait for the first answer.
        exposed: Any address will do: whoever reaches it is trusted.

    Raises:
        ConfigError: for a port that is taken or out of range, or an address that is not loopback.
        SyncError: if the store cannot be opened.
        ServerError: if the server ends or stays silent; with the end of what it wrote.
    """
    store = local_store() if store is None else store
    check_address(host, exposed)
    port = free_port(host, port)
    create_store(store.database)
    log = store.folder.resolve() / "server.log"
    # Artifacts are read and written as files, not through the server: the same runs can then be
    # filled both directly and through it.
    command = [
        *(sys.executable, "-m", "mlflow", "server"),
        *("--backend-store-uri", store.uri),
        *("--default-artifact-root", store.artifacts.as_uri()),
        "--no-serve-artifacts",
        *("--host", host),
        *("--port", str(port)),
        *("--workers", "1"),
    ]
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            # Its own group: Ctrl-C reaches us alone, and we end the server with all its workers.
            start_new_session=True,
            env=quiet_environment() | {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"},
        )
    shown = f"[{host}]" if ":" in host else host
    server = MlflowServer(process, f"http://{shown}:{port}", log)
    try:
        _await_answer(server, start_seconds)
    except BaseException:  # Ctrl-C while waiting must not leave it running either
        server.stop()
        raise
    return server


def _await_answer(server: MlflowServer, seconds: float) -> None:
    opener = build_opener(ProxyHandler({}))  # a proxy knows nothing of this machine's loopback
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if server.process.poll() is not None:
            raise ServerError(
                f"the MLflow server ended with code {server.process.returncode}: {_tail(server)}"
            )
        try:
            with opener.open(f"{server.url}/health", timeout=2) as answer:
                if answer.status == 200:
                    return
        except (URLError, OSError):
            time.sleep(0.1)
    raise ServerError(
        f"the MLflow server did not answer at {server.url} within {seconds:.0f} s: {_tail(server)}"
    )


def _tail(server: MlflowServer) -> str:
    text = server.log.read_text(encoding="utf-8", errors="replace").strip()
    return f"{text[-1000:] or 'it wrote nothing'} (all of it: {server.log})"

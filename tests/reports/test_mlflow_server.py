from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from urllib.request import ProxyHandler, build_opener

import psutil
import pytest
from killable_server import Server

from gvr_core.errors import ConfigError
from reports import mlflow_server
from reports.mlflow_server import MlflowServer, ServerError, start_server
from reports.mlflow_store import LocalStore


def test_pages_answer_on_loopback_alone(server: Server) -> None:
    url = server.start().url
    assert url.startswith("http://127.0.0.1:")
    with build_opener(ProxyHandler({})).open(url, timeout=10) as answer:
        assert b"<title>MLflow</title>" in answer.read()


def test_a_taken_port_is_refused(store: LocalStore) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port {port} of 127.0.0.1 .*in use") as caught:
            start_server(port, store=store)
    assert "free port" in str(caught.value.accepted)


@pytest.mark.parametrize("port", [-1, 65536])
def test_no_such_port(port: int, store: LocalStore) -> None:
    with pytest.raises(ConfigError, match=f"port {port}"):
        start_server(port, store=store)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "example.org", "::"])
def test_addresses_that_others_reach_are_refused(host: str, store: LocalStore) -> None:
    with pytest.raises(ConfigError, match="no password"):
        start_server(0, host, store)


def test_any_address_will_do_where_told(store: LocalStore) -> None:
    with start_server(0, "0.0.0.0", store, exposed=True) as server:
        port = int(server.url.rsplit(":", 1)[1])
        listening = [
            connection.laddr.ip
            for connection in psutil.net_connections("tcp")
            if connection.status == psutil.CONN_LISTEN and connection.laddr.port == port
        ]
    assert listening == ["0.0.0.0"]


def test_a_silent_server_is_ended_and_its_words_shown(store: LocalStore) -> None:
    with pytest.raises(ServerError, match=r"did not answer .* within 0 s.*server\.log"):
        start_server(0, store=store, start_seconds=0.2)
    listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(store.database) not in listed


SERVE = """
import sys
import time
from pathlib import Path
from reports.mlflow_server import serve_ui
from reports.mlflow_store import LocalStore
serve_ui(0, store=LocalStore(Path(sys.argv[1])), announce=lambda url: print(url, flush=True))
print("ended", flush=True)
"""


def test_sigterm_ends_the_command_with_its_server(store: LocalStore) -> None:
    command = [sys.executable, "-c", SERVE, str(store.folder)]
    user = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert user.stdout is not None
        port = int(user.stdout.readline().strip().rsplit(":", 1)[1])
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
        os.kill(user.pid, signal.SIGTERM)
        assert user.communicate(timeout=30)[0] == "ended\n"
        assert user.returncode == 0
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=5)
    finally:
        user.kill()


STUBBORN = """
import signal, subprocess, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
worker = subprocess.Popen(["sleep", "60"])
print(worker.pid, flush=True)
time.sleep(60)
"""


def alive(process: int) -> bool:
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_a_server_that_will_not_go_is_forced_with_its_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mlflow_server, "STOP_SECONDS", 0.2)
    process = subprocess.Popen(
        [sys.executable, "-c", STUBBORN], stdout=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    server = MlflowServer(process, "http://127.0.0.1:1", tmp_path / "log")
    server.stop()
    assert process.returncode == -signal.SIGKILL
    assert (
        psutil.wait_procs([psutil.Process(worker)] if psutil.pid_exists(worker) else [], 5)[1] == []
    )
    server.stop()
    process.stdout.close()

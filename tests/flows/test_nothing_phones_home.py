"""What a whole run connects to, looks up and listens at: this machine, and nothing else.

Every Python process of the run (the command, its Prefect server, its MLflow server) is watched
through an audit hook, and every process of it through its listening sockets.
"""

from __future__ import annotations

import ipaddress
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from reports.mlflow_server import start_server
from reports.mlflow_store import local_store

pytestmark = pytest.mark.slow

WATCH = """
import json, os, sys

_log = os.open(os.environ["WATCHED"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
_events = ("socket.connect", "socket.sendto", "socket.bind")

def _watch(event, arguments):
    if event in _events:
        address = arguments[1]
        where = address[0] if isinstance(address, tuple) else None  # else a Unix socket
    elif event in ("socket.getaddrinfo", "socket.gethostbyname"):
        where = arguments[0]
    else:
        return
    if where is not None:
        where = where.decode() if isinstance(where, bytes) else str(where)
        os.write(_log, (json.dumps([os.getpid(), event, where]) + "\\n").encode())

sys.addaudithook(_watch)
"""

SUITE = """
name = "watched"

[[datasets]]
name = "folder:{folder}"

[models]
segmenter = "oracle"
encoder = "oracle"
text_segmenter = "oracle"
"""


@pytest.fixture
def watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every Python process started from here on writes its addresses to this file."""
    hook = tmp_path / "hook"
    hook.mkdir()
    (hook / "sitecustomize.py").write_text(WATCH)
    log = tmp_path / "watched.jsonl"
    path = os.pathsep.join(filter(None, (str(hook), os.environ.get("PYTHONPATH"))))
    monkeypatch.setenv("PYTHONPATH", path)
    monkeypatch.setenv("WATCHED", str(log))
    for name in ("PREFECT_API_URL", "PREFECT_HOME", "PREFECT_PROFILE", "GVR_TELEMETRY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))  # no profile of the user's
    monkeypatch.setenv("GVR_HOME", str(tmp_path / "home"))
    return log


def listening_while(process: subprocess.Popen[str]) -> Iterator[tuple[str, int]]:
    """Addresses that a process and its children listen at, until it ends."""
    parent = psutil.Process(process.pid)
    while process.poll() is None:
        try:
            family = [parent, *parent.children(recursive=True)]
        except psutil.NoSuchProcess:
            return
        for member in family:
            try:
                found = member.net_connections("tcp")
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
            for connection in found:
                if connection.status == psutil.CONN_LISTEN:
                    yield connection.laddr.ip, connection.laddr.port
        time.sleep(0.2)


def on_this_machine(where: str) -> bool:
    if where == "localhost":
        return True
    try:
        return ipaddress.ip_address(where).is_loopback
    except ValueError:
        return False


def test_a_run_with_its_servers_stays_on_this_machine(
    watched: Path, two_boxes_folder: Path, tmp_path: Path
) -> None:
    suite = tmp_path / "watched.toml"
    suite.write_text(SUITE.format(folder=two_boxes_folder))
    with start_server(0, store=local_store()) as mlflow:
        command = [sys.executable, "-m", "flows", "run", str(suite), "--quiet"]
        process = subprocess.Popen(
            [*command, "--tracking-uri", mlflow.url],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        listening = set(listening_while(process))
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 0, output
    assert "MLflow: " in output
    assert listening, "the run's own Prefect server was not seen"
    assert {ip for ip, _ in listening} == {"127.0.0.1"}
    seen = [json.loads(line) for line in watched.read_text().splitlines()]
    assert len({pid for pid, _, _ in seen}) >= 3, "command, Prefect server, MLflow server"
    assert {event for _, event, _ in seen} >= {"socket.connect", "socket.bind"}
    assert [call for call in seen if not on_this_machine(call[2])] == []

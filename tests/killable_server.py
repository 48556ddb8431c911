"""An MLflow server that tests may kill and start again on its port."""

from __future__ import annotations

import os
import signal

from reports.mlflow_server import MlflowServer, start_server
from reports.mlflow_store import LocalStore


class Server:
    """A real MLflow server that tests may kill; each finds it running."""

    def __init__(self, store: LocalStore) -> None:
        self.store = store
        self.running: MlflowServer | None = None
        self.port = 0

    def start(self) -> MlflowServer:
        if self.running is None:
            self.running = start_server(self.port, store=self.store)
            self.port = int(self.running.url.rsplit(":", 1)[1])
        return self.running

    def kill(self) -> None:
        if self.running is not None:
            os.killpg(self.running.process.pid, signal.SIGKILL)
            self.stop()

    def stop(self) -> None:
        if self.running is not None:
            self.running.stop()
            self.running = None

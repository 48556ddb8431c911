"""``gvr`` as a user runs it, with a Prefect server that lives longer than the runs."""

from __future__ import annotations

import importlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from faults import children
from faults.work import Work, emptied
from reports.mlflow_store import LocalStore, create_store
from reports.result_io import list_results

REPOSITORY = Path(__file__).resolve().parents[2]

_STARTS = 3
"""A start on a very busy machine takes longer than the two minutes that it is given."""

_SERVE = """
import sys
from pathlib import Path
from tasks.prefect_runtime import prefect_runtime
from tasks.store import Store
folder = Path(sys.argv[1])
with prefect_runtime(Store(folder / "store"), home=folder / "home", isolated=True) as runtime:
    print(runtime.api_url, flush=True)
    sys.stdin.read()
"""


class PrefectServer:
    """A real Prefect server on 127.0.0.1, in a process of its own."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for _ in range(_STARTS):
            self._process = subprocess.Popen(
                [sys.executable, "-c", _SERVE, str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                cwd=REPOSITORY,
                text=True,
            )
            assert self._process.stdout is not None
            self.url = self._process.stdout.readline().strip()
            if self.url:
                return
            self._process.wait()
        raise RuntimeError(f"no Prefect server started in {_STARTS} attempts")

    def __enter__(self) -> PrefectServer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def pids(self) -> list[int]:
        """The server's process and that of what started it, which would end it politely."""
        family = psutil.Process(self._process.pid).children(recursive=True)
        return [self._process.pid, *(member.pid for member in family)]

    def kill(self) -> None:
        """kill -9 of the server and of what started it."""
        for pid in self.pids:
            os.kill(pid, signal.SIGKILL)
        self._process.wait()

    def stop(self) -> None:
        """End it."""
        if self._process.poll() is None:
            try:
                self._process.communicate("", timeout=60)
            except subprocess.TimeoutExpired:
                self.kill()


@dataclass(frozen=True)
class CommandLine:
    """``gvr`` for one suite."""

    work: Work
    folder: Path
    """Holds the suite, and an empty MLflow store: making one takes seconds."""
    api_url: str

    @property
    def suite(self) -> Path:
        """The suite's file."""
        path = self.folder / "small.toml"
        if not path.exists():
            path.write_text(self.work.toml)
        return path

    @property
    def empty_mlflow(self) -> LocalStore:
        """An MLflow store without runs."""
        store = LocalStore(self.folder / "empty-mlflow")
        if not store.database.exists():
            ended = children.run(lambda: create_store(store.database), timeout=300)
            if ended.code != 0:
                raise RuntimeError(ended.last_line)
        return store

    def new_home(self, name: str) -> Path:
        """A home with an empty MLflow store and nothing else."""
        home = emptied(self.folder / name)
        (home / "mlflow").mkdir()
        shutil.copy(self.empty_mlflow.database, home / "mlflow" / "mlflow.db")
        return home

    def environment(self, home: Path) -> dict[str, str]:
        """What makes a process use this home and this Prefect server."""
        return {
            "GVR_HOME": str(home),
            "PREFECT_API_URL": self.api_url,
            "PREFECT_HOME": str(self.folder / "prefect-client"),
        }

    def call(self, home: Path, *arguments: str) -> Callable[[], Any]:
        """``gvr <arguments>`` as a function for a forked child, which has everything imported."""
        environment = self.environment(home)
        importlib.import_module("flows.run_commands")  # here once, and not in every child

        def called() -> None:
            from prefect.settings import temporary_settings

            from flows.cli import main

            _forget_own_places()
            os.environ.update(environment)
            # Prefect has read its environment already, when this process imported it.
            changes = {"api.url": self.api_url, "home": self.folder / "prefect-client"}
            with temporary_settings(changes):
                main(list(arguments))

        return called

    def run(self, home: Path, *options: str) -> Callable[[], Any]:
        """``gvr run SUITE --quiet <options>``."""
        return self.call(home, "run", str(self.suite), "--quiet", *options)

    def start_process(self, home: Path, *options: str) -> subprocess.Popen[str]:
        """``python -m flows run SUITE`` in a new process, as a shell starts it."""
        environment = {**os.environ, **self.environment(home)}
        for name in ("GVR_STORE", "GVR_RESULTS", "GVR_DATA", "MLFLOW_TRACKING_URI"):
            environment.pop(name, None)
        return subprocess.Popen(
            [sys.executable, "-m", "flows", "run", str(self.suite), "--quiet", *options],
            cwd=REPOSITORY,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def finish(self, home: Path, *options: str) -> tuple[Path, str]:
        """Run the suite to its end; returns its result and what was printed.

        Raises:
            RuntimeError: It did not end with 0, or left no new result.
        """
        known = set(list_results(home / "results"))
        ended = children.run(self.run(home, *options), timeout=300)
        if ended.code != 0:
            raise RuntimeError(f"exit code {ended.code}: {ended.output.strip()[-500:]}")
        (result,) = set(list_results(home / "results")) - known
        return result, ended.output


def _forget_own_places() -> None:
    for name in [name for name in os.environ if name.startswith(("GVR_", "MLFLOW_"))]:
        del os.environ[name]

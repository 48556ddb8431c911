"""Whether MLflow holds what results say: no less, and nothing twice."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from mlflow_contents import everything, nameless

from faults import children
from faults.command_line import CommandLine
from reports.mlflow_sink import sync
from reports.mlflow_store import EXPERIMENT, LocalStore
from reports.result_io import list_results


def sync_losses(line: CommandLine, home: Path) -> list[str]:
    """``gvr sync`` twice; MLflow then holds what it holds after a sync of a healthy store."""
    store = LocalStore(home / "mlflow")
    once: list[str] = []
    for _ in range(2):
        ended = children.run(line.call(home, "sync"), timeout=300)
        if ended.code != 0:
            return [f"gvr sync: exit code {ended.code}: {ended.last_line}"]
        found = nameless(everything(store))
        if once and found != once:
            return ["a second gvr sync changed what MLflow holds"]
        once = found
    expected = healthy(line, list_results(home / "results"))
    return [] if once == expected else ["MLflow does not hold what the results say"]


def healthy(line: CommandLine, results: list[Path]) -> list[str]:
    """What MLflow holds of results after a sync into a fresh store that nothing disturbs."""
    folder = line.folder / "healthy"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(line.empty_mlflow.folder, folder)
    store = LocalStore(folder)

    def fill() -> None:
        for result in results:
            sync(result, store.uri, experiment_of(result))

    ended = children.run(fill, timeout=300)
    if ended.code != 0:
        raise RuntimeError(ended.output[-500:])
    return nameless(everything(store))


def experiment_of(result: Path) -> str:
    """The experiment that the command line puts a result into."""
    config = json.loads((result / "result.json").read_text())["config"]
    return str(config.get("experiment", EXPERIMENT))

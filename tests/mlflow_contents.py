"""What an MLflow store holds, read back for comparison."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from mlflow import MlflowClient
from mlflow.entities import Run

from reports.mlflow_sink import WHOLE_TAG
from reports.mlflow_store import EXPERIMENT, LocalStore, mlflow_client


def runs_of(client: MlflowClient, experiment: str = EXPERIMENT) -> dict[tuple[str, ...], Run]:
    """All active runs by kind, scene and method; two of one key are an error."""
    found = client.get_experiment_by_name(experiment)
    assert found is not None
    runs = client.search_runs([found.experiment_id], max_results=1000)
    keys = [tuple(r.data.tags.get(t, "") for t in ("kind", "scene", "method")) for r in runs]
    assert max(Counter(keys).values()) == 1
    return dict(zip(keys, runs, strict=True))


def everything(store: LocalStore, experiment: str = EXPERIMENT) -> dict[str, Any]:
    """All that MLflow holds of an experiment: what must not change when a sync is repeated.

    Read from the database itself, so that a point stored twice is seen twice.
    """
    tables = {
        "tags": "select key, value from tags where run_uuid = ?",
        "params": "select key, value from params where run_uuid = ?",
        "points": "select key, step, timestamp, value, is_nan from metrics where run_uuid = ?",
        "latest": "select key, step, timestamp, value from latest_metrics where run_uuid = ?",
        "inputs": "select d.name, d.digest, d.dataset_source from inputs i"
        " join datasets d on d.dataset_uuid = i.source_id where i.destination_id = ?",
    }
    content: dict[str, Any] = {}
    with closing(sqlite3.connect(store.database)) as database:
        runs = database.execute(
            "select run_uuid, r.name, status, start_time, end_time, artifact_uri from runs r"
            " join experiments e using (experiment_id)"
            " where e.name = ? and r.lifecycle_stage = 'active'",
            [experiment],
        ).fetchall()
        for run_id, *head, uri in runs:
            root = Path(url2pathname(urlsplit(uri).path))
            content[run_id] = {
                "head": head,
                **{name: sorted(database.execute(sql, [run_id])) for name, sql in tables.items()},
                "artifacts": sorted(
                    (str(path.relative_to(root)), hashlib.sha256(path.read_bytes()).hexdigest())
                    for path in root.rglob("*")
                    if path.is_file()
                ),
            }
    return content


def nameless(content: dict[str, Any]) -> list[str]:
    """The same without MLflow's own ids, which differ between two fillings."""
    text = {run_id: json.dumps(run, sort_keys=True) for run_id, run in content.items()}
    for run_id in content:
        text = {key: value.replace(run_id, "ID") for key, value in text.items()}
    return sorted(text.values())


def artifacts(client: MlflowClient, run_id: str, path: str = "") -> Iterator[tuple[str, str]]:
    for item in client.list_artifacts(run_id, path):
        if item.is_dir:
            yield from artifacts(client, run_id, item.path)
        else:
            local = Path(client.download_artifacts(run_id, item.path))
            yield item.path, hashlib.sha256(local.read_bytes()).hexdigest()


def forget_whole(uri: str) -> int:
    """Take the mark off every run, so that a sync writes everything once more."""
    with mlflow_client(uri) as client:
        runs = runs_of(client).values()
        for run in runs:
            client.delete_tag(run.info.run_id, WHOLE_TAG)
        return len(runs)

"""Fill MLflow from a result's folder.

The folder is the truth and MLflow a view of it: a sync can be repeated, and continued after an
outage, without doubling anything. Runs are found again by their tags; metrics carry the time of
the benchmark, so that MLflow recognises a point that it has; tables and files are put in place of
their predecessors. A run is marked as whole only after everything else, and is then left alone.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gvr_core.atomic import why_not_written
from reports.aggregate import aggregate
from reports.mlflow_content import run_contents
from reports.mlflow_history import line_histories, write_histories
from reports.mlflow_run import RunContent
from reports.mlflow_store import (
    EXPERIMENT,
    SyncError,
    batches_of,
    default_tracking_uri,
    experiment_id,
    locked,
    mlflow_client,
    search_all,
    sqlite_database,
)
from reports.record import Result
from reports.result_io import SUMS_FILE, check_files, read_result

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run

LAYOUT = 5
"""Version of the names and contents of runs; a sync by a newer one fills old runs again."""
WHOLE_TAG = "gvr.synced"
"""Set last, to the layout and the digest of the record."""

FILL_SECONDS = 300.0
"""A run waits no longer than this for MLflow to be filled; ``gvr sync`` waits for ever."""

_METRICS_PER_BATCH = 800
_ITEMS_PER_BATCH = 100
"""MLflow takes 100 parameters, 100 tags, and 1000 things in all in one request."""
_Key = tuple[str, ...]


@dataclass(frozen=True)
class SyncReport:
    """What a sync did."""

    result: Path
    tracking_uri: str
    experiment: str
    parent_run: str
    """MLflow's id of the benchmark's run."""
    n_created: int
    """Runs that were not there."""
    n_continued: int
    """Runs that were there but not whole."""
    n_unchanged: int
    """Runs that were whole already."""
    n_removed: int
    """Doubles that a lost answer had left behind; moved to MLflow's trash."""
    n_left_out: int
    """Values that were not finite."""
    seconds: float

    def __str__(self) -> str:
        total = self.n_created + self.n_continued + self.n_unchanged
        parts = [f"{self.n_created} new", f"{self.n_unchanged} there already"]
        if self.n_continued:
            parts.append(f"{self.n_continued} continued")
        if self.n_removed:
            parts.append(f"{self.n_removed} doubles removed")
        if self.n_left_out:
            parts.append(f"{self.n_left_out} values not finite, left out")
        return (
            f"{total} runs ({', '.join(parts)}) in experiment {self.experiment} of "
            f"{self.tracking_uri}, {self.seconds:.1f} s"
        )


def sync(
    result_folder: Path,
    tracking_uri: str | None = None,
    experiment: str = EXPERIMENT,
    within: float | None = None,
) -> SyncReport:
    """Bring MLflow to what a result's folder says.

    Args:
        result_folder: A folder that `write_result` made.
        tracking_uri: As MLflow takes it; default: the user's ``MLFLOW_TRACKING_URI``, else the
            project's local store.
        experiment: Name of the experiment; made where missing.
        within: Seconds after which no further request is made; None for no limit.

    Raises:
        ResultError: for a folder that is no result.
        SyncError: if MLflow cannot be reached or refuses; nothing is lost, and a later sync goes
            on from there.
    """
    from mlflow.exceptions import MlflowException
    from requests.exceptions import RequestException
    from sqlalchemy.exc import SQLAlchemyError

    started = time.monotonic()
    uri = tracking_uri or default_tracking_uri()
    result, rows = read_result(result_folder)
    check_files(result_folder)  # pictures and tables go to MLflow as they are
    summary = aggregate(rows, result.scenes)
    contents = run_contents(result_folder, result, rows, summary)
    try:
        # One writer per result; of two syncs at once the second finds everything whole.
        with locked(result_folder), mlflow_client(uri) as client:
            limited: Any = client if within is None else _Hurried(client, started + within, uri)
            found = experiment_id(limited, uri, experiment)
            if found is None:
                raise SyncError(
                    f"the experiment {experiment!r} is in MLflow's trash (accepted: restore it "
                    "there, or name another)",
                    tracking_uri=uri,
                )
            writer = _Writer(limited, uri, found, result, _digest(result_folder))
            parent = writer.write(contents)
            write_histories(limited, uri, experiment, result, line_histories(result, summary))
    except (MlflowException, RequestException, SQLAlchemyError, OSError) as error:
        reason = str(error).strip().splitlines() or [type(error).__name__]
        if isinstance(error, OSError) and (database := sqlite_database(uri)) is not None:
            reason = [why_not_written(error, database.parent)]
        raise SyncError(
            f"{reason[0][:300]}; the result in {result_folder} is safe, and `gvr sync` goes on "
            "from here",
            tracking_uri=uri,
        ) from error
    return SyncReport(
        result=result_folder,
        tracking_uri=uri,
        experiment=experiment,
        parent_run=parent,
        n_created=writer.n_created,
        n_continued=writer.n_continued,
        n_unchanged=writer.n_unchanged,
        n_removed=writer.n_removed,
        n_left_out=sum(content.n_left_out for content in contents),
        seconds=time.monotonic() - started,
    )


class _Hurried:
    """A client that makes no request after a moment, as a slow server answers each in time."""

    def __init__(self, client: MlflowClient, deadline: float, uri: str) -> None:
        self._client = client
        self._deadline = deadline
        self._uri = uri

    def __getattr__(self, name: str) -> Any:
        if time.monotonic() > self._deadline:
            raise TimeoutError(f"{self._uri} is slow, and the time for filling it is over")
        return getattr(self._client, name)


def _digest(folder: Path) -> str:
    # The file of sums stands for every file of the record, the pictures too.
    return f"{LAYOUT}:{hashlib.sha256((folder / SUMS_FILE).read_bytes()).hexdigest()}"


class _Writer:
    """Writes the runs of one result."""

    def __init__(
        self, client: MlflowClient, uri: str, experiment: str, result: Result, digest: str
    ) -> None:
        self.client = client
        self.uri = uri
        self.experiment_id = experiment
        self.result = result
        self.digest = digest
        self.start = round(datetime.fromisoformat(result.created).timestamp() * 1000)
        self.n_created = self.n_continued = self.n_unchanged = self.n_removed = 0

    def write(self, contents: Sequence[RunContent]) -> str:
        """Write all runs, the parent's first and whole last; return the parent's id."""
        known = self._known()
        parent, *children = contents
        parent_id, parent_whole = self._open(parent, known, None)
        for content in children:
            run_id, whole = self._open(content, known, parent_id)
            if not whole:
                self._fill(run_id, content)
        if not parent_whole:
            self._fill(parent_id, parent)
        return parent_id

    def _known(self) -> dict[_Key, Run]:
        """The result's runs that MLflow has, one for each key."""
        known: dict[_Key, Run] = {}
        filter_string = f"tags.`gvr.run_id` = '{self.result.run_id}'"
        for run in search_all(self.client, self.experiment_id, filter_string):
            tags = run.data.tags
            key = _key(tags)
            if key not in known:
                known[key] = run
                continue
            # The answer to "create a run" was lost, and the request repeated.
            spare = run
            if WHOLE_TAG in tags and WHOLE_TAG not in known[key].data.tags:
                spare, known[key] = known[key], run
            self.client.delete_run(spare.info.run_id)
            self.n_removed += 1
        return known

    def _open(
        self, content: RunContent, known: dict[_Key, Run], parent_id: str | None
    ) -> tuple[str, bool]:
        """The id of a content's run, made where missing, and whether it is whole already."""
        tags = dict(content.tags)
        if parent_id is not None:
            tags["mlflow.parentRunId"] = parent_id
        run = known.get(_key(content.tags))
        if run is None:
            # With its tags from the first moment, so that it is found again whatever happens next.
            run = self.client.create_run(
                self.experiment_id, start_time=self.start, tags=tags, run_name=content.name
            )
            self.n_created += 1
            return run.info.run_id, False
        run_id: str = run.info.run_id
        if parent_id is not None and run.data.tags.get("mlflow.parentRunId") != parent_id:
            self.client.set_tag(run_id, "mlflow.parentRunId", parent_id)
        if run.data.tags.get(WHOLE_TAG) == self.digest:
            self.n_unchanged += 1
            return run_id, True
        self.n_continued += 1
        return run_id, False

    def _fill(self, run_id: str, content: RunContent) -> None:
        from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, RunTag

        client = self.client
        params = [Param(key, value) for key, value in content.params.items()]
        tags = [RunTag(key, value) for key, value in content.tags.items()]
        if content.tables:
            shown = ", ".join(f'{{"path": "{name}", "type": "table"}}' for name in content.tables)
            tags.append(RunTag("mlflow.loggedArtifacts", f"[{shown}]"))
        metrics = [
            Metric(p.key, p.value, self.start + round(1000 * p.seconds), p.step)
            for p in content.points
        ]
        batches = zip_longest(
            batches_of(metrics, _METRICS_PER_BATCH),
            batches_of(params, _ITEMS_PER_BATCH),
            batches_of(tags, _ITEMS_PER_BATCH),
            fillvalue=[],
        )
        for some_metrics, some_params, some_tags in batches:
            client.log_batch(run_id, some_metrics, some_params, some_tags)
        inputs = [
            DatasetInput(
                Dataset(
                    name=data.name,
                    digest=data.digest,
                    source_type="code",
                    source=data.source,
                    profile=data.profile,
                ),
                [InputTag("mlflow.data.context", "evaluation")],
            )
            for data in content.datasets
        ]
        if inputs:
            _log_inputs(client, run_id, inputs)
        # Not log_table, which appends to a table that is there already.
        for name, table in content.tables.items():
            client.log_dict(run_id, table, name)
        for name, text in content.texts.items():
            client.log_text(run_id, text, name)
        for name, make in content.made.items():
            client.log_text(run_id, make(), name)
        for path, folder in content.files:
            client.log_artifact(run_id, str(path), folder or None)
        end = self.start + round(content.seconds * 1000)
        client.set_terminated(run_id, "FAILED" if content.failed else "FINISHED", end)
        client.set_tag(run_id, WHOLE_TAG, self.digest)


def _log_inputs(client: Any, run_id: str, inputs: Sequence[Any]) -> None:
    """Log a run's data sets, also where another sync makes the same ones at this moment.

    MLflow looks for a data set and then makes it. Who comes second is refused, and finds it the
    next time; each data set can be lost to another sync once.
    """
    from mlflow.exceptions import MlflowException

    for left in reversed(range(len(inputs) + 1)):
        try:
            client.log_inputs(run_id, inputs)
            return
        except MlflowException as error:
            refused = str(error).lower()
            if not left or not ("unique" in refused or "duplicate" in refused):
                raise


def _key(tags: Mapping[str, str]) -> _Key:
    """Which run of a benchmark: its kind, data set, scene and method."""
    return tuple(tags.get(name, "") for name in ("kind", "dataset", "scene", "method"))

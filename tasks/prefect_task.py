"""One Prefect task run for one stage and key.

Our own key and our own check of the artifacts decide; Prefect shows the state and keeps a record
of it. Before the task is called, the store looks the key up and checks every artifact: where that
fails, the task is run with ``refresh_cache``, so that a Prefect record which outlived its
artifacts cannot be taken for a hit. Within the task `Store.compute_once` decides once more, under
a lock that two runs share; where the other one has computed meanwhile, the task ends as
``Cached`` too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

from prefect.client.schemas.objects import State
from prefect.states import Completed
from prefect.tasks import Task

from gvr_core.errors import StoreError
from tasks.findings import Notes
from tasks.prefect_results import RESULT_SERIALIZER, StageResultStorage, result_key
from tasks.prefect_server import note_task_run
from tasks.record_store import StageOutput
from tasks.records import Artifact, StageRecord
from tasks.store import Store


def run_as_task(
    store: Store,
    stage: str,
    version: int,
    key: str,
    function: Callable[[], StageOutput | Mapping[str, Artifact]],
    *,
    label: str = "",
    refresh: bool = False,
    notes: Notes | None = None,
) -> tuple[StageRecord, Literal["Completed", "Cached"]]:
    """Run a stage as a Prefect task; to be called inside a flow or another task.

    Args:
        store: Where results lie.
        stage: The stage's name, which is the task's.
        version: The stage's version.
        key: Its cache key, which is the task's.
        function: Computes the artifacts.
        label: Shown in the task run's name: ``render · gallery/seed0``.
        refresh: Compute even where there is a sound result.
        notes: Get what was found damaged.

    Returns:
        The record, and the state's name.

    Raises:
        StoreError: Prefect ended the run otherwise than by the function's return or error.
        Exception: Whatever the function raises.
    """
    notes = notes if notes is not None else Notes()
    found = None if refresh else store.lookup(stage, key, notes)
    outcome: list[StageRecord] = []
    errors: list[Exception] = []

    def compute() -> State:
        try:
            record, computed = store.compute_once(
                stage, version, key, function, refresh=refresh, notes=notes
            )
        except Exception as error:
            errors.append(error)
            raise
        outcome.append(record)
        name = "Completed" if computed else "Cached"
        return Completed(name=name, data=record.to_json(), message=_message(record, computed))

    task = Task(
        fn=compute,
        name=stage,
        description=f"stage {stage}, version {version}",
        task_run_name=f"{stage} · {label}" if label else stage,
        cache_key_fn=lambda context, parameters: result_key(stage, key),
        persist_result=True,
        result_serializer=RESULT_SERIALIZER,
        cache_result_in_memory=False,
        refresh_cache=found is None,
        retries=0,
    )
    # The constructor takes only storages that the server knows, for results read elsewhere by
    # way of the server. Results of stages are read from the store.
    task.result_storage = StageResultStorage(root=str(store.root))
    state = task(return_state=True)
    note_task_run(state.state_details.task_run_id)
    if errors:
        raise errors[-1]
    record = outcome[-1] if outcome else found
    if record is None or not state.is_completed() or state.name not in ("Completed", "Cached"):
        raise StoreError(f"stage {stage}: the Prefect task ended as {state.name}: {state.message}")
    return record, "Cached" if state.name == "Cached" else "Completed"


def _message(record: StageRecord, computed: bool) -> str:
    if not computed:
        return "in the store"
    return (
        f"{len(record.artifacts)} artifacts, {record.total_bytes / 1e6:.1f} MB,"
        f" {record.seconds:.1f} s, peak {record.peak_bytes / 1e6:.0f} MB"
    )

"""The flow that schedules run: all that ``gvr run`` does, with what it says in the run's log.

Its parameters are simple JSON, for ``gvr schedule``, for ``prefect.yaml``, and for whoever starts
it by hand in Prefect's pages.
"""

from __future__ import annotations

from prefect import flow, get_run_logger
from prefect.artifacts import create_markdown_artifact
from prefect.context import FlowRunContext
from prefect.states import Cancelled, Completed, Failed, State

from flows.benchmark import run_benchmark
from flows.job import Job, fill_mlflow, not_filled, prepare
from flows.places import home, results_root, store_root
from gvr_core.errors import StoreError
from gvr_core.locks import file_lock
from reports import tables
from reports.mlflow_store import SyncError, default_tracking_uri
from tasks.prefect_runtime import prefect_runtime
from tasks.store import Store


@flow(name="nightly")
def nightly(
    suite: str = "bench",
    methods: list[str] | None = None,
    datasets: list[str] | None = None,
    scenes: list[str] | None = None,
    models: list[str] | None = None,
    limit: int | None = None,
    exclude_eval_views: bool = False,
    runner: str | None = None,
    workers: int | None = None,
    store: str | None = None,
    results: str | None = None,
    mlflow: bool = True,
    tracking_uri: str | None = None,
) -> State[None]:
    """Run a suite: check it, run it, write its result, fill MLflow, say how it went.

    Args:
        suite: A bundled suite's name, or a path to a .toml file.
        methods: Only these methods.
        datasets: Only these data sets.
        scenes: Only these scenes.
        models: Only these sets of models.
        limit: Only the first so many queries of each scene.
        exclude_eval_views: Keep test views out of the books.
        runner: Instead of the suite's own.
        workers: Instead of the suite's own.
        store: Where the artifact store is; GVR_STORE, else .gvr/store.
        results: Folder of the results; GVR_RESULTS, else .gvr/results.
        mlflow: Whether MLflow is filled.
        tracking_uri: MLflow to fill; MLFLOW_TRACKING_URI, else the project's own store.

    Returns:
        ``Failed`` where a scene failed, naming it and its error; ``Cancelled`` where the run
        before still goes on.

    Raises:
        ConfigError: for a suite that cannot run.
        ModelError: for weights that are missing.
    """
    job = Job(
        suite=suite,
        methods=tuple(methods or ()),
        datasets=tuple(datasets or ()),
        scenes=tuple(scenes or ()),
        models=tuple(models or ()),
        limit=limit,
        exclude_eval_views=exclude_eval_views,
        runner=runner,
        workers=workers,
        store=store or str(store_root()),
        results=results or str(results_root()),
        tracking_uri=(tracking_uri or default_tracking_uri()) if mlflow else None,
    )
    config = prepare(job)
    known = Store(job.store)
    known.check()
    lock = home() / "locks" / f"nightly-{config.name}.lock"
    try:
        # The kernel lets go of it however the run ends, so no slot stays taken.
        with file_lock(lock, timeout=0), prefect_runtime(known, quiet=False):
            outcome = run_benchmark(
                config, job.store, job.results, started_by="schedule" if _is_due() else "hand"
            )
    except StoreError as error:
        if str(lock) not in str(error):
            raise
        return Cancelled(message=f"the run of {config.name} before this one still goes on")
    log = get_run_logger()
    text = tables.readme_block(outcome.result, outcome.rows)
    log.info("Result: %s\n%s", outcome.folder, text)
    create_markdown_artifact(
        text, key=_key(config.name), description=f"Result of suite {config.name}: {outcome.folder}"
    )
    if job.tracking_uri is not None:
        try:
            log.info("MLflow: %s", fill_mlflow(outcome.folder, job.tracking_uri))
        except SyncError as error:
            log.warning(not_filled(error))
    if outcome.failed:
        return Failed(message="\n".join(outcome.failed))
    return Completed(message=f"Result: {outcome.folder}")


def _is_due() -> bool:
    """Whether a schedule started this run; else somebody did, in Prefect's pages or command."""
    context = FlowRunContext.get()
    return context is not None and context.flow_run is not None and context.flow_run.auto_scheduled


def _key(suite: str) -> str:
    """An artifact's key: Prefect takes lower-case letters, digits and dashes."""
    return "result-" + "".join(c if c.isalnum() else "-" for c in suite.lower())

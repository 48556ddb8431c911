"""``gvr schedule``: one process that waits, and starts each run in a process of its own."""

from __future__ import annotations

from pathlib import Path

from prefect.client.orchestration import get_client
from prefect.client.schemas.filters import (
    DeploymentFilter,
    DeploymentFilterName,
    FlowFilter,
    FlowFilterName,
    FlowRunFilter,
    FlowRunFilterState,
    FlowRunFilterStateType,
)
from prefect.client.schemas.objects import StateType
from prefect.flows import EntrypointType

from flows.job import Job
from flows.nightly import nightly
from flows.when import When

AT_ONCE = 2
"""Runs that are begun at once. The second one sees that the first still goes on, and ends as
Cancelled; were it 1, such runs would queue up."""


def serve_suite(job: Job, name: str, when: When) -> None:
    """Run a job at its times, until interrupted; to be called inside a Prefect runtime.

    The schedule is paused when this ends: without this process nobody would start the runs, and
    those of the meantime would all be made up for when it comes back. For the same reason runs that
    it missed, having been killed, are forgotten.

    Args:
        job: What to run.
        name: Name of the deployment.
        when: When to run it.

    Raises:
        ConfigError: for a cron line that is none.
    """
    schedule = when.schedule()
    forget_missed(name)
    nightly.serve(
        name=name,
        schedule=schedule,
        parameters=parameters(job),
        limit=AT_ONCE,
        pause_on_shutdown=True,
        print_starting_message=False,
        entrypoint_type=EntrypointType.MODULE_PATH,
    )


def forget_missed(name: str) -> None:
    """Delete runs of a deployment that were due, or planned, when its process ended."""
    waiting = FlowRunFilter(
        state=FlowRunFilterState(type=FlowRunFilterStateType(any_=[StateType.SCHEDULED]))
    )
    ours = DeploymentFilter(name=DeploymentFilterName(any_=[name]))
    this = FlowFilter(name=FlowFilterName(any_=[nightly.name]))
    with get_client(sync_client=True) as client:
        while runs := client.read_flow_runs(
            flow_filter=this, flow_run_filter=waiting, deployment_filter=ours
        ):
            for run in runs:
                client.delete_flow_run(run.id)


def parameters(job: Job) -> dict[str, object]:
    """A job as parameters of :func:`flows.nightly.nightly`, with absolute paths."""
    values = job.model_dump(mode="json")
    for place in ("store", "results"):
        values[place] = _absolute(values[place])
    if Path(job.suite).is_file():
        values["suite"] = _absolute(job.suite)
    return values | {"mlflow": job.tracking_uri is not None}


def _absolute(place: str) -> str:
    return place if "://" in place else str(Path(place).resolve())

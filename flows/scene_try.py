"""One try of one scene: what is asked for, and how it is run as a Prefect flow run."""

from __future__ import annotations

from typing import Any
from uuid import UUID

from prefect.client.orchestration import get_client
from prefect.context import FlowRunContext
from prefect.flow_engine import run_flow
from prefect.states import Failed
from prefect.tasks import Task
from prefect.utilities.asyncutils import run_coro_as_sync
from pydantic import BaseModel, ConfigDict

from flows.scene import scene_flow
from flows.scene_outcome import Listener


class SceneTry(BaseModel):
    """One try of one scene, as JSON values, so that any process can make it."""

    model_config = ConfigDict(frozen=True)

    suite: dict[str, Any]
    """The suite's configuration."""
    dataset: str
    scene: str
    lines: tuple[str, ...]
    """Names of the lines to run, in this order."""
    store: str
    """Where the artifact store is."""
    flow_run: UUID
    """The Prefect flow run that shows it."""
    number: int
    """1 for the first try."""
    threads: int
    """Threads that a process of its own computes with."""
    scene_seconds: float | None = None
    progress: bool = False


def new_scene_run(dataset: str, scene: str, number: int, run_id: str) -> UUID:
    """Make the flow run of a try, below the flow run that this is called in.

    It is made before the try is handed out, so that it can be ended when whoever runs it dies.
    """
    name = f"{dataset}/{scene}" + (f" · try {number}" if number > 1 else "")
    placeholder = Task(name=scene_flow.name, fn=scene_flow.fn, task_run_name=name)
    context = FlowRunContext.get()
    shown = run_coro_as_sync(placeholder.create_run(flow_run_context=context, parameters={}))
    with get_client(sync_client=True) as client:
        run = client.create_flow_run(
            scene_flow, name=name, tags=[run_id], parent_task_run_id=shown.id if shown else None
        )
    return run.id


def run_here(order: SceneTry, listener: Listener) -> None:
    """Make a try in this process, as the flow run that was made for it."""
    with get_client(sync_client=True) as client:
        flow_run = client.read_flow_run(order.flow_run)
    run_flow(
        scene_flow,
        flow_run=flow_run,
        parameters={
            "suite": order.suite,
            "dataset": order.dataset,
            "scene": order.scene,
            "store": order.store,
            "lines": order.lines,
            "listener": listener,
            "progress": order.progress,
        },
        return_type="state",
    )


def end_scene_run(flow_run: UUID, message: str) -> None:
    """Show a try as failed whose process can no longer say so."""
    with get_client(sync_client=True) as client:
        shown = client.read_flow_run(flow_run)
        if shown.state is None or not shown.state.is_final():
            client.set_flow_run_state(flow_run, Failed(message=message), force=True)

"""Where scenes are computed: here, in threads, in processes, or on a Dask cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner
from pydantic import BaseModel, ConfigDict

from flows.run_config import RunConfig, check_runner
from flows.scene_process import end_scene_processes
from gvr_core.errors import ConfigError
from gvr_core.threads import available_threads, thread_limits
from tasks.prefect_drain import drain

if TYPE_CHECKING:
    import distributed

CONNECT_SECONDS = 30


class Placement(BaseModel):
    """How scenes are handed to a runner."""

    model_config = ConfigDict(frozen=True)

    in_flight: int = 1
    """At most so many scenes are handed out at once."""
    threads: int = 1
    """Threads that each process of its own computes with."""
    parallel: bool = False
    """Whether scenes are handed to the task runner at all."""
    apart: bool = False
    """Whether each try is made in a process that can be ended."""


@contextmanager
def open_runner(run: RunConfig, scenes: int) -> Iterator[tuple[TaskRunner[Any], Placement]]:
    """Prefect's runner that a suite asks for, and how scenes are handed to it.

    Both last as long as a ``with`` block.

    Args:
        run: The suite's settings.
        scenes: Number of scenes.

    Raises:
        ConfigError: for a runner that is not installed, or a scheduler that does not answer.
    """
    check_runner(run)
    workers = run.workers_for(scenes)
    threads = max(1, available_threads() // workers)
    with ExitStack() as stack:
        stack.callback(end_scene_processes)
        if run.runner == "serial":
            yield ThreadPoolTaskRunner(max_workers=1), Placement()
        elif run.runner == "dask":
            address, places = stack.enter_context(_cluster(run, workers, threads))
            from prefect_dask import DaskTaskRunner

            placement = Placement(
                in_flight=run.scenes_in_flight or places,
                threads=threads,
                parallel=True,
                apart=run.scene_seconds is not None,
            )
            yield DaskTaskRunner(address=address), placement
        else:
            # A thread watches over each process: Prefect's own process pool breaks as a whole
            # when one of its processes dies, and leaves their runs shown as running.
            placement = Placement(
                in_flight=run.scenes_in_flight or workers,
                threads=threads,
                parallel=True,
                apart=run.runner == "processes",
            )
            yield ThreadPoolTaskRunner(max_workers=workers), placement


@contextmanager
def _cluster(run: RunConfig, workers: int, threads: int) -> Iterator[tuple[str, int]]:
    """Address of a scheduler, and how many scenes its workers take at once."""
    import dask
    from distributed import Client, LocalCluster

    if run.dask_scheduler is not None:
        try:
            client = Client(run.dask_scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"the Dask scheduler {run.dask_scheduler} does not answer: {error}",
                place="run.dask_scheduler",
                accepted="the address of a running one, or none for a cluster of the run's own",
            ) from error
        with client:
            yield run.dask_scheduler, max(1, sum(client.nthreads().values()))
            _call_all(client, drain)
            _call_all(client, end_scene_processes)
        return
    settings = {
        # Deaths are counted and retried by the run, in one way for all runners.
        "distributed.scheduler.allowed-failures": 0,
        # Before numpy is imported, which reads them once.
        "distributed.nanny.pre-spawn-environ": {
            **thread_limits(threads),
            "DASK_LOGGING__DISTRIBUTED": "error",
        },
    }
    logging.getLogger("distributed").setLevel(logging.ERROR)
    with dask.config.set(settings):
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=logging.ERROR,
        )
    with cluster, Client(cluster, set_as_default=False) as client:
        yield cluster.scheduler_address, workers
        _call_all(client, drain)
        _call_all(client, end_scene_processes)


def _call_all(client: distributed.Client, function: Callable[[], None]) -> None:
    """Call a function on all workers; those that are gone have nothing left to say."""
    client.run(function, on_error="ignore")

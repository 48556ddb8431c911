"""The two processes that ``overhead.py`` compares; it starts this file, people do not.

    overhead_child.py loop|flow SUITE OUT MODELS

The flow is ``gvr run`` itself, with a stopwatch around some of its functions.
"""

from __future__ import annotations

import sys
import time

_START = time.perf_counter()

import contextlib  # noqa: E402
import functools  # noqa: E402
import importlib  # noqa: E402
import json  # noqa: E402
import tomllib  # noqa: E402
from collections.abc import Callable, Iterator  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402


def loop(suite: Path, out: Path, models: str) -> None:
    """The plain loop."""
    from plain_loop import run_loop

    from flows.lines import bundled_models

    given = tomllib.loads(suite.read_text(encoding="utf-8"))
    (dataset,), (method,) = given["datasets"], given["methods"]
    scores = run_loop(dataset["scenes"], method["method"], bundled_models(models), given["limit"])
    out.write_text(json.dumps(scores), encoding="utf-8")


class Stopwatch:
    """Seconds spent in functions; of nested ones, each is counted by itself."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner: list[float] = []

    def around(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, with its time added to a part, less that of watched ones inside it."""

        @functools.wraps(function)
        def watched(*arguments: Any, **named: Any) -> Any:
            start = time.perf_counter()
            self._inner.append(0.0)
            try:
                return function(*arguments, **named)
            finally:
                whole = time.perf_counter() - start
                own = whole - self._inner.pop()
                if self._inner:
                    self._inner[-1] += whole
                self.seconds[part] = self.seconds.get(part, 0.0) + own

        return watched

    def around_context(self, part: str, manager: Callable[..., Any]) -> Callable[..., Any]:
        """A context manager, with the times of its beginning and of its end."""

        @contextlib.contextmanager
        def watched(*arguments: Any, **named: Any) -> Iterator[Any]:
            context = manager(*arguments, **named)
            value = self.around(f"{part}: start", context.__enter__)()
            try:
                yield value
            except BaseException:
                context.__exit__(*sys.exc_info())
                raise
            self.around(f"{part}: stop", context.__exit__)(None, None, None)

        return watched

    def watch(self, part: str, owner: Any, *names: str) -> None:
        """Put the stopwatch around functions of a module or class."""
        for name in names:
            setattr(owner, name, self.around(part, getattr(owner, name)))


def flow(suite: Path, out: Path, models: str) -> None:
    """``gvr run`` under stopwatches."""
    watch = Stopwatch()
    watch.around("imports", functools.partial(importlib.import_module, "flows.cli"))()
    import flows.cli
    import flows.run_commands
    import tasks.prefect_runtime

    runtime = tasks.prefect_runtime.prefect_runtime
    tasks.prefect_runtime.prefect_runtime = watch.around_context("Prefect server", runtime)
    synced: list[Any] = []
    begin = flows.run_commands.begin_store

    def begin_all(uri: str) -> None:
        # What a run imports while its server starts can be watched from then on only.
        begin(uri)
        importlib.import_module("flows.benchmark")
        watch_all(watch)
        synced.append(kept(importlib.import_module("reports.mlflow_sink"), "sync"))

    flows.run_commands.begin_store = watch.around("imports while the server starts", begin_all)
    arguments = ["run", str(suite), "--models", models, "--quiet"]
    try:
        flows.cli.main(arguments)
    except SystemExit as end:
        if end.code:
            raise
    check_filled([report.n_created for report in synced[0]])
    (folder,) = Path("home/results").glob("*/result.json")
    scores = _read(folder.parent)
    names = [planned.stage.name for planned in importlib.import_module("tasks.stages").STAGES]
    stages = {name: watch.seconds.pop(f"stage {name}", 0.0) for name in names}
    wall = time.perf_counter() - _START
    parts = {"stages' own work": sum(stages.values()), **watch.seconds}
    parts["all else: Prefect's tasks and flows"] = wall - sum(parts.values())
    answer = {"wall": wall, "parts": parts, "scores": scores, "stages": stages}
    out.write_text(json.dumps(answer), encoding="utf-8")


def watch_all(watch: Stopwatch) -> None:
    """Put the stopwatch around the stages, and around what surrounds them."""
    import flows.run_commands
    import flows.scene
    import reports.results_place
    import tasks.computing
    import tasks.objects
    import tasks.stages

    watch.watch("loading scenes", flows.scene, "load_scene")
    watch.watch(
        "store: writing, hashing, syncing", tasks.objects.ObjectStore, "_adopt", "put_arrays"
    )
    watch.watch("store: reading, hashing", tasks.objects.ObjectStore, "path", "load_arrays")
    watch.watch("pictures", tasks.computing, "draw_query")
    watch.watch("result record", reports.results_place.ResultsPlace, "write")
    watch.watch("tables", flows.run_commands, "print_tables")
    watch.watch("MLflow", flows.run_commands, "fill_mlflow")
    for planned in tasks.stages.STAGES:
        function = watch.around(f"stage {planned.stage.name}", planned.stage.function)
        object.__setattr__(planned.stage, "function", function)


def kept(owner: Any, name: str) -> list[Any]:
    """What a function of a module returns from now on, call by call; errors leave nothing."""
    function, returned = getattr(owner, name), []

    def keeping(*arguments: Any, **named: Any) -> Any:
        returned.append(function(*arguments, **named))
        return returned[-1]

    setattr(owner, name, keeping)
    return returned


def check_filled(created: list[int]) -> None:
    """Refuse a run whose MLflow was not filled: ``gvr run`` only warns, and is quick about it.

    Args:
        created: Runs that each sync made; a sync that failed is not among them.

    Raises:
        SystemExit: unless there was one sync, of the benchmark's run and one below it or more.
    """
    if len(created) != 1 or created[0] < 2:
        raise SystemExit(f"MLflow was not filled: syncs that ended made {created} runs")


def _read(folder: Path) -> dict[str, dict[str, float]]:
    from reports.result_io import read_result

    _, rows = read_result(folder)
    return {f"{row.scene} {row.query} {row.view} {row.protocol}": dict(row.metrics) for row in rows}


if __name__ == "__main__":
    kind, suite, out, models = sys.argv[1:]
    if kind == "loop":
        loop(Path(suite), Path(out), models)
    else:
        from flows.leaving import run_and_leave

        run_and_leave(functools.partial(flow, Path(suite), Path(out), models))

"""How fast queries are between the models: ``python benchmarks/query_speed.py``.

The scene and its books are those of ``query_scene``: nothing of them says how well a method
works. The models are stand-ins; the time spent in them stands apart, and no total contains it.

Each query is asked alone first, with nothing kept from the one before, and its steps are timed;
then all of them are asked together, as a stage of a benchmark asks them.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from query_scene import QueryScene, query_scene
from rich.console import Console

from gvr_core.books import Books
from gvr_core.methods import Method, MethodConfig, Toolbox, build_method
from gvr_core.rendering import get_renderer
from gvr_core.scene import Query
from gvr_core.stopwatch import recorded
from reports.document import replace_block
from reports.environment import describe_environment

BLOCK = "perf-queries"
"""Name of the block of the page that ``--into`` rewrites."""
BAR_SECONDS = 0.5
"""A query alone, without the models, at most."""
METHODS = ("gvr-paper", "gvr-robust")
MODELS, REST = "models", "the rest"


@dataclass(frozen=True)
class Size:
    """The scene that is asked."""

    gaussians: int = 200_000
    views: int = 300
    patches: int = 100
    """Of each view."""
    queries: int = 50


@dataclass(frozen=True)
class StepTime:
    """One step over all queries, milliseconds; queries that have no such step count as 0."""

    step: str
    median: float
    least: float
    most: float


@dataclass(frozen=True)
class QuerySpeed:
    """One method on one scene."""

    method: str
    gaussians: int
    views: int
    patches: int
    picture: tuple[int, int]
    queries: int
    index_seconds: float
    steps: tuple[StepTime, ...]
    """In the order in which they come; the models' stand-ins are one of them."""
    total: StepTime
    """Without the models."""
    processor: float
    """Median processor time of a query asked alone, all threads together, stand-ins included,
    milliseconds: it changes less than the clock's where other work shares the machine."""
    together: float
    """Milliseconds for each of all the queries asked together, without the models."""
    together_processor: float
    """Their processor time, each, milliseconds."""


def speeds(size: Size, methods: Sequence[str]) -> list[QuerySpeed]:
    """Ask each method all queries of a scene of that size."""
    made = query_scene(size.gaussians, size.views, size.patches, queries=size.queries)
    return [measure(made, name) for name in methods]


def measure(made: QueryScene, name: str, warm_up: int = 1) -> QuerySpeed:
    """Ask a method all queries of a scene, one by one and together.

    Args:
        made: Scene, books, stand-ins and queries.
        name: The method.
        warm_up: Queries that are asked first and not counted: code is compiled, or loaded.
    """
    tools = Toolbox(get_renderer("numba"), made.stand_ins.models())
    method = build_method(MethodConfig(method=name), tools)
    start = time.perf_counter()
    books = replace(made.books, index=method.index(made.scene, made.books))
    index_seconds = time.perf_counter() - start
    for query in made.queries[:warm_up]:
        method.ground(made.scene, books, query)
    laps, alone = [], []
    for query in made.queries:
        start = time.process_time()
        laps.append(_alone(made, method, books, query))
        alone.append(time.process_time() - start)
    start = time.process_time()
    together = _together(made, method, books, made.queries)
    processor = (time.process_time() - start) / len(made.queries)
    names = list(dict.fromkeys(step for lap in laps for step in lap))
    camera = made.scene.views[0].camera
    totals = [sum(lap.values()) - lap.get(MODELS, 0.0) for lap in laps]
    return QuerySpeed(
        name,
        len(made.scene.gaussians),
        len(made.scene.views),
        len(made.books.semantics.patches),
        (camera.width, camera.height),
        len(made.queries),
        index_seconds,
        tuple(_step(step, [lap.get(step, 0.0) for lap in laps]) for step in names),
        _step("total", totals),
        1e3 * statistics.median(alone),
        1e3 * together,
        1e3 * processor,
    )


def _alone(made: QueryScene, method: Method, books: Books, query: Query) -> dict[str, float]:
    """Step -> seconds of one query that shares nothing with any other."""
    start = time.perf_counter()
    shared = method.share(made.scene, books, [query])
    with recorded() as seconds:
        place = method.locate(made.scene, books, query, shared)
    answer = method.segment(made.scene, books, place, query, shared)
    total = time.perf_counter() - start
    laps = dict(seconds)
    for step, own in answer.seconds.items():
        laps[step] = laps.get(step, 0.0) + own
    return laps | {REST: total - sum(laps.values())}


def _together(made: QueryScene, method: Method, books: Books, queries: Sequence[Query]) -> float:
    """Seconds for each of some queries that are asked together, without the models."""
    made.stand_ins.seconds = 0.0
    start = time.perf_counter()
    shared = method.share(made.scene, books, queries)
    for query in queries:
        place = method.locate(made.scene, books, query, shared)
        method.segment(made.scene, books, place, query, shared)
    return (time.perf_counter() - start - made.stand_ins.seconds) / len(queries)


def _step(name: str, seconds: Sequence[float]) -> StepTime:
    values = [1e3 * value for value in seconds]
    return StepTime(name, statistics.median(values), min(values), max(values))


def markdown(speeds: Sequence[QuerySpeed]) -> str:
    """The figures as a Markdown page's block."""
    environment = describe_environment()
    one = speeds[0]
    lines = [
        f"{environment.cpu_count} x {environment.processor}; {one.gaussians:,} Gaussians, "
        f"{one.views} views of {one.picture[0]}x{one.picture[1]}, {one.patches:,} patches, "
        f"{one.queries} queries; milliseconds a query, median (least to most).",
    ]
    for speed in speeds:
        lines += ["", f"| {speed.method} | ms |", "| :--- | ---: |"]
        for step in speed.steps:
            name = "models (stand-ins, not in the total)" if step.step == MODELS else step.step
            lines.append(f"| {name} | {_spread(step)} |")
        verdict = "within" if speed.total.median <= 1e3 * BAR_SECONDS else "above"
        lines += [
            f"| **total, asked alone** | **{_spread(speed.total)}** |",
            f"| its processor time, all threads | {speed.processor:.1f} |",
            f"| asked together, each | {speed.together:.1f} |",
            f"| its processor time, all threads | {speed.together_processor:.1f} |",
            "",
            f"{verdict.capitalize()} the bar of {1e3 * BAR_SECONDS:.0f} ms. Together is "
            f"{speed.together / speed.total.median:.2f} of alone. Index, once a scene: "
            f"{speed.index_seconds:.1f} s.",
        ]
    return "\n".join(lines)


def _spread(step: StepTime) -> str:
    return f"{step.median:.1f} ({step.least:.1f} to {step.most:.1f})"


def records(speeds: Sequence[QuerySpeed]) -> list[dict[str, object]]:
    """The figures as plain values."""
    return [asdict(speed) for speed in speeds]


def main() -> None:
    """Measure, print, and put the tables into a page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for field in fields(Size):
        parser.add_argument(f"--{field.name}", type=int, default=field.default)
    parser.add_argument("--methods", nargs="+", default=list(METHODS))
    parser.add_argument("--into", type=Path, help=f"page with a block <!-- {BLOCK} -->")
    arguments = parser.parse_args()
    size = Size(*(getattr(arguments, field.name) for field in fields(Size)))
    text = markdown(speeds(size, arguments.methods))
    Console(soft_wrap=True).print(text, markup=False, highlight=False)
    if arguments.into is not None:
        replace_block(arguments.into, BLOCK, text)


if __name__ == "__main__":
    main()

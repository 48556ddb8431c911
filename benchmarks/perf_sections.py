"""The sections of docs/performance.md, made of what ``perf.py`` measured."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
import psutil
import query_speed
from growth import HEIGHT, WIDTH, Growth
from measuring import Bar, Spread, markdown
from overhead import tables
from query_speed import BAR_SECONDS
from render_speed import BLEND_BAR, BLEND_COUNT, STAGES, TORCH_BAR, RenderTimes, linear_fit

from reports.environment import describe_environment

if TYPE_CHECKING:
    from perf import Measured

MS = 1e-3
NEXT_PLACES = 3
SHOWN_PLACES = 10
VERSIONS = ("numpy", "numba", "torch", "gsplat", "prefect", "mlflow")


def sections(found: Measured) -> dict[str, str]:
    """Name of a block of the page -> its Markdown."""
    return {name: section(found) for name, section in SECTIONS.items()}


def machine(found: Measured) -> str:
    """Where and how it was measured."""
    here = describe_environment()
    versions = [f"{name} {here.packages[name]}" for name in VERSIONS if name in here.packages]
    revision = (here.git_revision or "no revision")[:12] + (", changed" if here.git_dirty else "")
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    rows = [
        ("processor", f"{here.cpu_count} x {here.processor}"),
        ("memory", f"{psutil.virtual_memory().total / 2**30:.0f} GiB"),
        ("GPU", here.gpu or "none"),
        ("system", here.platform),
        ("versions", f"Python {here.python}, {', '.join(versions)}"),
        ("revision", revision),
        ("command", "make perf" if not found.plan.quick else "benchmarks/perf.py --quick"),
        ("took", f"{found.seconds / 60:.1f} min"),
        ("load at its end, 1, 5, 15 min", load),
    ]
    return markdown(("what", "found"), rows)


def bars(found: Measured) -> str:
    """All bars, and how this run stands."""
    return markdown(("bar", "measured", "limit", ""), [bar.cells() for bar in all_bars(found)])


def all_bars(found: Measured) -> list[Bar]:
    """The renderer's, then the workflow's."""
    (twin,) = found.twins.twins
    held = [times for times in found.renders if times.gaussians <= BLEND_COUNT]
    worst = max(held, key=lambda times: times.ratio)
    place = f"{worst.gaussians:,} Gaussians, {worst.width}x{worst.height}"
    return [
        Bar(
            f"rendering 200,000 Gaussians, 640x480, against {twin}",
            found.twins.ratio(twin), TORCH_BAR, "times as fast", at_least=True,
        ),
        Bar(
            f"blending against its arithmetic, at most {BLEND_COUNT:,} Gaussians (worst: {place})",
            worst.ratio, BLEND_BAR, "times as long",
        ),
        *(
            Bar(
                f"a query of {speed.method}, {speed.gaussians:,} Gaussians, {speed.views} views of "
                f"{speed.picture[0]}x{speed.picture[1]}, without the models",
                MS * speed.total.median, BAR_SECONDS, "s",
            )
            for speed in found.asked
        ),
        *found.overhead.bars,
    ]  # fmt: skip


def render(found: Measured) -> str:
    """Each stage of the renderer, and the fit over Gaussians and pixels."""
    rows = []
    for times in found.renders:
        spreads = [
            Spread.of([getattr(timing, stage) for timing in times.stages]) for stage in STAGES
        ]
        spreads.append(Spread.of(times.totals))
        spreads.append(Spread.of([timing.total for timing in times.masked]))
        size = f"{times.width}x{times.height}"
        cells = [spread.shown(MS) for spread in spreads]
        rows.append((f"{times.gaussians:,}", size, *cells, f"{times.ratio:.1f}"))
    head = ("Gaussians", "picture", *STAGES, "total", "with a mask", "blend / arithmetic")
    parts = [
        f"Milliseconds, median (least-most) of {found.plan.renders} pictures; the last column is "
        "in processor time of one core.",
        markdown(head, rows),
    ]
    if len(found.plan.sizes) > 1:
        points = [(t.width * t.height, t.gaussians, t.alone) for t in found.renders]
        (constant, pixel, gaussian), explained = linear_fit(points)
        parts.append(
            f"One core: {1e3 * constant:.1f} ms + {1e9 * pixel:.0f} ns a pixel + "
            f"{1e6 * gaussian:.3f} us a Gaussian, R^2 = {explained:.3f}."
        )
    (twin,) = found.twins.twins
    parts.append(
        f"200,000 Gaussians, 640x480, least of all: {found.twins.ours / MS:.1f} ms, {twin} "
        f"{found.twins.twins[twin] / MS:,.0f} ms, {found.twins.ratio(twin):.0f} times as long."
    )
    return "\n\n".join(parts)


def methods(found: Measured) -> str:
    """The methods against the lifting baseline."""
    plan = found.plan
    lift = next(times for times in found.methods if times.method == "lift")
    rows = [
        (
            times.method,
            times.prepare.shown(digits=2),
            f"{times.prepare.median / lift.prepare.median:.2f}",
            times.query.shown(MS),
            f"{times.query.median / lift.query.median:.1f}",
        )
        for times in found.methods
    ]
    return "\n\n".join(
        [
            f"{plan.gaussians:,} Gaussians, {plan.views} views of {WIDTH}x{HEIGHT}, oracle "
            f"models; median (least-most) of {plan.repeats} preparations and of {plan.queries} "
            f"queries, in turns.",
            markdown(
                ("method", "prepare, s", "of lift's", "a query, ms", "of lift's"), rows
            ),
        ]
    )  # fmt: skip


def grown(found: Measured) -> str:
    """Growth with Gaussians, views and queries."""
    rows = []
    for growth in found.grown:
        line = growth.fit
        points = "; ".join(f"{size:,}: {s.shown(digits=2)}" for size, s in growth.points)
        each = f"{1e6 * line.slope:,.3g} us"
        rows.append(
            (growth.what, growth.of, points, f"{line.constant:.3f} s + {each} each",
             _explained(growth))
        )  # fmt: skip
    first = min(found.renders, key=lambda times: times.gaussians)
    few = [t for t in found.renders if (t.width, t.height) == (first.width, first.height)]
    rows.append(_render_row(few))
    plan = found.plan
    head = ("what", "with", "seconds at each size, median (least-most)", "line", "R^2")
    return "\n\n".join(
        [
            f"In the room with oracle models; with Gaussians and queries on {min(plan.views, 10)} "
            f"views, with views and queries on {plan.gaussians // 2:,} Gaussians. Lines by least "
            "squares of relative errors.",
            markdown(head, rows),
        ]
    )


def _render_row(renders: list[RenderTimes]) -> tuple[str, ...]:
    points = tuple((times.gaussians, Spread.of(times.totals)) for times in renders)
    growth = Growth(f"a picture of {renders[0].width}x{renders[0].height}", "Gaussians", points)
    line = growth.fit
    shown = "; ".join(f"{size:,}: {s.shown(digits=3)}" for size, s in points)
    text = f"{line.constant:.3f} s + {1e6 * line.slope:,.3g} us each"
    return growth.what, growth.of, shown, text, _explained(growth)


def _explained(growth: Growth) -> str:
    """R^2, which says nothing where two points always lie on a line."""
    return f"{growth.fit.explained:.3f}" if len(growth.points) > 2 else "–"


def queries(found: Measured) -> str:
    """Queries step by step, alone and together."""
    return query_speed.markdown(found.asked)


def overhead(found: Measured) -> str:
    """The flow against the plain loop, and its stages."""
    seen = found.overhead
    stages = {name: seen.stage(name) for name in seen.flows[0].stages}
    whole = seen.flow.median
    rows = [
        (name, spread.shown(digits=2), f"{100 * spread.median / whole:.0f} %")
        for name, spread in stages.items()
    ]
    return "\n\n".join(
        [tables(seen), "The stages' own work in that flow, all scenes together:",
         markdown(("stage", "seconds", "of the process"), rows)]
    )  # fmt: skip


def next_places(found: Measured) -> str:
    """Where the time goes, by a profile of the same run."""
    first = "; ".join(
        f"{n}. `{spot.place}`, {spot.seconds:.1f} s, {100 * spot.share:.0f} %"
        for n, spot in enumerate(found.hot[:NEXT_PLACES], 1)
    )
    rows = [
        (f"`{spot.place}`", f"{spot.seconds:.2f}", f"{100 * spot.share:.1f} %")
        for spot in found.hot[:SHOWN_PLACES]
    ]
    rest = found.profile_seconds * (1 - float(np.sum([s.share for s in found.hot[:SHOWN_PLACES]])))
    rows.append(("all else", f"{rest:.2f}", f"{100 * rest / found.profile_seconds:.1f} %"))
    return "\n\n".join(
        [
            f"{found.profiled}: {found.profile_seconds:.1f} s. The next three places: {first}.",
            markdown(("function", "seconds", "of the whole"), rows),
        ]
    )


SECTIONS = {
    "perf-machine": machine,
    "perf-bars": bars,
    "perf-render": render,
    "perf-methods": methods,
    "perf-growth": grown,
    "perf-queries": queries,
    "perf-overhead": overhead,
    "perf-next": next_places,
}
"""Block of the page -> what makes it."""

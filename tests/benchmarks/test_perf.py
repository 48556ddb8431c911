"""The page that `make perf` writes."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import perf
import pytest
from growth import Growth, MethodTimes
from hot_spots import HotSpot
from measuring import Spread
from overhead import FlowRun, Overhead, Work
from perf import PAGE, QUICK, Measured, Plan, check_page, write
from perf_sections import SECTIONS, all_bars, grown
from PIL import Image
from query_speed import QuerySpeed, StepTime
from render_speed import RenderTimes, TwinTimes
from typer.testing import CliRunner

from gvr_core.rendering.numba_renderer import StageSeconds
from reports.document import read_block
from reports.result_check import ResultError


def sample() -> Measured:
    """A run with made-up figures."""
    timings = tuple(StageSeconds(0.001 * n, 0.001, 0.002, 0.010) for n in (1, 2, 3))

    def times(count: int, size: tuple[int, int], blend: float) -> RenderTimes:
        alone = 0.01 + 1e-7 * count + 1e-8 * size[0] * size[1]
        return RenderTimes(
            count, *size, count // 2, timings, timings, alone, 1_000_000, 1e9, blend
        )  # fmt: skip

    sizes = ((640, 480), (988, 731))
    renders = [times(n, size, 0.004) for n in (50_000, 200_000, 1_000_000) for size in sizes]
    renders[-1] = times(1_000_000, sizes[1], 0.030)  # above the bar, which does not hold there
    spread = Spread.of([0.5, 0.4, 0.9])
    flow = FlowRun(70.0, 90.0, {"MLflow": 0.7}, {"render": 7.0})
    points = tuple((n, Spread.of([0.01 * n])) for n in (10, 30, 100))
    grown = [Growth("gvr-paper: prepare", of, points) for of in ("Gaussians", "views", "queries")]
    total = StepTime("total", 100.0, 90.0, 120.0)
    asked = QuerySpeed(
        "gvr-paper", 200_000, 300, 30_000, (640, 480), 50, 0.1, (total,), total, 150.0, 80.0, 120.0
    )
    return Measured(
        plan=Plan(),
        renders=renders,
        twins=TwinTimes(0.05, {"torch-reference/1/float32": 4.0}),
        methods=[MethodTimes(name, spread, spread) for name in ("gvr-paper", "lift")],
        grown=grown,
        asked=[asked],
        overhead=Overhead(Work(), (60.0,), (80.0,), (flow,), 40),
        profiled="something",
        profile_seconds=10.0,
        hot=[HotSpot(f"gvr_core.f{n}", 5.0 / (n + 1), 0.5 / (n + 1)) for n in range(2)],
        seconds=600.0,
    )


def test_the_page_has_every_block() -> None:
    check_page(PAGE)
    assert {name for name in SECTIONS if read_block(PAGE, name)} <= set(SECTIONS)
    assert read_block(PAGE, "cuda-speed")


def test_a_page_without_a_block_is_refused_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Empty\n")
    monkeypatch.setattr(perf, "measure", lambda *_: pytest.fail("measured for nothing"))
    with pytest.raises(ResultError, match="perf-machine"):
        perf.main(quick=True, into=page)


def test_a_run_fills_the_page_and_draws_its_picture(tmp_path: Path) -> None:
    page = tmp_path / "performance.md"
    shutil.copy(PAGE, page)
    write(sample(), page)
    bars = read_block(page, "perf-bars")
    assert "| 80 times as fast | >= 20 times as fast | met |" in bars
    assert bars.count("| met |") == 5
    assert "| 0.1 s | <= 0.5 s | met |" in bars
    assert "Together is 0.80 of alone" in read_block(page, "perf-queries")
    assert "1. `gvr_core.f0`, 5.0 s, 50 %; 2. `gvr_core.f1`" in read_block(page, "perf-next")
    assert "all else | 2.50 | 25.0 %" in read_block(page, "perf-next")
    assert "| gvr-paper | 0.50 (0.40-0.90) | 1.00 |" in read_block(page, "perf-methods")
    assert "0.010 s + 10 ns a pixel + 0.100 us" not in read_block(page, "perf-render")
    assert "10.0 ms + 10 ns a pixel + 0.100 us a Gaussian" in read_block(page, "perf-render")
    assert "0.000 s + 1e+04 us each" in read_block(page, "perf-growth")
    with Image.open(tmp_path / "pictures" / "performance.png") as picture:
        assert picture.width > 1000


def test_the_bar_of_blending_holds_where_it_was_set() -> None:
    found = sample()
    blending = next(bar for bar in all_bars(found) if bar.what.startswith("blending"))
    assert blending.measured == pytest.approx(4)
    assert max(times.ratio for times in found.renders) == pytest.approx(30)


def test_two_points_are_not_said_to_lie_on_a_line() -> None:
    found = sample()
    two = Growth("gvr-paper: prepare", "views", found.grown[0].points[:2])
    assert "| 1.000 |" in grown(replace(found, grown=[found.grown[0]]))
    first_row = grown(replace(found, grown=[two])).splitlines()[4]
    assert first_row.endswith("| – |")


def test_quick_is_a_part_of_everything() -> None:
    full = Plan()
    for name in ("counts", "grown_gaussians", "grown_views", "grown_queries"):
        assert max(getattr(QUICK, name)) < max(getattr(full, name))
    assert max(full.grown_gaussians) == 1_000_000
    assert (min(full.grown_views), max(full.grown_views)) == (10, 300)
    assert (min(full.grown_queries), max(full.grown_queries)) == (1, 500)


@pytest.mark.slow
def test_a_quick_run_measures_all_and_writes_where_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "performance.md"
    shutil.copy(PAGE, page)
    monkeypatch.setenv("GVR_DATA", str(tmp_path / "data"))
    app = perf.typer.Typer()
    app.command()(perf.main)
    result = CliRunner().invoke(app, ["--quick", "--into", str(page)])
    assert result.exit_code == 0, result.output
    for name in SECTIONS:
        assert read_block(page, name).count("|") > 10, name
    assert "agree in all" in read_block(page, "perf-overhead")
    assert "gvr_core." in read_block(page, "perf-next")

"""The tables of runs whose lines are compared."""

from __future__ import annotations

import io
import re
from collections.abc import Callable

import pytest
from comparison_samples import large_run, make_run, scene_line, small_run
from record_samples import Sample
from rich.cells import cell_len
from rich.console import Console, RenderableType

from reports import tables
from reports.record import Result, Row
from reports.sheet import TERMINAL_WIDTH


def shown(what: RenderableType, width: int = TERMINAL_WIDTH) -> str:
    file = io.StringIO()
    Console(file=file, width=width, color_system=None).print(what)
    return file.getvalue()


def cells(block: str, label: str, table: str) -> list[str]:
    """The cells of a label's row in the Markdown table under a title."""
    lines = block[block.index(table) :].splitlines()
    (found, *_) = [line for line in lines if line.startswith(f"| {label} |")]
    return [cell.strip() for cell in found.strip("|").split("|")]


def test_a_line_of_the_comparison() -> None:
    text = tables.readme_block(*small_run())
    assert "| line | against | 3D IoU | difference | lowest scene | mIoU | Acc |" in text
    # Percentiles of three scenes are the scenes' own extremes.
    assert cells(text, "base", "rooms: lines compared") == [
        *("base", "–", "63.3 (50.0, 90.0)", "–", "50.0 (kitchen)"),
        *("31.7", "50.0", "100.0", "1.00 (1.00, 1.00)"),
    ]
    without = cells(text, "w/o votes", "rooms: lines compared")
    assert without[1] == "base"
    assert without[3] == "-10.0 (-10.0, -10.0)"
    assert without[-1] == "0.00 (0.00, 0.00)"


def test_failures_and_left_out_pairs_are_told() -> None:
    text = tables.readme_block(*small_run())
    assert cells(text, "other", "rooms: lines compared")[2].startswith(r"55.0\* (")
    assert "* failed: other on attic." in text.replace("\\", "")
    assert "Left out of differences, as only one was scored: other 1." in text
    assert "4 queries for present against 3 for absent objects" in text


def test_a_single_scene_is_shown_without_interval() -> None:
    result, rows = make_run(
        [
            scene_line("kitchen", "base", {"cup": 0.4, "plate": 0.8}),
            scene_line("kitchen", "other", {"cup": 0.5, "plate": 0.8}, reference="base"),
        ]
    )
    text = tables.readme_block(result, rows)
    found = cells(text, "other", "rooms: lines compared")
    assert (found[2], found[3], found[-1]) == ("65.0 (–)", "+5.0 (–)", "1.00 (–)")
    assert "(–): a single scene, so no interval." in text
    assert "AUROC (–): no interval" in text


def test_small_runs_keep_their_tables_and_get_the_comparison(sample: Sample) -> None:
    compared = tables.readme_block(*small_run())
    titles = [line for line in compared.splitlines() if line.startswith("**")]
    assert [title.split(": ")[1].split(",")[0].strip("*") for title in titles] == [
        "Acc / mIoU / 3D IoU",
        "lines compared",
        "seconds to prepare a scene",
        'answered "not here"',
    ]
    result, rows, _ = sample
    plain = tables.readme_block(result, rows)
    assert "compared" not in plain
    assert "difference" not in shown(tables.overview(result, rows))
    assert ": stages" in shown(tables.overview(result, rows))


def test_large_runs_get_a_row_a_line() -> None:
    result, rows = large_run()
    text = tables.readme_block(result, rows)
    titles = [line.strip("*") for line in text.splitlines() if line.startswith("**")]
    assert titles == [
        f"rooms, {models} models: {what}"
        for what in (
            "lines compared, per cent, and AUROC",
            "3D IoU by scene, per cent",
            'mean seconds, and answers "not here"',
        )
        for models in ("oracle", "onboard")
    ]
    # 22 lines of two model sets in three tables, and no line for each scene.
    assert len(re.findall(r"^\| (?!line|:)", text, re.MULTILINE)) == 2 * 3 * 22
    robust = cells(text, "gvr-robust", "rooms, onboard models: lines")
    assert robust[1:4] == ["gvr-paper", "100.0 (100.0, 100.0)", "+90.0 (+90.0, +90.0)"]
    assert cells(text, "gvr-robust", "rooms, oracle models: 3D IoU") == [
        "gvr-robust",
        *["100.0"] * 10,
    ]
    assert cells(text, "gvr-robust", "rooms, oracle models: mean")[1:] == [
        *("12.5", "0.75", "10 of 10", "0 of 10")
    ]


def test_the_limit_between_small_and_large() -> None:
    lines = [scene_line("kitchen", "base", {"cup": 0.4})]
    lines += [
        scene_line("kitchen", f"m{i}", {"cup": 0.4}, reference="base")
        for i in range(tables.MANY_LINES)
    ]
    assert tables.is_large(make_run(lines)[0])
    assert not tables.is_large(make_run(lines[:-1])[0])
    # Old results know of no references, and are shown as they always were.
    bare = make_run(lines)[0]
    bare = bare.model_copy(
        update={"scenes": tuple(s.model_copy(update={"reference": None}) for s in bare.scenes)}
    )
    assert not tables.is_large(bare)


@pytest.mark.parametrize("run", [small_run, large_run, lambda: large_run(3, 1)])
def test_fits_the_terminal_and_loses_no_digit(
    run: Callable[[], tuple[Result, list[Row]]],
) -> None:
    result, rows = run()
    what = tables.overview(result, rows)
    narrow, wide = shown(what), shown(what, 400)
    assert max(cell_len(line) for line in narrow.splitlines()) <= TERMINAL_WIDTH
    # Names and notes may fold; every number of a cell stays in one piece.
    number = re.compile(r"(?<![\w.])[-+]?\d+\.\d+\*?(?![\w.])")
    assert sorted(number.findall(narrow)) == sorted(number.findall(wide))
    assert "…" not in narrow


def test_a_large_run_is_summed_up_in_the_terminal() -> None:
    text = shown(tables.overview(*large_run()))
    assert ": stages" not in text  # of each scene; those of all are summed up
    assert len(text.splitlines()) < 600
    for models in ("oracle", "onboard"):
        assert f"rooms, {models} models: 3D IoU, per cent" in text
        assert re.search(rf"rooms, {models} models: 3D IoU by scene, per cent \(1 of \d\)", text)

from __future__ import annotations

import io
import re
from collections.abc import Callable

import pytest
from record_samples import PLANE, SOLID, Sample, row, scene_result
from rich.cells import cell_len
from rich.console import Console, RenderableType

from reports import tables
from reports.record import Result, Row
from reports.sheet import TERMINAL_WIDTH


def shown(what: RenderableType, width: int = TERMINAL_WIDTH) -> str:
    file = io.StringIO()
    Console(file=file, width=width, color_system=None).print(what)
    return file.getvalue()


def line_of(text: str, *starts: str) -> list[str]:
    """The words of the first line that holds all these words."""
    for line in text.splitlines():
        if all(start in line.split() for start in starts):
            return line.split()
    raise LookupError(starts)


@pytest.fixture
def crowded() -> tuple[Result, list[Row]]:
    """Nine scenes with long names and three methods: far too much for one screen."""
    from record_samples import make_sample

    result, _, _ = make_sample()
    methods = ["gvr-paper", "gvr-robust (no bird's-eye view)", "random-patch"]
    names = [f"academic_tarot_cards_{i}" for i in range(9)]
    scenes = tuple(
        scene_result(name, method, ["cup"], n_gaussians=12_345_678, prepare_seconds=98_765.4)
        for name in names
        for method in methods
    )
    rows = [
        row("cup", protocol, {"iou": 1.0, "acc_peak": 1.0}, scene=s.scene, method=s.method)
        for s in scenes
        for protocol in (PLANE, SOLID)
    ]
    return result.model_copy(update={"scenes": scenes}), rows


def test_headline_numbers(sample: Sample) -> None:
    result, rows, _ = sample
    text = shown(tables.headline(result, rows))
    assert line_of(text, "method")[1:] == ["kitchen", "garden", "overall"]
    assert line_of(text, "gvr-paper", "Acc")[2:] == ["66.7", "0.0", "33.3"]
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("gvr-paper"))
    assert lines[first + 1].split() == ["mIoU", "60.0", "20.0", "40.0"]
    assert lines[first + 2].split() == ["3D", "IoU", "60.0", "30.0", "45.0"]


def test_failed_scenes_and_partial_means_are_marked(sample: Sample) -> None:
    result, rows, _ = sample
    text = shown(tables.headline(result, rows))
    assert line_of(text, "lift", "Acc")[2:] == ["100.0", "failed", "100.0*"]
    assert "\n* not over every scene" in text
    whole = [scene for scene in result.scenes if scene.method == "gvr-paper"]
    assert "*" not in shown(tables.headline(result.model_copy(update={"scenes": whole}), rows))


def test_protocols_are_named(sample: Sample) -> None:
    result, rows, _ = sample
    text = " ".join(shown(tables.headline(result, rows)).split())
    assert f"Acc: acc_peak of {PLANE}" in text
    assert f"3D IoU: iou of {SOLID}" in text


def test_times(sample: Sample) -> None:
    result, _, _ = sample
    text = shown(tables.timing(result))
    expected = ["12.5", "0.75", "3", "7", "320x240", "12,345", "524*"]
    assert line_of(text, "gvr-paper", "kitchen")[2:] == expected
    assert line_of(text, "lift", "garden")[2:] == ["failed", *["–"] * 6]
    assert "*: other scenes ran in threads" in " ".join(text.split())


def test_a_peak_is_unmarked_only_where_it_is_known_to_be_the_stage_s_own(sample: Sample) -> None:
    result, _, _ = sample
    (scene, *_) = result.scenes

    def shown_peak(*peaks: str | None) -> str:
        pairs = zip(scene.stages, peaks, strict=True)
        stages = tuple(stage.model_copy(update={"peak_of": of}) for stage, of in pairs)
        alone = scene.model_copy(update={"stages": stages})
        text = shown(tables.timing(result.model_copy(update={"scenes": (alone,)})))
        return line_of(text, "gvr-paper", "kitchen")[-1]

    assert shown_peak("stage", "stage") == "524"
    for marked in ("shared", "process", None):
        assert shown_peak("stage", marked) == shown_peak(marked, "stage") == "524*"


def test_stages(sample: Sample) -> None:
    result, _, _ = sample
    text = shown(tables.stages(result))
    assert line_of(text, "masks") == ["masks", "computed", "10.0", "18.0", "315"]
    assert line_of(text, "encode") == ["encode", "cached", "2.50", "4.00", "524*"]
    assert " ".join(line_of(text, "segment")) == "a query: segment mean of 3 0.50 – –"
    assert "failed: no masks" in text


def test_refusals(sample: Sample) -> None:
    result, rows, _ = sample
    text = shown(tables.refusals(result, rows))
    assert line_of(text, "gvr-paper", "kitchen")[2:] == ["1", "of", "1", "0", "of", "2"]
    assert shown(tables.refusals(result, [])) == ""


@pytest.mark.parametrize(
    "table",
    [
        lambda result, rows: tables.headline(result, rows),
        lambda result, rows: tables.timing(result),
        lambda result, rows: tables.stages(result),
        lambda result, rows: tables.refusals(result, rows),
    ],
)
def test_fits_the_terminal_and_loses_no_digit(
    crowded: tuple[Result, list[Row]],
    sample: Sample,
    table: Callable[[Result, list[Row]], RenderableType],
) -> None:
    for result, rows in (crowded, sample[:2]):
        narrow, wide = shown(table(result, rows)), shown(table(result, rows), 400)
        assert max((cell_len(line) for line in narrow.splitlines()), default=0) <= 80
        # Names may fold and then differ; every number stays in one piece.
        number = re.compile(r"(?<![\w.])\d[\d.,x]*\*?(?![\w.])")
        assert sorted(number.findall(narrow)) == sorted(number.findall(wide))
        assert "…" not in narrow


def test_scenes_go_on_in_further_blocks(crowded: tuple[Result, list[Row]]) -> None:
    result, rows = crowded
    text = shown(tables.headline(result, rows))
    blocks = len(re.findall(r"per cent \(\d of \d\)", text))
    assert blocks > 1
    assert text.count("overall") == 1
    # Acc, mIoU and 3D IoU of three methods, on nine scenes and overall.
    assert text.count("100.0") == 3 * 3 * (9 + 1)


def test_readme_block(sample: Sample) -> None:
    result, rows, _ = sample
    text = tables.readme_block(result, rows)
    assert "| gvr-paper | 66.7 / 60.0 / 60.0 | 0.0 / 20.0 / 30.0 | 33.3 / 40.0 / 45.0 |" in text
    assert "| gvr-paper | kitchen | 12.5 | 0.75 | 3 | 7 | 320x240 | 12,345 |" in text
    assert "| gvr-paper | kitchen | 1 of 1 | 0 of 2 |" in text
    assert "`20250102T030405Z-abcdef`" in text and "`0123456789ab`" in text
    assert "local changes" not in text
    dirty = result.environment.model_copy(update={"git_dirty": True})
    changed = result.model_copy(update={"environment": dirty})
    assert "with local changes" in tables.readme_block(changed, rows)


def test_odd_names_break_no_table(sample: Sample) -> None:
    result, _, _ = sample
    name = "a|b\x1b[31m\n# x [red]"
    odd = result.model_copy(update={"scenes": (scene_result(name, "m", ["cup"]),)})
    rows = [row("cup", PLANE, {"iou": 0.5, "acc_peak": 1.0}, scene=name, method="m")]
    text = shown(tables.headline(odd, rows), 200) + shown(tables.timing(odd), 200)
    assert "\x1b" not in text
    assert "a|b?[31m?# x [red]" in text
    block = tables.readme_block(odd, rows)
    assert "\x1b" not in block
    for line in block.splitlines():
        if line.startswith("|") and "m |" in line:
            assert len(re.findall(r"(?<!\\)\|", line)) in (4, 10)

from __future__ import annotations

import io
import re

import pytest
from comparison_samples import make_run, scene_line, small_run
from paper_samples import (
    GG,
    GG_COMPAT,
    LANGSPLAT,
    OPENGAUSSIAN,
    SCENES,
    Run,
    flat,
    line,
    notes,
    run,
    sheets,
    skipping,
    titled,
)
from record_samples import PLANE, row, scene_result
from rich.cells import cell_len
from rich.console import Console

from reports import tables
from reports.aggregate import aggregate
from reports.headline_sheets import headline_sheets
from reports.paper_table import published_sheets
from reports.sheet import TERMINAL_WIDTH


def test_the_papers_shape() -> None:
    found = sheets(run({"gvr-paper": flat(0.6)}), wide=True)
    measured = found[0]
    assert measured.title == f"{LANGSPLAT}: Acc / mIoU, per cent"
    assert measured.columns == ("method", *SCENES, "overall")
    assert line(measured, "gvr-paper")["overall"] == "100.0 / 60.0"
    published = titled(found, "rendered in 2D, published†: Acc")
    assert published.columns == measured.columns
    assert line(published, "GVR†")["overall"] == "87.5 / 56.2"
    assert line(published, "GVR†")["waldo_kitchen"] == "95.8 / 50.1"
    assert line(published, "LEGaussians†")["ramen"] == "73.7 / –"
    times = titled(found, "rendered in 2D, published†: seconds")
    assert tuple(line(times, "GVR†").values())[1:] == ("37", "0.25")
    assert tuple(line(times, "LangSplat†").values())[1:] == ("5,400", "2.7")


def test_measured_and_published_rows_never_share_a_sheet() -> None:
    made = run({"gvr-paper": flat(0.6), "LangSplat": flat(0.5)})
    for wide in (False, True):
        for sheet in sheets(made, wide=wide):
            names = [cells[0] for cells in sheet.rows if cells[0]]
            if "minus" in sheet.title:
                assert all(re.fullmatch(r".+ - .+†", name) for name in names)
            else:
                assert len({name.endswith("†") for name in names}) == 1
                assert ("published" in sheet.title) == names[0].endswith("†")


def test_differences_to_what_was_published() -> None:
    found = sheets(
        run({"gvr-paper": flat(0.6), "langsplat": flat(0.5), "lift": flat(0.7)}), wide=True
    )
    sheet = titled(found, "minus")
    assert [cells[0] for cells in sheet.rows] == ["gvr-paper - GVR†", "langsplat - LangSplat†"]
    ours = line(sheet, "gvr-paper - GVR†")
    assert ours["ramen"] == "+21.0 / +5.9"  # 100 - 79.0 and 60 - 54.1
    assert ours["overall"] == "+12.5 / +3.8"
    assert line(sheet, "langsplat - LangSplat†")["overall"] == "+15.7 / -1.4"
    assert "protocol GVR was scored is not known" in notes(sheet)
    assert not [s for s in sheets(run({"lift": flat(0.7)})) if "minus" in s.title]


def test_models_stand_in_the_name_and_the_label_decides() -> None:
    parts = []
    for scene in SCENES:
        item = scene_result(scene, "gvr-paper · oracle", [], dataset="lerf_ovs")
        item = item.model_copy(update={"label": "gvr-paper", "model_set": "oracle"})
        place = {"dataset": "lerf_ovs", "scene": scene, "method": item.method, "view": "v1"}
        parts.append((item, [row("q", LANGSPLAT, {"acc": 0.0, "iou": 0.0}, **place)]))
    sheet = titled(sheets(make_run(parts), wide=True), "minus")
    assert line(sheet, "gvr-paper · oracle - GVR†")["overall"] == "-87.5 / -56.2"


def test_overall_is_compared_only_over_the_published_scenes() -> None:
    two = {scene: flat(0.6)[scene] for scene in ("ramen", "teatime")}
    ours = line(titled(sheets(run({"gvr-paper": two}), wide=True), "minus"), "gvr-paper - GVR†")
    assert ours["teatime"] == "+10.0 / -9.5"
    assert ours["overall"] == "– / –"


def test_numbers_of_another_protocol_are_not_subtracted() -> None:
    scores = {"Gaussian Grouping": {s: [(0.5, 0.5)] for s in ("figurines", "ramen", "teatime")}}
    compat = run(scores, "lerf_mask", GG_COMPAT, "boundary_iou")
    assert (
        line(titled(sheets(compat, wide=True), "minus"), "Gaussian Grouping - Gaussian Grouping†")[
            "overall"
        ]
        == "-22.8 / -17.6"
    )
    strict = titled(sheets(run(scores, "lerf_mask", GG, "boundary_iou"), wide=True), "minus")
    assert strict.rows == ()
    assert f"numbers of {GG} against numbers of {GG_COMPAT}" in notes(strict)


def test_published_numbers_say_on_which_data() -> None:
    line_of_doubt = "† published on the original data, not on these scenes"
    made = run({"gvr-paper": flat(0.6)})
    unknown = [s for s in sheets(made) if "†" in s.title and s.notes and "seconds" not in s.title]
    assert len(unknown) == 2
    for sheet in unknown:
        assert sheet.notes[0].startswith(line_of_doubt + "; should these be the originals")
    sure = titled(sheets(made, wide=True, original=True), "rendered in 2D, published†: Acc")
    assert sure.notes[0] == "† published on these scenes; not measured here."
    other = sheets(made, wide=True, original=False)
    assert titled(other, "rendered in 2D, published†: Acc").notes[0] == line_of_doubt + "."
    assert not [sheet for sheet in other if "minus" in sheet.title]


@pytest.mark.parametrize("original", [None, True])
def test_scenes_that_only_use_the_layout_have_no_differences(original: bool | None) -> None:
    made = run({"gvr-paper": {"open_table": [(1.0, 0.6)]}})
    found = sheets(made, wide=True, original=original)
    published = titled(found, "rendered in 2D, published†: Acc")
    assert published.notes[0] == "† published on the original data, not on these scenes."
    assert set(published.columns[1:-1]) == set(SCENES)
    assert not [sheet for sheet in found if "minus" in sheet.title]


def test_other_numbers_of_labelled_pairs_are_told() -> None:
    few = {scene: values[:3] if scene == "ramen" else values for scene, values in flat(0.6).items()}
    sheet = titled(sheets(run({"gvr-paper": few}), wide=True), "rendered in 2D, published†: Acc")
    assert sheet.notes[0] == "† published on the original data, not on these scenes."
    assert sheet.notes[1].endswith("not as published: ramen 3 for 71.")


def test_other_data_sets_have_no_published_rows() -> None:
    for dataset in ("gallery", "composite"):
        result, rows = run({"gvr-paper": flat(0.6)}, dataset)
        summary = aggregate(rows, result.scenes)
        assert published_sheets(result, summary, dataset) == []
        assert (
            headline_sheets(result, summary)[0].title
            == f"{dataset}, {LANGSPLAT}: Acc / mIoU, per cent"
        )
    result, rows = run({"gvr-paper": flat(0.6)}, protocol=PLANE, second="acc_peak")
    assert published_sheets(result, aggregate(rows, result.scenes), "lerf_ovs") == []


def test_printed_overalls_that_do_not_add_up_are_marked() -> None:
    sheet = titled(
        sheets(run({"gvr-paper": flat(0.6)}), wide=True), "rendered in 2D, published†: Acc"
    )
    assert line(sheet, "GVR w/o RFL & SMFI†")["overall"] == "-26.6‡ / -18.2‡"
    assert "GVR w/o RFL & SMFI Acc -27.1, GVR w/o RFL & SMFI mIoU -28.2" in notes(sheet)
    assert "differences to GVR†" in notes(sheet)
    assert "‡" not in line(sheet, "GVR†")["overall"]
    assert "Read first-hand: GVR, GVR w/o RFL & SMFI;" in notes(sheet)
    assert f"Made by the evaluator that {LANGSPLAT} follows: LangSplat." in notes(sheet)


def crowded() -> Run:
    """Both protocols of LERF-OVS and ours, three methods, skipped pairs, a long name."""
    result, rows = skipping()
    labels = ("gvr-paper", "gvr-robust (no bird's-eye view)", "LangSplat")
    more = [
        each.model_copy(update={"protocol": protocol, "method": label})
        for each in rows
        for label in labels
        for protocol in (LANGSPLAT, OPENGAUSSIAN, PLANE)
    ]
    items = [i.model_copy(update={"method": label}) for i in result.scenes for label in labels]
    return result.model_copy(update={"scenes": tuple(items)}), more


def test_fits_the_terminal_and_loses_no_digit() -> None:
    def shown(width: int) -> str:
        file = io.StringIO()
        Console(file=file, width=width, color_system=None).print(tables.headline(*crowded()))
        return file.getvalue()

    narrow, wide = shown(TERMINAL_WIDTH), shown(400)
    assert max(cell_len(text) for text in narrow.splitlines()) <= TERMINAL_WIDTH
    number = re.compile(r"(?<![\w./])[-+]?\d[\d.,/x]*[*‡]?(?![\w.])")
    # Words of the notes may fold at a hyphen; numbers of the cells may not.
    assert sorted(number.findall(narrow)) == sorted(number.findall(wide))
    assert "…" not in narrow
    assert "87.5" in narrow and "GVR†" in narrow


def test_documents_hold_the_published_rows_below_the_measured_ones() -> None:
    text = tables.readme_block(*run({"gvr-paper": flat(0.6)}))
    titles = [found.strip("*") for found in text.splitlines() if found.startswith("**")]
    assert titles[:4] == [
        f"{LANGSPLAT}: Acc / mIoU, per cent",
        "lerf_ovs, rendered in 2D, published†: Acc / mIoU, per cent",
        "lerf_ovs, rendered in 2D, published†: seconds to prepare a scene, and to answer a query",
        f"{LANGSPLAT}, measured minus published†: Acc / mIoU, points",
    ]


def test_large_runs_keep_the_papers_table() -> None:
    parts = []
    for j in range(tables.MANY_LINES + 1):
        reference = None if j == 0 else "line 0"
        item, _ = scene_line("ramen", f"line {j}", {}, reference=reference)
        item = item.model_copy(update={"dataset": "lerf_ovs"})
        place = {"dataset": "lerf_ovs", "scene": "ramen", "method": f"line {j}", "view": "v1"}
        parts.append((item, [row("q", LANGSPLAT, {"acc": 1.0, "iou": j / 16}, **place)]))
    made = make_run(parts)
    assert tables.is_large(made[0])
    assert "| line 4 | 100.0 / 25.0 | 100.0 / 25.0 |" in tables.readme_block(*made)
    file = io.StringIO()
    Console(file=file, width=TERMINAL_WIDTH, color_system=None).print(tables.overview(*made))
    assert "GVR†" in file.getvalue()
    assert "published" not in tables.readme_block(*small_run())

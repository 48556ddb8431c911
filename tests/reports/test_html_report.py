"""The report of a run: its numbers are the result's, its names stay names, its size is bounded."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from report_samples import EVIL_METHOD, EVIL_SCENE, EVIL_TEXT, evil, make_result, written

from reports.aggregate import aggregate
from reports.headline import HEADLINE, overall_cell, scene_cell
from reports.html_report import report_page
from reports.result_check import ResultError
from reports.result_io import read_result, write_result


class Page(HTMLParser):
    """What a browser sees of a page, as far as these tests ask."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: dict[str, str] = {}
        self.tables: list[list[list[str]]] = []
        self._script: str | None = None
        self._cell: list[str] | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append((tag, found))
        if tag == "script":
            self._script = found.get("id") or f"code{len(self.scripts)}"
            self.scripts[self._script] = ""
        if tag == "table":
            self.tables.append([])
        if tag == "tr" and self.tables:
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self._cell = []

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._script = None
        if tag in ("td", "th") and self._cell is not None:
            self.tables[-1][-1].append("".join(self._cell).strip())
            self._cell = None

    def handle_data(self, data: str) -> None:
        if self._script is not None:
            self.scripts[self._script] += data
        elif self._cell is not None:
            self._cell.append(data)


def table_with(page: Page, *heads: str) -> list[list[str]]:
    """The first table that has all these heads."""
    return next(t for t in page.tables if any(set(heads) <= set(line) for line in t))


def test_headline_numbers_are_the_results(tmp_path: Path) -> None:
    folder = written(tmp_path, n_queries=5)
    result, rows = read_result(folder)
    summary = aggregate(rows, result.scenes)
    _, _, *lines = table_with(Page(report_page(folder)), "method", "Acc", "mIoU", "3D IoU")
    assert [line[0] for line in lines] == ["gvr-paper", "w/o RFL"]
    for method, *cells in lines:
        wanted = [
            f"{100 * scene_cell(result, summary, 'rooms', scene, method, column).value:.1f}"
            for scene in ("kitchen", "garden")
            for column in HEADLINE
        ]
        wanted += [
            f"{100 * overall_cell(result, summary, 'rooms', method, column).value:.1f}"
            for column in HEADLINE
        ]
        assert cells == wanted


def test_every_query_is_there_with_its_own_means(tmp_path: Path) -> None:
    folder = written(tmp_path, n_queries=4)
    result, rows = read_result(folder)
    page = Page(report_page(folder))
    data = json.loads(page.scripts["data"])
    assert len(data["rows"]) == sum(len(scene.queries) for scene in result.scenes) == 16
    assert [column["title"] for column in data["columns"]] == ["Acc", "mIoU", "3D IoU"]
    for line in data["rows"]:
        key = (line["scene"], line["method"], line["query"])
        own = [r for r in rows if (r.scene, r.method, r.query) == key]
        for column, value in zip(HEADLINE, line["values"], strict=True):
            found = [
                r.metrics[column.metric]
                for r in own
                if r.protocol == column.protocol and not r.absent
            ]
            assert value == (pytest.approx(sum(found) / len(found)) if found else None)
        for view, scores in line["views"].items():
            (only,) = [r for r in own if r.view == view]
            assert scores[1] == only.metrics["iou"]
        assert line["absent"] is (line["query"] == "thing-3")
        block = json.loads(page.scripts[f"evidence-{line['block']}"])
        assert line["query"] in [query["query"] for query in block["queries"]]


def test_failures_and_coverage_come_before_any_number(tmp_path: Path) -> None:
    text = report_page(evil(tmp_path))
    shown = text[text.index("<body>") :]
    assert shown.index("3 of 4") < shown.index("1 failed.") < shown.index('id="headline"')
    assert shown.index("garden · &lt;b&gt;bold") < shown.index('id="headline"')
    whole = report_page(written(tmp_path / "whole"))
    assert (
        "Nothing failed." in whole
        and "✗" not in whole[: whole.index('id="headline"')].split("<body>")[1]
    )


def test_pairs_that_were_not_evaluated_are_named(tmp_path: Path) -> None:
    result, rows, files = make_result()
    gone = next(r for r in rows if r.view == "v1" and r.method == "w/o RFL")
    rows[rows.index(gone)] = gone.model_copy(update={"metrics": {"skipped": 1.0}})
    folder = write_result(tmp_path / "run", result, rows, files)
    page = Page(report_page(folder))
    table = table_with(page, "data set", "evaluated", "number")
    assert ["rooms", "kitchen", "w/o RFL", "iou of gvr.in_scene_2d/1", "3 of 4"] in table


def test_names_stay_names(tmp_path: Path) -> None:
    text = report_page(evil(tmp_path))
    page = Page(text)
    for tag, attributes in page.tags:
        assert not any(name.startswith("on") for name in attributes), (tag, attributes)
        assert tag not in ("iframe", "object", "embed", "base", "img", "form")
        assert not str(attributes.get("href", "#")).startswith(("http", "javascript"))
    kinds = [a.get("type") for tag, a in page.tags if tag == "script"]
    assert kinds.count(None) == 1, "one script of our own, and data"
    data = json.loads(page.scripts["data"])
    assert EVIL_TEXT in {line["text"] for line in data["rows"]}
    assert EVIL_SCENE in {line["scene"] for line in data["rows"]}
    cells = {cell for table in page.tables for line in table for cell in line}
    assert EVIL_SCENE in cells and EVIL_METHOD in cells
    assert "49" not in cells, "a template inside a name is no template"


def test_the_page_may_ask_for_nothing(tmp_path: Path) -> None:
    text = report_page(written(tmp_path))
    page = Page(text)
    (policy,) = [a["content"] for t, a in page.tags if a.get("http-equiv")]
    assert policy is not None and policy.startswith("default-src 'none'; img-src data:;")
    for attribute in ("src", "href", "xlink:href", "action", "data"):
        for _, attributes in page.tags:
            value = attributes.get(attribute)
            assert value is None or value.startswith(("#", "data:")), value
    assert not re.search(r"@import|url\(\s*['\"]?(?!#|data:)", text)


def test_charts_say_their_numbers_in_words(tmp_path: Path) -> None:
    folder = written(tmp_path, n_queries=5)
    page = Page(report_page(folder))
    spoken = [a["aria-label"] for _, a in page.tags if a.get("role") == "img"]
    # 0.2 lower in each query of both scenes; IoUs of 0.1 and 0.15 only fall to 0
    lower = ((0.1 + 0.2 * 3) / 4 + (0.15 + 0.2 * 3) / 4) / 2
    assert any(
        label and f"against gvr-paper: w/o RFL -{100 * lower:.1f} (" in label for label in spoken
    )
    assert any(label and "masks 10.0, segment 2.5" in label for label in spoken)


def test_the_same_result_gives_the_same_page(tmp_path: Path) -> None:
    folder = written(tmp_path)
    assert report_page(folder) == report_page(folder)


def test_hundreds_of_queries_stay_small(tmp_path: Path) -> None:
    folder = written(tmp_path, n_queries=150, with_evidence=False)
    text = report_page(folder)
    assert len(json.loads(Page(text).scripts["data"])["rows"]) == 600
    assert len(text) < 600_000
    assert text.count("<tr") < 60, "rows of queries are made when they are looked at"


def test_evidence_beyond_the_bound_is_left_out_and_said(tmp_path: Path) -> None:
    folder = written(tmp_path)
    whole = report_page(folder)
    one = len((folder / "evidence/rooms/s0/m0.json").read_bytes())
    text = report_page(folder, most_bytes=int(1.5 * one))
    assert len(text) < len(whole) - 2 * one
    page = Page(text)
    blocks = [json.loads(page.scripts["data"])["rows"][i]["block"] for i in (0, 3)]
    assert blocks == [0, None]
    assert "No pictures here of rooms/kitchen · w/o RFL" in text and "--max-mb" in text


def test_damaged_evidence_is_refused(tmp_path: Path) -> None:
    folder = written(tmp_path)
    path = folder / "evidence/rooms/s0/m0.json"
    path.write_bytes(path.read_bytes().replace(b"bev", b"vbe"))
    with pytest.raises(ResultError, match=r"m0\.json.*changed after it was written"):
        report_page(folder)
    path.unlink()
    with pytest.raises(ResultError, match=r"m0\.json.*No such file"):
        report_page(folder)


def test_results_without_evidence_show_their_pictures(result_folder: Path) -> None:
    page = Page(report_page(result_folder))
    block = json.loads(page.scripts["evidence-0"])
    assert set(block["plain"]) == {"cup", "plate", "unicorn"}
    assert block["plain"]["cup"]["width"] == 8


def test_published_rows_stand_in_tables_of_their_own(tmp_path: Path) -> None:
    from paper_samples import flat, run

    result, rows = run({"gvr-paper": flat(0.5)})
    folder = write_result(tmp_path / "run", result, rows)
    page = Page(report_page(folder))
    tables = [t for t in page.tables if len(t) > 1 and "Acc" in t[1] and t[1][0] == "method"]
    names = [[line[0] for line in t[2:]] for t in tables]
    assert names[0] == ["gvr-paper"]
    assert "GVR†" in names[1] and "LangSplat†" in names[1]
    assert not any(name.endswith("†") for name in names[0])
    gvr = next(line for line in tables[1] if line[0] == "GVR†")
    assert gvr[-2:] == ["87.5", "56.2"]

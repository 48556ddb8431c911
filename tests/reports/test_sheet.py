"""Markdown sheets, with a Markdown parser as the judge."""

from __future__ import annotations

import io
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from rich.console import Console

from reports.sheet import Sheet, to_markdown, to_rich


def parsed_cells(markdown: str) -> list[str]:
    """The texts of a table's cells, as a reader of the rendered page sees them."""
    cells: list[str] = []
    tokens = MarkdownIt("commonmark").enable("table").parse(markdown)
    for before, token in pairwise(tokens):
        if before.type in ("th_open", "td_open"):
            assert {child.type for child in token.children or ()} <= {"text", "text_special"}
            cells.append("".join(child.content for child in token.children or ()))
    return cells


def one_row(*cells: str) -> Sheet:
    return Sheet("title", tuple(f"c{i}" for i in range(len(cells))), (cells,), n_names=1)


@pytest.mark.parametrize("name", ["gallery_0", "acc_peak", "in_scene_2d/1", "52.3 (41.0, 60.1)"])
def test_ordinary_names_and_numbers_stay_readable(name: str) -> None:
    assert f"| {name} | {name} |" in to_markdown(one_row(name, name))


odd = st.text(st.sampled_from("ab1_*|`<>[]()\\~ #!-"), min_size=1).map(str.strip).filter(bool)


@settings(max_examples=300, deadline=None)
@given(odd, odd)
def test_any_name_reads_as_it_is(first: str, second: str) -> None:
    cells = parsed_cells(to_markdown(one_row(first, second)))
    assert cells == ["c0", "c1", first, second]


def shown(sheet: Sheet) -> list[str]:
    """The lines of a terminal of 80 columns."""
    console = Console(width=80, file=io.StringIO(), legacy_windows=False)
    console.print(to_rich(sheet))
    return console.file.getvalue().splitlines()


def test_words_of_heads_and_numbers_stay_whole_where_names_have_to_fold() -> None:
    heads = ("method", "scene", "damaged artifacts", "recomputed for it", "Gaussians", "peak MB")
    row = ("gvr-paper · without RFL", "a_scene_with_a_long_name", *["1,234,567"] * 4)
    lines = shown(Sheet("t", heads, (row,), n_names=2))
    assert max(map(len, lines)) <= 80
    words = " ".join(lines).split()
    assert {"artifacts", "recomputed", "Gaussians", "peak", "MB"} <= set(words)
    assert words.count("1,234,567") == 4

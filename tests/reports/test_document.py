from __future__ import annotations

from pathlib import Path

import pytest

from reports.document import replace_block
from reports.result_check import ResultError

TEXT = """# Title

<!-- stress -->
old
<!-- /stress -->

The lines `<!-- stress -->` and <!-- /stress --> in a sentence are none.
<!-- bench -->
<!-- /bench -->
"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "page.md"
    path.write_text(TEXT)
    return path


def test_only_the_block_changes(page: Path) -> None:
    replace_block(page, "stress", "**new**\n\n| a |\n")
    assert page.read_text() == TEXT.replace("old\n", "**new**\n\n| a |\n")
    assert [path.name for path in page.parent.iterdir()] == ["page.md"]


def test_again_gives_the_same(page: Path) -> None:
    replace_block(page, "stress", "\nnew\n")
    once = page.read_bytes()
    replace_block(page, "stress", "new")
    assert page.read_bytes() == once


def test_an_empty_block_is_filled_and_can_be_emptied(page: Path) -> None:
    replace_block(page, "bench", r"back\slash \1 \g<0>")
    assert "<!-- bench -->\nback\\slash \\1 \\g<0>\n<!-- /bench -->\n" in page.read_text()
    replace_block(page, "bench", "x")
    assert "<!-- bench -->\nx\n<!-- /bench -->\n" in page.read_text()


def test_line_ends_and_letters_stay_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_bytes("é\r\n<!-- a -->\r\nold\r\n<!-- /a -->".encode())
    replace_block(path, "a", "ü\nö\n")
    assert path.read_bytes().decode() == "é\r\n<!-- a -->\r\nü\r\nö\r\n<!-- /a -->"


def test_a_link_stays_a_link(page: Path, tmp_path: Path) -> None:
    link = tmp_path / "link.md"
    link.symlink_to(page)
    replace_block(link, "stress", "new")
    assert link.is_symlink()
    assert "\nnew\n" in page.read_text()


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("<!-- stress -->\nold", "old"), "<!-- stress --> stands there 0 times"),
        (("<!-- /stress -->\n\n", "\n"), "<!-- /stress --> stands there 0 times"),
        (("# Title\n", "<!-- stress -->\n"), "<!-- stress --> stands there 2 times"),
        (("# Title", "<!-- /stress -->"), "<!-- /stress --> stands there 2 times"),
        (
            ("<!-- stress -->\nold\n<!-- /stress -->", "<!-- /stress -->\n<!-- stress -->"),
            "ends before it begins",
        ),
        (("<!-- stress -->\nold", "<!--stress-->\nold"), "stands there 0 times"),
    ],
)
def test_markers_that_do_not_fit_are_told_and_nothing_is_written(
    page: Path, change: tuple[str, str], found: str
) -> None:
    text = TEXT.replace(*change)
    assert text != TEXT
    page.write_text(text)
    with pytest.raises(ResultError) as caught:
        replace_block(page, "stress", "new")
    assert found in str(caught.value)
    assert str(page) in str(caught.value)
    assert page.read_text() == text


def test_both_lines_of_a_doubled_marker_are_named(page: Path) -> None:
    page.write_text(TEXT + "<!-- stress -->\n")
    with pytest.raises(ResultError, match="lines 3, 10"):
        replace_block(page, "stress", "new")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="cannot be read"):
        replace_block(tmp_path / "none.md", "stress", "new")
    (tmp_path / "binary.md").write_bytes(b"\xff\xfe")
    with pytest.raises(ResultError, match="cannot be read"):
        replace_block(tmp_path / "binary.md", "stress", "new")

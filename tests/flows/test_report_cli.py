"""gvr report and gvr compare, from a real run to their files and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from report_samples import written

from reports.result_io import read_result


@pytest.fixture
def results(home: Path) -> Path:
    """Two results, the later 20 points of IoU below the earlier one where there is room."""
    folder = home / "results"
    written(folder, n_queries=5, run_id="20260101T000000Z-00000a", shift=0.3)
    written(folder, n_queries=5, run_id="20260102T000000Z-00000b", shift=0.1)
    return folder


def test_a_run_is_reported_from_its_folder_alone(
    gvr, home, tmp_path, prefect_server, suite
) -> None:
    path = tmp_path / "small.toml"
    dataset = suite.datasets[0].name
    path.write_text(
        f"""
name = "small"
[[datasets]]
name = "{dataset}"
[[methods]]
method = "gvr-paper"
leave_one_out = true
[models]
segmenter = "oracle"
encoder = "oracle"
text_segmenter = "oracle"
"""
    )
    code, _, error = gvr("run", str(path), "--quiet", "--no-mlflow")
    assert code == 0, error
    (folder,) = (home / "results").iterdir()
    result, _ = read_result(folder)
    kept = {scene.method: scene.evidence for scene in result.scenes}
    own = kept["gvr-paper"] or ""
    assert own.startswith("evidence/") and own.endswith("/two-boxes/gvr-paper.json")
    assert kept["w/o RFL"] is None, "variants have no pictures"
    moved = tmp_path / "elsewhere" / folder.name
    moved.parent.mkdir()
    folder.rename(moved)
    code, out, error = gvr("report", str(moved), "--out", str(tmp_path / "out" / "r.html"))
    assert code == 0 and "r.html" in out, error
    text = (tmp_path / "out" / "r.html").read_text(encoding="utf-8")
    assert "a red box" in text and "data:image" in text and "w/o SMFI" in text
    off = path.read_text().replace('name = "small"\n', 'name = "small"\nevidence = false\n', 1)
    path.write_text(off)
    code, _, error = gvr("run", str(path), "--quiet", "--no-mlflow")
    assert code == 0, error
    (folder,) = (home / "results").iterdir()
    assert not (folder / "evidence").exists()


def test_the_newest_result_is_reported_under_the_home(gvr, home, results) -> None:
    code, out, _ = gvr("report")
    assert code == 0
    assert (home / "reports" / "20260102T000000Z-00000b.html").is_file()
    assert "20260102T000000Z-00000b.html" in out
    code, _, error = gvr("report", "nothing")
    assert code == 2 and "unknown result 'nothing'" in error
    code, _, error = gvr(
        "report", "--out", str(results / "20260101T000000Z-00000a" / "SHA256SUMS" / "x")
    )
    assert code == 2 and "cannot be written" in error


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [([], 0), (["--fail-if-drop", "1.0"], 1), (["--fail-if-drop", "60"], 0)],
)
def test_the_exit_code_is_the_verdict(gvr, results, arguments, expected) -> None:
    code, out, error = gvr(
        "compare", "20260101T000000Z-00000a", "20260102T000000Z-00000b", *arguments
    )
    assert code == expected
    assert "B - A" in out and "Got worse" in out
    said = "dropped: rooms · gvr-paper · mIoU: 57.5 to 37.5, 20.0 points"
    assert (said in error) is (expected == 1)


def test_json_and_a_page(gvr, results, tmp_path) -> None:
    page = tmp_path / "c.html"
    names = "20260101T000000Z-00000a", "20260102T000000Z-00000b"
    code, out, _ = gvr("compare", *names, "--json", "--html", str(page), "--fail-if-drop", "1")
    assert code == 1
    content = json.loads(out)
    assert content["a"] == names[0] and content["fail_if_drop"] == 1
    assert "Got worse" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("points", ["-1", "nan", "inf"])
def test_bad_bounds_and_results_end_with_2(gvr, results, points) -> None:
    names = "20260101T000000Z-00000a", "20260102T000000Z-00000b"
    code, _, error = gvr("compare", *names, "--fail-if-drop", points)
    assert code == 2 and "points, 0 or more" in error
    code, _, error = gvr("compare", names[0], "missing")
    assert code == 2 and "unknown result" in error
    written(results, n_queries=6, run_id="20260103T000000Z-00000c")
    code, _, error = gvr("compare", names[0], "20260103T000000Z-00000c")
    assert code == 2 and "--common" in error and "only in B" in error

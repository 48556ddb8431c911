"""Labels, model sets and references in the record: written, checked; older results have none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from comparison_samples import large_run, small_run
from record_samples import reseal

from reports.result_check import ResultError
from reports.result_io import read_result, write_result

NEW = ("label", "model_set", "reference", "attempts")


def test_lines_come_back(tmp_path: Path) -> None:
    for i, (result, rows) in enumerate((small_run(), large_run(2, 1))):
        folder = write_result(tmp_path / str(i), result, rows)
        assert read_result(folder) == (result, rows)


def test_a_result_from_before_there_were_lines_still_reads(result_folder: Path) -> None:
    path = result_folder / "result.json"
    content = json.loads(path.read_text())
    for scene in content["scenes"]:
        for name in NEW:
            del scene[name]
    path.write_text(json.dumps(content))
    reseal(result_folder)
    result, _ = read_result(result_folder)
    assert {(s.label, s.model_set, s.reference) for s in result.scenes} == {("", "", None)}
    assert {s.attempts for s in result.scenes} == {1}
    assert [s.shown_label for s in result.scenes] == [s.method for s in result.scenes]


@pytest.mark.parametrize("reference", ["gone", "other"])
def test_a_reference_must_have_run_on_the_scene(tmp_path: Path, reference: str) -> None:
    result, rows = small_run()
    scenes = list(result.scenes)
    assert scenes[2].method == "other"  # a line is no reference for itself either
    scenes[2] = scenes[2].model_copy(update={"reference": reference})
    with pytest.raises(ResultError, match=r"scenes\[2\].reference"):
        write_result(tmp_path / "run", result.model_copy(update={"scenes": tuple(scenes)}), rows)
    assert not list(tmp_path.iterdir())


def test_a_line_stands_there_once(tmp_path: Path) -> None:
    result, rows = small_run()
    doubled = (*result.scenes, result.scenes[1])
    with pytest.raises(ResultError, match=r"scenes\[1\] and scenes\[9\]"):
        write_result(tmp_path / "run", result.model_copy(update={"scenes": doubled}), rows)

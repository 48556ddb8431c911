from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from pydantic import ValidationError
from record_samples import PLANE, Sample, reseal, row

from gvr_core.errors import InputError
from reports.record import Row
from reports.result_check import ResultError
from reports.result_io import list_results, new_run_id, read_result, write_result


def test_round_trip(sample: Sample, result_folder: Path) -> None:
    result, rows, pictures = sample
    assert read_result(result_folder) == (result, rows)
    for name, content in pictures.items():
        assert (result_folder / name).read_bytes() == content


def test_table_holds_rows_with_nulls_for_what_is_undefined(
    sample: Sample, result_folder: Path
) -> None:
    _, rows, _ = sample
    table = pq.read_table(result_folder / "rows.parquet").to_pylist()
    assert len(table) == len(rows)
    assert table[0]["metric.iou"] == 0.8
    assert table[0]["metric.recall"] is None
    assert table[0]["view"] == "v1"
    assert table[7] | {"target": None, "absent": True, "metric.found": 0.0} == table[7]


def test_sums_are_those_of_sha256sum(result_folder: Path) -> None:
    lines = (result_folder / "SHA256SUMS").read_text().splitlines()
    listed = dict(reversed(line.split("  ")) for line in lines)
    present = {
        path.relative_to(result_folder).as_posix()
        for path in result_folder.rglob("*")
        if path.is_file() and path.name != "SHA256SUMS"
    }
    assert set(listed) == present
    for name, digest in listed.items():
        assert hashlib.sha256((result_folder / name).read_bytes()).hexdigest() == digest


def test_pictures_are_taken_from_files_too(sample: Sample, tmp_path: Path) -> None:
    result, rows, pictures = sample
    files = {}
    for i, (name, content) in enumerate(pictures.items()):
        files[name] = tmp_path / f"{i}.png"
        files[name].write_bytes(content)
    folder = write_result(tmp_path / "out", result, rows, files)
    for name, content in pictures.items():
        assert (folder / name).read_bytes() == content


def test_never_overwrites(sample: Sample, result_folder: Path) -> None:
    before = {p: p.read_bytes() for p in result_folder.rglob("*") if p.is_file()}
    result, _, _ = sample
    with pytest.raises(ResultError, match="never overwritten"):
        write_result(result_folder, result.model_copy(update={"suite": "other"}), [])
    assert {p: p.read_bytes() for p in result_folder.rglob("*") if p.is_file()} == before


def test_loses_a_race_without_touching_the_winner(
    sample: Sample, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result, rows, pictures = sample
    target = tmp_path / "results" / "r"
    rename = Path.rename

    def after_somebody_else(self: Path, to: Path) -> Path:
        to.mkdir()
        (to / "theirs").write_text("first")
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", after_somebody_else)
    with pytest.raises(ResultError, match="cannot write"):
        write_result(target, result, rows, pictures)
    assert [p.name for p in target.iterdir()] == ["theirs"]
    assert list(target.parent.iterdir()) == [target]


def test_leaves_nothing_when_it_fails(sample: Sample, tmp_path: Path) -> None:
    result, rows, pictures = sample
    missing = {**pictures, next(iter(pictures)): tmp_path / "no such.png"}
    with pytest.raises(ResultError, match=r"no such\.png"):
        write_result(tmp_path / "results" / "r", result, rows, missing)
    assert list((tmp_path / "results").iterdir()) == []


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_row_holds_what_is_not_finite(value: float) -> None:
    with pytest.raises(ValidationError, match="finite"):
        row("cup", PLANE, {"iou": value})


def test_refuses_to_write_what_is_not_finite(sample: Sample, tmp_path: Path) -> None:
    result, rows, pictures = sample
    smuggled = rows[0].model_copy(update={"metrics": {"iou": math.nan}})
    with pytest.raises(ResultError, match=r"rows\[0\]\.metrics\.iou"):
        write_result(tmp_path / "a", result, [smuggled], pictures)
    odd = result.model_copy(update={"config": {"a": [1.0, {"b": math.inf}]}})
    with pytest.raises(ResultError, match=r"result\.config\.a\[1\]\.b"):
        write_result(tmp_path / "b", odd, rows, pictures)
    assert not (tmp_path / "a").exists() and not (tmp_path / "b").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r, p: ([*r, r[1]], p), r"rows\[1\] and rows\[14\]"),
        (lambda r, p: ([*r, row("x", PLANE, {}, scene="attic")], p), "own scenes"),
        (lambda r, p: (r, {}), "no picture"),
        (lambda r, p: (r, p | {"pictures/../../x.png": b""}), "a picture named"),
        (lambda r, p: (r, p | {"/etc/x.png": b""}), "a picture named"),
        (lambda r, p: (r, p | {"result.json": b""}), "a picture named"),
    ],
)
def test_refuses_what_does_not_fit_together(
    sample: Sample,
    tmp_path: Path,
    change: Callable[..., tuple[list[Row], dict[str, bytes]]],
    message: str,
) -> None:
    result, rows, pictures = sample
    rows, pictures = change(rows, pictures)
    with pytest.raises(ResultError, match=message):
        write_result(tmp_path / "r", result, rows, pictures)
    assert not (tmp_path / "r").exists()


def test_separators_of_unicode_do_not_tear_lines(sample: Sample, tmp_path: Path) -> None:
    result, _, pictures = sample
    odd = row("cup", PLANE, {"iou": 0.5}, text="a\u2028b\x85c\nd \N{PILE OF POO}")
    folder = write_result(tmp_path / "r", result, [odd], pictures)
    assert read_result(folder)[1] == [odd]


def test_another_writers_unescaped_separators_do_not_either(result_folder: Path) -> None:
    path = result_folder / "rows.jsonl"
    path.write_text(path.read_text().replace('"the cup"', '"the\u2028cup"'), encoding="utf-8")
    reseal(result_folder)
    assert read_result(result_folder)[1][0].text == "the\u2028cup"


def test_no_rows_at_all(sample: Sample, tmp_path: Path) -> None:
    result, _, pictures = sample
    assert read_result(write_result(tmp_path / "r", result, [], pictures)) == (result, [])


def edit(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(change((folder / name).read_text())) and None


@pytest.mark.parametrize(
    ("damage", "seal", "message"),
    [
        (lambda f: (f / "result.json").unlink(), False, r"result\.json: the file is missing"),
        (lambda f: (f / "rows.jsonl").unlink(), False, r"rows\.jsonl: the file is missing"),
        (lambda f: (f / "SHA256SUMS").unlink(), False, "SHA256SUMS: the file is missing"),
        (edit("result.json", lambda t: t[:200]), False, r"result\.json, line \d+, column"),
        (edit("rows.jsonl", lambda t: t[:-30]), False, r"rows\.jsonl, line 14, column"),
        (edit("rows.jsonl", lambda t: t + "\n"), True, r"rows\.jsonl, line 15, column 1"),
        (edit("rows.jsonl", lambda t: t.replace("0.8", "NaN")), True, "line 1: .*NaN"),
        (edit("rows.jsonl", lambda t: t.replace("0.8", "1e999")), True, "line 1, metrics.iou"),
        (edit("rows.jsonl", lambda t: t.replace("0.8", "0.9")), False, "changed after"),
        (edit("rows.jsonl", lambda t: "".join(t.splitlines(True)[:-1])), False, "changed after"),
        (edit("rows.jsonl", lambda t: t.replace('"view"', '"vue"')), True, r"line 1, v\w+: "),
        (edit("result.json", lambda t: "[]"), True, "schema version None"),
        (edit("result.json", lambda t: t.replace('version": 1', 'version": 2')), True, "newer"),
        (edit("result.json", lambda t: t.replace('"suite"', '"sweet"', 1)), True, "suite"),
        (edit("result.json", lambda t: "[" * 100_000), True, r"result\.json"),
        (lambda f: (f / "rows.jsonl").write_bytes(b"\xff\xfe"), False, "UTF-8"),
        (lambda f: (f / "SHA256SUMS").write_text("abc\n"), False, "SHA256SUMS, line 1"),
    ],
)
def test_damage_is_named(
    result_folder: Path, damage: Callable[[Path], object], seal: bool, message: str
) -> None:
    damage(result_folder)
    if seal:
        reseal(result_folder)
    with pytest.raises(ResultError, match=message) as caught:
        read_result(result_folder)
    assert isinstance(caught.value, InputError)
    assert caught.value.path is not None
    assert caught.value.accepted is not None


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="no such folder"):
        read_result(tmp_path / "nowhere")


def test_results_are_listed_by_time(sample: Sample, tmp_path: Path) -> None:
    result, rows, pictures = sample
    assert list_results(tmp_path / "none") == []
    for name in ("b", "a"):
        write_result(tmp_path / name, result, rows, pictures)
    (tmp_path / ".half.tmp").mkdir()
    (tmp_path / ".half.tmp" / "result.json").write_text("{}")
    (tmp_path / "empty").mkdir()
    assert [path.name for path in list_results(tmp_path)] == ["a", "b"]


def test_run_ids_differ_and_are_accepted(sample: Sample) -> None:
    ids = {new_run_id() for _ in range(50)}
    assert len(ids) == 50
    result, _, _ = sample
    for name in ids:
        content = result.model_dump() | {"run_id": name}
        assert type(result).model_validate(content).run_id == name
    with pytest.raises(ValidationError, match="run_id"):
        type(result).model_validate(result.model_dump() | {"run_id": "a' or 1=1"})


def test_json_is_plain(result_folder: Path) -> None:
    def refuse(text: str) -> None:
        raise AssertionError(text)

    content = json.loads((result_folder / "result.json").read_text(), parse_constant=refuse)
    assert content["schema_version"] == 1

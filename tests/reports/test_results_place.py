"""Results at a URL: complete or not there, never overwritten, and copied before they are read."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from record_samples import make_sample
from s3_server import S3Server

from gvr_core.errors import RemoteError
from gvr_core.remote_folder import RemoteFolder
from reports.result_check import ResultError
from reports.result_io import read_result
from reports.results_place import ResultsPlace


@pytest.fixture(params=["s3", "file"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "file":
        return f"file://{tmp_path}/shared"
    return f"s3://{request.getfixturevalue('s3').new_bucket()}/results"


def files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*.*")}


def test_a_result_written_here_is_read_there(url: str, tmp_path: Path) -> None:
    result, rows, pictures = make_sample()
    here, there = ResultsPlace(url, tmp_path / "a"), ResultsPlace(url, tmp_path / "b")
    folder = here.write(result, rows, pictures)
    assert there.names() == [result.run_id] and not there.root.exists()
    copy = there.folder(result.run_id)
    assert read_result(copy) == read_result(folder) == (result, rows)
    assert files(copy).keys() == files(folder).keys() >= pictures.keys()
    assert files(copy) == files(folder)
    assert [p.name for p in there.root.iterdir()] == [result.run_id]
    assert here.push() == []


def test_half_a_result_is_not_listed_and_goes_along_later(
    url: str, tmp_path: Path, monkeypatch, caplog
) -> None:
    result, rows, pictures = make_sample()
    here, there = ResultsPlace(url, tmp_path / "a"), ResultsPlace(url, tmp_path / "b")
    real, count = RemoteFolder.upload, [0]

    def breaks(self: RemoteFolder, source: Path, name: str) -> None:
        count[0] += 1
        if count[0] == 3:
            raise RemoteError("cut off")
        real(self, source, name)

    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
        patch.setattr(RemoteFolder, "upload", breaks)
        folder = here.write(result, rows, pictures)
    assert "cut off" in caplog.text and read_result(folder) == (result, rows)
    assert there.names() == [] and here.names() == [result.run_id]
    later = result.model_copy(update={"run_id": "20250103T000000Z-abcdef"})
    here.write(later, rows, pictures)
    assert there.names() == [result.run_id, later.run_id]
    assert read_result(there.folder(result.run_id)) == (result, rows)


def test_a_result_at_the_url_is_never_overwritten(url: str, tmp_path: Path, caplog) -> None:
    result, rows, pictures = make_sample()
    ResultsPlace(url, tmp_path / "a").write(result, rows, pictures)
    other = result.model_copy(update={"wall_seconds": 1.0})
    mine = ResultsPlace(url, tmp_path / "b")
    mine.write(other, rows, pictures)  # of the same run id: not even begun
    assert mine.push() == []
    fresh = ResultsPlace(url, tmp_path / "c")
    assert read_result(fresh.folder(result.run_id))[0] == result
    with pytest.raises(ResultError, match="never overwritten"):
        mine._push_one(mine.remote, mine.root / result.run_id)  # as if both began at once
    assert (
        RemoteFolder(url).read(f"{result.run_id}/result.json", 10**6)
        == (tmp_path / "a" / result.run_id / "result.json").read_bytes()
    )


@pytest.mark.parametrize("damage", ["rows", "picture", "missing", "sums", "stray", "escape"])
def test_a_damaged_or_hostile_result_is_refused_and_leaves_nothing(
    s3: S3Server, tmp_path: Path, damage: str
) -> None:
    result, rows, pictures = make_sample()
    root = f"{s3.new_bucket()}/results"
    ResultsPlace(f"s3://{root}", tmp_path / "a").write(result, rows, pictures)
    there, place = s3.files(), f"{root}/{result.run_id}"
    sums = there.cat_file(f"{place}/SHA256SUMS")
    if damage == "rows":
        there.pipe_file(f"{place}/rows.jsonl", b"")
    elif damage == "picture":
        name = next(iter(pictures))
        there.pipe_file(f"{place}/{name}", pictures[name][:-1] + b"?")
    elif damage == "missing":
        there.rm_file(f"{place}/rows.parquet")
    elif damage == "sums":
        there.rm_file(f"{place}/SHA256SUMS")
    else:
        name = "../../evil.txt" if damage == "escape" else ".bashrc"
        there.pipe_file(f"{place}/SHA256SUMS", sums + f"{'0' * 64}  {name}\n".encode())
    reader = ResultsPlace(f"s3://{root}", tmp_path / "b")
    with pytest.raises(ResultError) as found:
        reader.folder(result.run_id)
    assert result.run_id in str(found.value)
    assert list((tmp_path / "b").iterdir()) == []
    assert not list(tmp_path.glob("**/evil.txt"))


def test_a_folder_is_a_place_as_before(tmp_path: Path) -> None:
    result, rows, pictures = make_sample()
    place = ResultsPlace(tmp_path / "results")
    folder = place.write(result, rows, pictures)
    assert folder == tmp_path / "results" / result.run_id == place.folder(result.run_id)
    assert place.names() == [result.run_id] and place.push() == []
    with pytest.raises(ResultError, match="never overwritten"):
        place.write(result, rows, pictures)

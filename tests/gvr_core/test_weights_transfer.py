"""Resuming: from the byte where it broke off, and only if it is still the same file."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fetching_helpers import (
    HASTY,
    SIZE,
    file_of,
    get,
    names,
    noise,
    offer,
    pinned,
)
from weights_server import WeightsServer, weights_server

from gvr_core.errors import ModelError
from gvr_core.weights.folder import State, look, part_path
from gvr_core.weights.manifest import WeightsFile

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[WeightsServer]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with weights_server() as running:
        yield running


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "models"


def test_a_broken_connection_is_taken_up_where_it_broke(server, folder) -> None:
    served = offer(server, noise(), break_after=[1000, 70_000, 1])
    assert get(pinned(server), folder).path.read_bytes() == served.content
    assert server.ranges() == [None, "bytes=1000-", "bytes=71000-", "bytes=71001-"]
    assert {headers.get("If-Range") for _, headers in server.requests} == {None, served.tag}
    assert names(folder) == ["sub/w.dat"]


def test_progress_renews_the_patience_and_its_lack_ends_it(server, folder) -> None:
    served = offer(server, noise(), break_after=[1000] * 8)
    get(pinned(server), folder)
    assert len(server.requests) == 9  # three times the patience, each time something new
    served.break_after = [1000, 0, 0, 0, 0, 0]
    (folder / "sub/w.dat").unlink()
    server.requests.clear()
    with pytest.raises(ModelError, match="1,000 bytes are kept") as error:
        get(pinned(server), folder)
    assert server.url("w.dat") in str(error.value) and str(folder / "sub/w.dat") in str(error.value)
    assert "\n" not in str(error.value)
    assert len(server.requests) == 1 + HASTY.tries
    assert look(pinned(server), folder).state is State.PARTIAL


def test_an_interrupted_call_is_gone_on_with_by_the_next(server, folder) -> None:
    served = offer(server, noise())

    def stop(file: WeightsFile, done: int, total: int | None) -> None:
        if done > 100_000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        get(pinned(server), folder, progress=stop)
    there = look(pinned(server), folder)
    assert there.state is State.PARTIAL and 100_000 < there.bytes < SIZE
    assert not there.path.exists()
    server.requests.clear()
    assert get(pinned(server), folder).path.read_bytes() == served.content
    assert server.ranges() == [f"bytes={there.bytes}-"]


def test_a_killed_process_is_gone_on_with_by_the_next(server, folder) -> None:
    served = offer(server, noise(), stall_after=150_000)
    code = (
        "import sys; from pathlib import Path\n"
        "from gvr_core.weights.fetching import fetch_file\n"
        "from gvr_core.weights.manifest import WeightsFile\n"
        "fetch_file(WeightsFile.model_validate_json(sys.argv[1]), Path(sys.argv[2]))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, pinned(server).model_dump_json(), str(folder)], cwd=REPOSITORY
    )
    part = part_path(folder / "sub/w.dat")
    deadline = time.monotonic() + 60
    while not (part.exists() and part.stat().st_size == 150_000):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    served.resume.set()
    served.stall_after = None
    server.requests.clear()
    assert get(pinned(server), folder).path.read_bytes() == served.content
    assert server.ranges() == ["bytes=150000-"]
    assert names(folder) == ["sub/w.dat"]


def test_a_part_that_is_whole_is_not_asked_for_again(server, folder) -> None:
    served = offer(server, noise(), break_after=[SIZE - 10])

    def stop(file: WeightsFile, done: int, total: int | None) -> None:
        if done == total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        get(pinned(server), folder, progress=stop)
    server.requests.clear()
    assert get(pinned(server), folder).path.read_bytes() == served.content
    assert server.requests == []


@pytest.mark.parametrize("size", [SIZE, SIZE - 60_000, SIZE + 60_000, 150_000])
@pytest.mark.parametrize("how", [{}, {"if_range": False}, {"ranges": False}])
def test_a_file_that_changed_meanwhile_is_fetched_anew(server, folder, how, size) -> None:
    served = offer(server, noise(), break_after=[200_000, 0, 0, 0])
    file = file_of(server)  # nothing is known of it but the url
    with pytest.raises(ModelError, match="cannot be fetched"):
        get(file, folder)
    served.content = content = noise(1, size)
    for key, value in how.items():
        setattr(served, key, value)
    assert get(file, folder).path.read_bytes() == content


def test_a_server_that_ignores_ranges_is_asked_for_all_of_it(server, folder) -> None:
    served = offer(server, noise(), ranges=False, break_after=[100_000, 200_000])
    assert get(pinned(server), folder).path.read_bytes() == served.content
    assert server.ranges() == [None, "bytes=100000-", "bytes=200000-"]


def test_without_a_name_for_the_version_only_a_digest_allows_to_go_on(server, folder) -> None:
    served = offer(server, noise(), etag=False, break_after=[100_000])
    assert get(pinned(server), folder).path.read_bytes() == served.content
    assert server.ranges() == [None, "bytes=100000-"]
    served = offer(server, noise(2), "other.dat", etag=False, break_after=[100_000])
    server.requests.clear()
    assert get(file_of(server, "other.dat"), folder).path.read_bytes() == served.content
    assert server.ranges() == [None, None]
    stamp = "Mon, 10 Apr 2023 10:00:00 GMT"
    served = offer(server, noise(3), "dated.dat", etag=False, modified=stamp, break_after=[9])
    server.requests.clear()
    assert get(file_of(server, "dated.dat"), folder).path.read_bytes() == served.content
    assert server.requests[1][1]["If-Range"] == stamp


def test_a_weak_tag_names_no_version(server, folder) -> None:
    served = offer(server, noise(), weak=True, break_after=[100_000])
    assert get(file_of(server), folder).path.read_bytes() == served.content
    assert server.ranges() == [None, None]


def test_a_range_that_begins_elsewhere_is_not_appended(server, folder) -> None:
    served = offer(server, noise(), break_after=[100_000], shift=10)
    assert get(file_of(server), folder).path.read_bytes() == served.content
    assert server.ranges() == [None, "bytes=100000-", None]


def test_another_url_is_not_a_continuation(server, folder) -> None:
    offer(server, noise(), break_after=[100_000, 0, 0, 0])
    with pytest.raises(ModelError):
        get(file_of(server), folder)
    served = offer(server, noise(2), "mirror.dat")
    server.requests.clear()
    mirrored = file_of(server).model_copy(update={"url": server.url("mirror.dat")})
    assert get(mirrored, folder).path.read_bytes() == served.content
    assert server.ranges() == [None]


def test_a_length_that_is_not_said_is_no_obstacle(server, folder) -> None:
    served = offer(server, noise(), chunked=True, break_after=[100_000])
    assert get(file_of(server), folder).path.read_bytes() == served.content


def test_a_server_in_trouble_is_asked_again(server, folder) -> None:
    served = offer(server, noise(), statuses=[500, 503])
    assert get(pinned(server), folder).path.read_bytes() == served.content
    served.statuses = [500] * 9
    (folder / "sub/w.dat").unlink()
    with pytest.raises(ModelError, match="HTTP 500"):
        get(pinned(server), folder)


def test_a_record_that_makes_no_sense_is_not_gone_on_with(server, folder) -> None:
    served = offer(server, noise(), break_after=[1000, 0, 0, 0])
    with pytest.raises(ModelError):
        get(pinned(server), folder)
    record = folder / "sub" / ".w.dat.part.json"
    assert json.loads(record.read_text())["size"] == SIZE
    for text in ("", "[]", '{"url": 3}', '{"size": "many"}'):
        record.write_text(text)
        server.requests.clear()
        served.break_after = [1000, 0, 0, 0]
        with pytest.raises(ModelError):
            get(pinned(server), folder)
        assert server.ranges()[0] is None
    served.break_after = []
    assert get(pinned(server), folder).path.read_bytes() == served.content

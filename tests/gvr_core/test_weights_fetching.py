"""Fetching from a real server: files in place, who vouched for them, and one fetch at a time."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from fetching_helpers import (
    HASTY,
    SIZE,
    checkpoint_bytes,
    file_of,
    get,
    names,
    noise,
    offer,
    pinned,
)
from safetensors.torch import save
from weights_server import WeightsServer, weights_server

from gvr_core.errors import ModelError
from gvr_core.models.checkpoints import checkpoint, load_state
from gvr_core.weights.fetching import Fetched, Trust, fetch
from gvr_core.weights.folder import digest_path, located, part_path
from gvr_core.weights.offers import NotThereError


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[WeightsServer]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with weights_server() as running:
        yield running


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "models"


def test_a_whole_fetch_asks_once_and_leaves_nothing_beside_the_file(server, folder) -> None:
    served = offer(server, noise())
    seen: list[tuple[int, int | None]] = []
    got = get(pinned(server), folder, progress=lambda file, done, total: seen.append((done, total)))
    assert got.new and got.trust is Trust.MANIFEST and got.sha256 == served.sha256
    assert got.path.read_bytes() == served.content
    assert names(folder) == ["sub/w.dat"]
    assert server.ranges() == [None]
    assert seen[0] == (0, SIZE) and seen[-1] == (SIZE, SIZE)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)

    again = get(pinned(server), folder)
    assert not again.new and again.sha256 == served.sha256
    assert len(server.requests) == 1


def test_redirects_are_followed_and_the_server_may_state_the_digest(server, folder) -> None:
    served = offer(server, noise(), "far.dat", break_after=[1000])
    offer(server, b"", redirect=server.url("far.dat"), linked=served.sha256)
    got = get(file_of(server), folder)
    assert got.trust is Trust.SERVER and got.path.read_bytes() == served.content
    assert digest_path(got.path).read_text() == f"{served.sha256}  w.dat\n"
    assert server.ranges() == [None, None, "bytes=1000-", "bytes=1000-"]

    offer(server, b"", "bad.dat", redirect=server.url("far.dat"), linked="ab" * 32)
    with pytest.raises(ModelError, match="ab" * 32):
        get(file_of(server, "bad.dat"), folder)
    assert not (folder / "sub/bad.dat").exists()
    # The manifest's word is the last, and the server's tells it before the bytes do.
    server.requests.clear()
    with pytest.raises(ModelError, match=f"{'ab' * 32}.*{served.sha256}"):
        get(file_of(server, "bad.dat", sha256=served.sha256), folder)
    # A tag that is no sha256, as of small files there, says nothing.
    offer(server, noise(4), "git.dat", linked="45a2321a7ecfdaaf60a6c1fd7f5463994cc8907d")
    assert get(file_of(server, "git.dat"), folder).trust is Trust.FIRST_USE


def test_what_nobody_states_is_recorded_and_held_to(server, folder) -> None:
    served = offer(server, noise())
    file = file_of(server)
    got = get(file, folder)
    assert got.trust is Trust.FIRST_USE and got.sha256 == served.sha256
    assert names(folder) == ["sub/w.dat", "sub/w.dat.sha256"]
    assert shutil.which("sha256sum") is None or not subprocess.call(
        ["sha256sum", "--check", "--status", "w.dat.sha256"], cwd=got.path.parent
    )
    again = get(file, folder)
    assert again.trust is Trust.RECORD and not again.new
    got.path.unlink()
    served.content = noise(7)
    with pytest.raises(ModelError, match=r"refused.*w\.dat\.sha256 says; delete that"):
        get(file, folder)
    digest_path(got.path).unlink()
    assert get(file, folder).sha256 == served.sha256


def test_a_file_put_there_by_hand_is_recorded(server, folder) -> None:
    path = folder / "sub/w.dat"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"by hand")
    got = get(file_of(server), folder)
    assert not got.new and got.sha256 == hashlib.sha256(b"by hand").hexdigest()
    assert digest_path(path).exists() and server.requests == []


def test_what_stands_in_is_fetched_where_a_file_is_missing(server, folder) -> None:
    served = offer(server, noise(), "b.dat")
    file = file_of(server, "a.dat", otherwise=file_of(server, "b.dat").model_dump())
    got = get(file, folder)
    assert got.path.name == "b.dat" and got.path.read_bytes() == served.content
    server.requests.clear()
    assert not get(file, folder).new
    assert server.requests == []  # what is there is not looked for elsewhere
    got.path.unlink()
    del server.files["b.dat"]
    with pytest.raises(NotThereError, match=r"b\.dat"):
        get(file, folder)


@pytest.mark.parametrize("name", ["zip.pth", "legacy.pth", "plain.safetensors"])
def test_what_was_fetched_is_what_the_models_load(server, folder, name) -> None:
    state = {"a": torch.arange(6.0).reshape(2, 3)}
    content = (
        save(state)
        if name == "plain.safetensors"
        else checkpoint_bytes({"model": state}, zipped=name == "zip.pth")
    )
    offer(server, content, name)
    got = get(pinned(server, name), folder)
    loaded = load_state(checkpoint(got.path, got.sha256))
    assert torch.equal(loaded["a"], state["a"])


def test_two_at_once_fetch_once(server, folder) -> None:
    served = offer(server, noise(), stall_after=1000)
    got: list[Fetched] = []
    file = pinned(server)
    threads = [threading.Thread(target=lambda: got.append(get(file, folder))) for _ in range(2)]
    threads[0].start()
    part = part_path(folder / "sub/w.dat")
    while not (part.exists() and part.stat().st_size == 1000):
        time.sleep(0.01)
    threads[1].start()
    time.sleep(0.2)
    assert len(server.requests) == 1
    served.stall_after = None
    served.resume.set()  # the first one's connection ends short, and it goes on
    for thread in threads:
        thread.join(30)
    assert sorted(each.new for each in got) == [False, True]
    assert server.ranges() == [None, "bytes=1000-"]
    assert names(folder) == ["sub/w.dat"]


def test_fetch_brings_all_files_and_what_they_need(server, folder) -> None:
    offer(server, noise(1), "one.dat")
    offer(server, noise(2), "two.dat")
    folder.mkdir()
    (folder / "manifest.toml").write_text(
        "".join(
            f'[[checkpoints]]\nname = "{name}"\nrole = "segmenter"\nlicence = "MIT"\n'
            f'source = "https://example.org/"\nneeds = {needs}\n'
            f'[[checkpoints.files]]\npath = "{name}.dat"\nurl = "{server.url(name + ".dat")}"\n'
            for name, needs in (("one", '["two"]'), ("two", '["one"]'))
        )
    )
    got = fetch("one", folder, patience=HASTY)
    assert [each.path.name for each in got] == ["one.dat", "two.dat"]
    (there,) = located("one", folder)
    assert there.sha256 == got[0].sha256
    with pytest.raises(ModelError, match="no checkpoint is named 'three'"):
        fetch("three", folder)

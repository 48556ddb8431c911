"""Whatever is wrong with a file or its server: nothing takes the name, and the error says why."""

from __future__ import annotations

import io
import os
import pickle
import pickletools
import shutil
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import torch
from fetching_helpers import (
    SIZE,
    checkpoint_bytes,
    file_of,
    get,
    names,
    noise,
    offer,
    pinned,
)
from weights_server import WeightsServer, weights_server

from gvr_core.errors import ModelError
from gvr_core.weights.fetching import fetch_file
from gvr_core.weights.folder import part_path
from gvr_core.weights.manifest import WeightsFile
from gvr_core.weights.offers import Wanted, check_status


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[WeightsServer]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with weights_server() as running:
        yield running


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "models"


@pytest.mark.parametrize(
    ("fields", "message"),
    [({"sha256": "0" * 64}, "sha256"), ({"size": SIZE + 1}, "size 300000")],
)
def test_another_digest_or_size_is_refused_and_deleted(server, folder, fields, message) -> None:
    served = offer(server, noise())
    with pytest.raises(ModelError, match=message) as error:
        get(file_of(server, **fields), folder)
    if "sha256" in fields:
        assert served.sha256 in str(error.value) and "0" * 64 in str(error.value)
        assert str(folder / "sub/w.dat") in str(error.value)
    else:
        assert server.url("w.dat") in str(error.value) and "300001" in str(error.value)
    assert names(folder) == []


def test_a_wrong_file_in_place_is_replaced_only_by_the_right_one(server, folder) -> None:
    served = offer(server, noise())
    path = folder / "sub/w.dat"
    path.parent.mkdir(parents=True)
    path.write_bytes(noise(5))
    wrong = pinned(server).model_copy(update={"sha256": "1" * 64})
    with pytest.raises(ModelError, match="refused and deleted"):
        get(wrong, folder)
    assert path.read_bytes() == noise(5)
    assert get(pinned(server), folder).new
    assert path.read_bytes() == served.content


def test_a_server_that_lies_about_the_length_ends(server, folder) -> None:
    offer(server, noise(), length=SIZE + 500)
    with pytest.raises(ModelError):
        get(file_of(server), folder)
    assert not (folder / "sub/w.dat").exists()
    offer(server, checkpoint_bytes({"a": torch.zeros(9999)}), "short.pth", length=5000)
    with pytest.raises(ModelError, match=r"short\.pth.*no file of torch\.save"):
        get(file_of(server, "short.pth"), folder)
    assert not (folder / "sub/short.pth").exists()


def test_more_than_the_file_is_not_taken(server, folder) -> None:
    offer(server, noise(), chunked=True)
    with pytest.raises(ModelError, match="more than 1,000 bytes"):
        get(file_of(server, size=1000), folder)
    assert part_path(folder / "sub/w.dat").stat().st_size <= 1000


@pytest.mark.parametrize(
    ("status", "message"), [(404, "no such file"), (403, "does not give"), (401, "does not give")]
)
def test_refusals_name_the_url_and_a_way_out(server, folder, status, message) -> None:
    offer(server, noise(), statuses=[status] * 9)
    with pytest.raises(ModelError, match=f"HTTP {status} .*{message}") as error:
        get(pinned(server), folder)
    assert server.url("w.dat") in str(error.value) and str(folder / "sub/w.dat") in str(error.value)
    assert "\n" not in str(error.value)
    assert len(server.requests) == 1
    assert names(folder) == []


def test_a_server_that_is_not_there_is_named_at_once(folder) -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    file = WeightsFile(path="a.dat", url=f"http://127.0.0.1:{port}/a.dat")
    started = time.monotonic()
    with pytest.raises(ModelError, match=f"127.0.0.1:{port}.*cannot be fetched"):
        fetch_file(file, folder)
    assert time.monotonic() - started < 5
    with pytest.raises(ModelError, match=r"no-such-host\.invalid"):
        fetch_file(WeightsFile(path="a.dat", url="http://no-such-host.invalid/a.dat"), folder)
    assert names(folder) == []


def test_redirects_lead_neither_in_circles_nor_to_files(server, folder) -> None:
    offer(server, b"", redirect=server.url("w.dat"))
    with pytest.raises(ModelError, match="redirects"):
        get(file_of(server), folder)
    offer(server, b"", redirect="file:///etc/hostname")
    with pytest.raises(ModelError, match="redirects elsewhere"):
        get(file_of(server), folder)
    assert names(folder) == []


@pytest.mark.parametrize("hops", [["http"], ["https", "http"], ["http", "https"]])
def test_a_way_that_began_encrypted_stays_so(folder, hops) -> None:
    answers = [
        httpx.Response(200, request=httpx.Request("GET", f"{scheme}://example.org/x"))
        for scheme in hops
    ]
    answers[-1].history = answers[:-1]
    with pytest.raises(ModelError, match="from https to http"):
        check_status(answers[-1], Wanted("https://example.org/w.dat", folder / "w.dat"))
    check_status(answers[-1], Wanted("http://example.org/w.dat", folder / "w.dat"))


class Evil:
    """Makes a file where it is unpickled without care."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch {self.mark}",)


@pytest.mark.parametrize("how", ["zip", "legacy", "bare"])
def test_a_pickle_that_wants_to_run_code_takes_no_name(server, folder, tmp_path, how) -> None:
    mark = tmp_path / "ran"
    evil = {"w": torch.zeros(3), "more": Evil(mark)}
    content = pickle.dumps(evil) if how == "bare" else checkpoint_bytes(evil, how == "zip")
    if how == "bare":
        # It does bite: whoever unpickles it calls the shell.
        steps = [(code.name, argument) for code, argument, _ in pickletools.genops(content)]
        assert ("SHORT_BINUNICODE", "system") in steps and ("REDUCE", None) in steps
    offer(server, content, "evil.pth")
    with pytest.raises(ModelError, match=r"evil\.pth.*run code") as error:
        get(pinned(server, "evil.pth"), folder)
    assert "\n" not in str(error.value)
    assert names(folder) == []
    assert not mark.exists()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.pth", b"<html>please log in</html>"),
        ("a.bin", b"PK\x03\x04 and no more"),
        ("a.safetensors", b"\x10\x00\x00\x00\x00\x00\x00\x00{not json at all"),
        ("a.json", b"<html>please log in</html>"),
    ],
)
def test_a_page_in_place_of_weights_takes_no_name(server, folder, name, content) -> None:
    offer(server, content, name)
    with pytest.raises(ModelError, match=name):
        get(file_of(server, name), folder)
    assert names(folder) == []


@pytest.mark.filterwarnings("ignore")
def test_a_torchscript_archive_takes_no_name(server, folder) -> None:
    stream = io.BytesIO()
    torch.jit.save(torch.jit.script(torch.nn.Linear(2, 2)), stream)
    offer(server, stream.getvalue(), "a.pt")
    with pytest.raises(ModelError, match="TorchScript"):
        get(pinned(server, "a.pt"), folder)
    assert names(folder) == []


def test_what_does_not_fit_on_the_disk_is_not_begun(server, folder, monkeypatch) -> None:
    offer(server, noise())
    usage = shutil.disk_usage(folder.parent)._replace(free=SIZE - 1)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    with pytest.raises(ModelError, match="300,000 more bytes do not fit: 299,999 are free"):
        get(pinned(server), folder)
    assert names(folder) == []

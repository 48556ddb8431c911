"""``gvr models``: listed, fetched from a server on this machine, verified."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from weights_server import Served, WeightsServer, weights_server

from flows import models_commands
from gvr_core.errors import ModelError
from gvr_core.models.checkpoints import checkpoint, load_state
from gvr_core.weights.folder import located, part_path


class Evil:
    """Makes a file where it is unpickled without care."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch {self.mark}",)


def saved(content: object) -> bytes:
    stream = io.BytesIO()
    torch.save(content, stream)
    return stream.getvalue()


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[WeightsServer]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with weights_server() as running:
        yield running


@pytest.fixture
def models(tmp_path: Path, server: WeightsServer, monkeypatch: pytest.MonkeyPatch) -> Path:
    """GVR_MODELS, with a manifest of checkpoints on the server: good, free, evil, wrong, gone."""
    state = {"w": torch.arange(50_000.0)}
    server.files = {
        "good.pth": Served(saved({"model": state})),
        "free.pth": Served(saved(state)),
        "evil.pth": Served(saved({"w": torch.zeros(2), "more": Evil(tmp_path / "ran")})),
        "wrong.pth": Served(saved({"w": torch.ones(2)})),
    }
    folder = tmp_path / "models"
    folder.mkdir()
    digests = {name: served.sha256 for name, served in server.files.items()}
    digests |= {"wrong.pth": "ab" * 32, "gone.pth": "cd" * 32}
    text = ""
    for name in (*server.files, "gone.pth"):
        text += (
            f'[[checkpoints]]\nname = "{name[:4]}"\nrole = "segmenter"\nlicence = "MIT"\n'
            f'source = "https://example.org/"\n[[checkpoints.files]]\n'
            f'path = "mine/{name}"\nurl = "{server.url(name)}"\n'
        )
        if name != "free.pth":
            text += f'sha256 = "{digests[name]}"\n'
    (folder / "manifest.toml").write_text(text.replace('"wron"', '"wrong"'))
    monkeypatch.setenv("GVR_MODELS", str(folder))
    return folder


def states(gvr) -> dict[str, str]:
    code, out, err = gvr("models", "ls", "--json")
    assert code == 0, err
    return {entry["name"]: entry["state"] for entry in json.loads(out)["models"]}


def test_fetch_verify_damage_fetch(gvr, models, server) -> None:
    server.files["good.pth"].break_after = [50_000]
    assert set(states(gvr).values()) == {"missing"}
    code, out, err = gvr("models", "fetch", "good", "free")
    assert (code, err) == (0, "")
    assert server.ranges() == [None, "bytes=50000-", None]
    assert "nobody states; recorded beside it" in out and server.files["free.pth"].sha256 in out
    found = states(gvr)
    assert found.pop("good") == found.pop("free") == "present"
    assert set(found.values()) == {"missing"}
    (there,) = located("good")
    assert load_state(checkpoint(there.path, there.sha256))["w"].shape == (50_000,)

    code, out, _ = gvr("models", "verify")
    assert code == 0
    assert "ok  good  mine/good.pth: as the manifest says" in out
    assert "ok  free  mine/free.pth: as at the first fetch" in out
    assert "2 files read" in out and "0 wrong" in out

    for name in ("good.pth", "free.pth"):
        path = models / "mine" / name
        content = bytearray(path.read_bytes())
        content[-2000] ^= 1
        path.write_bytes(content)
    code, out, _ = gvr("models", "verify")
    assert code == 1
    assert out.count("WRONG") == 2 and "2 wrong" in out and "gvr models fetch good" in out
    assert server.files["good.pth"].sha256 in out
    code, out, err = gvr("models", "fetch", "good")
    assert (code, err) == (0, "") and "fetched" in out
    assert gvr("models", "verify", "good")[0] == 0
    code, out, _ = gvr("models", "fetch", "good")
    assert code == 0 and "was there" in out


def test_what_is_wrong_is_said_and_does_not_keep_the_rest_from_coming(
    gvr, models, server, tmp_path
) -> None:
    code, _, err = gvr("models", "fetch", "evil", "wrong", "gone", "good")
    assert code == 2
    evil, wrong, gone = err.strip().splitlines()
    assert "evil.pth: refused, as reading it might run code" in evil and "system" in evil
    assert server.files["wrong.pth"].sha256 in wrong and "ab" * 32 in wrong
    assert "HTTP 404" in gone and server.url("gone.pth") in gone
    assert not (tmp_path / "ran").exists()
    left = [path.name for path in (models / "mine").iterdir()]
    assert left == ["good.pth"]
    code, out, _ = gvr("models", "verify", "good", "gone")
    assert code == 1 and "WRONG  gone  mine/gone.pth: missing" in out


def test_ls_fits_a_terminal_and_says_how_far_a_fetch_came(gvr, models, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    half = part_path(models / "sam/sam_vit_b_01ec64.pth")
    half.parent.mkdir()
    with half.open("wb") as file:
        file.truncate(375042383 // 2)
    code, out, _ = gvr("models", "ls")
    assert code == 0
    table = out.splitlines()
    assert max(len(line.rstrip()) for line in table) <= 80
    (line,) = [line for line in table if "sam:vit_b" in line]
    assert line.split() == ["sam:vit_b", "segmenter", "Apache-2.0", "partial", "49%", "375", "MB"]
    (line,) = [line for line in table if "grounded_sam:swin_b" in line]
    assert "Apache-2.0" in line and "938 MB" in line and "missing" in line


def test_names_are_checked_before_anything_is_fetched(gvr, models, server) -> None:
    for command in ("fetch", "verify"):
        code, _, err = gvr("models", command, "good", "sam:vit_x")
        assert code == 2
        assert "no checkpoint is named 'sam:vit_x'" in err and "sam:vit_h" in err
    code, _, err = gvr("models", "fetch")
    assert code == 2 and "--all" in err
    assert server.requests == []


def test_all_is_what_the_manifests_list(gvr, models, server, monkeypatch) -> None:
    asked: list[str] = []

    def refuse(file, folder, progress):
        asked.append(file.path)
        raise ModelError("offline", path=file.url)

    monkeypatch.setattr(models_commands, "fetch_file", refuse)
    code, _, err = gvr("models", "fetch", "--all")
    assert code == 2 and err.count("offline") == len(asked) == len(set(asked))
    assert {"sam/sam_vit_h_4b8939.pth", "bert-base-uncased/vocab.txt", "mine/good.pth"} < set(asked)


def test_a_broken_manifest_of_one_s_own_is_named(gvr, models) -> None:
    (models / "manifest.toml").write_text("[[checkpoints]]\nname = 3\n")
    code, _, err = gvr("models", "ls")
    assert code == 2 and "manifest.toml, checkpoints.0.name" in err

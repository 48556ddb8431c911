"""The models folder: what is there, what is not, and what is not what it should be."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from gvr_core.errors import ModelError
from gvr_core.weights import folder as folder_module
from gvr_core.weights.folder import (
    Located,
    State,
    digest_path,
    located,
    models_folder,
    overall,
    part_path,
    stored,
)
from gvr_core.weights.manifest import find_entry
from gvr_core.weights.verifying import entries_of, verify

GOOD = b"some weights"
DIGEST = hashlib.sha256(GOOD).hexdigest()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A models folder whose manifest names ``mine``: a pinned file, and one that nobody pins."""
    (tmp_path / "manifest.toml").write_text(
        '[[checkpoints]]\nname = "mine"\nrole = "segmenter"\nlicence = "MIT"\n'
        'source = "https://example.org/"\n'
        f'[[checkpoints.files]]\npath = "a/pinned.dat"\nurl = "https://example.org/1"\n'
        f'size = {len(GOOD)}\nsha256 = "{DIGEST}"\n'
        '[[checkpoints.files]]\npath = "a/free.dat"\nurl = "https://example.org/2"\n'
    )
    (tmp_path / "a").mkdir()
    return tmp_path


def states(folder: Path) -> list[State]:
    return [item.state for item in stored(find_entry("mine", folder), folder)]


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({}, Path(".gvr/models")),
        ({"GVR_HOME": "/h"}, Path("/h/models")),
        ({"GVR_HOME": "/h", "GVR_MODELS": "/m"}, Path("/m")),
        ({"GVR_HOME": "", "GVR_MODELS": ""}, Path(".gvr/models")),
        ({"GVR_MODELS": "~/m"}, Path.home() / "m"),
    ],
)
def test_variables_say_where_the_folder_is(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], expected: Path
) -> None:
    for name in ("GVR_HOME", "GVR_MODELS"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert models_folder() == expected


def test_located_gives_the_files_in_the_manifest_s_order(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "a/pinned.dat").write_bytes(GOOD)
    (folder / "a/free.dat").write_bytes(b"anything")
    monkeypatch.setenv("GVR_MODELS", str(folder))
    assert located("mine") == (
        Located(folder / "a/pinned.dat", DIGEST),
        Located(folder / "a/free.dat", None),
    )


def test_located_names_what_is_missing_and_the_command(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"a/pinned\.dat is missing, a/free\.dat is missing") as e:
        located("mine", folder)
    assert "gvr models fetch mine" in str(e.value) and str(folder) in str(e.value)
    part_path(folder / "a/pinned.dat").write_bytes(GOOD[:3])
    (folder / "a/free.dat").write_bytes(b"anything")
    with pytest.raises(ModelError, match=r"mine: a/pinned\.dat is partial \(") as e:
        located("mine", folder)
    with pytest.raises(ModelError, match="gvr models fetch sam:vit_h"):
        located("sam:vit_h", folder)
    with pytest.raises(ModelError, match="no checkpoint is named 'sam:vit_x'"):
        located("sam:vit_x", folder)


def test_located_refuses_another_content(folder: Path) -> None:
    (folder / "a/free.dat").write_bytes(b"anything")
    wrong = bytes(len(GOOD))
    (folder / "a/pinned.dat").write_bytes(wrong)
    with pytest.raises(ModelError, match=f"{hashlib.sha256(wrong).hexdigest()}.*{DIGEST}") as e:
        located("mine", folder)
    assert str(folder / "a/pinned.dat") in str(e.value) and "fetch mine" in str(e.value)
    (folder / "a/pinned.dat").write_bytes(GOOD + b"!")
    with pytest.raises(ModelError, match=r"a/pinned\.dat is wrong size"):
        located("mine", folder)


def test_located_holds_a_file_to_its_record(folder: Path) -> None:
    (folder / "a/pinned.dat").write_bytes(GOOD)
    free = folder / "a/free.dat"
    free.write_bytes(b"anything")
    digest_path(free).write_text(f"{hashlib.sha256(b'anything').hexdigest()}  free.dat\n")
    assert located("mine", folder)[1].sha256 == hashlib.sha256(b"anything").hexdigest()
    free.write_bytes(b"anythinG")
    with pytest.raises(ModelError, match=r"a/free\.dat: is not what mine should be"):
        located("mine", folder)
    digest_path(free).write_text("no digest\n")
    with pytest.raises(ModelError, match=r"free\.dat\.sha256: holds no sha256"):
        located("mine", folder)


def test_a_large_file_is_read_once_a_process(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "a/pinned.dat").write_bytes(GOOD)
    (folder / "a/free.dat").write_bytes(b"anything")
    from gvr_core.models import checkpoints

    read: list[Path] = []
    real = checkpoints.file_digest
    monkeypatch.setattr(checkpoints, "file_digest", lambda path: (read.append(path), real(path))[1])
    located("mine", folder)
    located("mine", folder)
    assert folder_module.checkpoint(folder / "a/pinned.dat", DIGEST).sha256 == DIGEST
    assert len(read) == 1


def test_states_follow_the_files(folder: Path) -> None:
    assert states(folder) == [State.MISSING, State.MISSING]
    part_path(folder / "a/free.dat").write_bytes(b"12")
    found = stored(find_entry("mine", folder), folder)
    assert [item.bytes for item in found] == [0, 2] and overall(found) is State.PARTIAL
    (folder / "a/pinned.dat").write_bytes(b"short")
    (folder / "a/free.dat").write_bytes(b"1234")
    assert states(folder) == [State.WRONG_SIZE, State.PRESENT]
    assert overall(stored(find_entry("mine", folder), folder)) is State.WRONG_SIZE
    (folder / "a/pinned.dat").write_bytes(GOOD)
    assert overall(stored(find_entry("mine", folder), folder)) is State.PRESENT


def test_open_clip_takes_the_file_that_is_there(tmp_path: Path) -> None:
    name = "open_clip:ViT-B-32/openai"
    assert name not in entries_of(tmp_path)
    path = tmp_path / "open_clip/ViT-B-32/openai/open_clip_pytorch_model.bin"
    path.parent.mkdir(parents=True)
    (tmp_path / "open_clip/somebody/elses").mkdir(parents=True)
    path.write_bytes(b"weights")
    assert located(name, tmp_path) == (Located(path, None),)
    assert name in entries_of(tmp_path)
    assert not any("elses" in each for each in entries_of(tmp_path))


def test_verify_says_of_each_file_what_is_wrong(folder: Path) -> None:
    entry = find_entry("mine", folder)

    def verdicts() -> list[tuple[bool, str]]:
        return [(each.right, each.text) for each in verify(entry, folder)]

    assert verdicts() == [(False, "missing"), (False, "missing")]
    (folder / "a/pinned.dat").write_bytes(GOOD)
    (folder / "a/free.dat").write_bytes(b"anything")
    digest = hashlib.sha256(b"anything").hexdigest()
    assert verdicts() == [
        (True, "as the manifest says"),
        (True, f"sha256 {digest}, which nobody has stated"),
    ]
    digest_path(folder / "a/free.dat").write_text(digest)
    assert verdicts()[1] == (True, "as at the first fetch")
    (folder / "a/pinned.dat").write_bytes(bytes(len(GOOD)))
    digest_path(folder / "a/free.dat").write_text("0" * 64)
    first, second = verdicts()
    assert first[0] is False and DIGEST in first[1]
    assert second == (False, f"sha256 is {digest} instead of {'0' * 64}")

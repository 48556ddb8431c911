"""The manifest: the shipped one is sound, one's own is checked, open_clip's table is followed."""

from __future__ import annotations

import re
from pathlib import Path

import open_clip
import pytest

from gvr_core.errors import ModelError
from gvr_core.weights.manifest import Entry, WeightsFile, find_entry, known, shipped

SAM_B = "sam:vit_b"


def own(folder: Path, *entries: str) -> Path:
    path = folder / "manifest.toml"
    path.write_text("\n".join(entries))
    return path


def toml(name: str = "mine", path: str = "mine/w.pth", more: str = "", **fields: str) -> str:
    said = {"role": "segmenter", "licence": "MIT", "source": "https://example.org/"} | fields
    return (
        f'[[checkpoints]]\nname = "{name}"\n'
        + "".join(f'{key} = "{value}"\n' for key, value in said.items() if key != "url")
        + f'[[checkpoints.files]]\npath = "{path}"\n'
        + f'url = "{said.get("url", "https://example.org/w.pth")}"\n{more}\n'
    )


def test_the_shipped_manifest_names_what_suites_name() -> None:
    assert set(shipped()) == {
        "sam:vit_h",
        "sam:vit_l",
        SAM_B,
        "open_clip:ViT-B-16/laion2b_s34b_b88k",
        "grounded_sam:swin_b",
        "grounded_sam:swin_t",
        "bert-base-uncased",
    }
    for name in ("grounded_sam:swin_b", "grounded_sam:swin_t"):
        assert shipped()[name].needs == ("bert-base-uncased",)
    bert = [Path(file.path).name for file in shipped()["bert-base-uncased"].files]
    assert bert == ["config.json", "tokenizer.json", "tokenizer_config.json", "vocab.txt"]


@pytest.mark.parametrize("entry", shipped().values(), ids=lambda entry: entry.name)
def test_shipped_entries_are_pinned_and_licensed(entry: Entry) -> None:
    assert entry.licence in ("Apache-2.0", "MIT")
    assert entry.source.startswith("https://")
    assert all(need in shipped() for need in entry.needs)
    for file in entry.files:
        assert file.url.startswith("https://")
        assert file.url.rpartition("/")[2] == Path(file.path).name
        if "huggingface.co" in file.url:  # a revision, not a branch that moves
            assert re.search(r"/resolve/[0-9a-f]{40}/", file.url)
        if entry.role != "encoder":  # OpenCLIP's digest is stated by the server only
            assert file.sha256 is not None and re.fullmatch("[0-9a-f]{64}", file.sha256)
            assert file.size is not None


def test_the_shipped_open_clip_entry_is_the_file_the_library_names(tmp_path: Path) -> None:
    config = open_clip.get_pretrained_cfg("ViT-B-16", "laion2b_s34b_b88k")
    (file,) = shipped()["open_clip:ViT-B-16/laion2b_s34b_b88k"].files
    assert f"huggingface.co/{config['hf_hub']}resolve/" in file.url
    entry = find_entry("open_clip:ViT-B-16/laion2b-s34b-b88k", tmp_path)  # as the library reads it
    assert entry is shipped()["open_clip:ViT-B-16/laion2b_s34b_b88k"]


def test_every_model_of_open_clip_has_an_entry(tmp_path: Path) -> None:
    listed = open_clip.list_pretrained()
    paths: set[str] = set()
    for model, tag in listed:
        entry = find_entry(f"open_clip:{model}/{tag}", tmp_path)
        for file in entry.files[0].candidates():
            assert file.path.startswith(f"open_clip/{model}/{tag}/")
            paths.add(entry.files[0].path)
    assert len(listed) > 100 and len(paths) == len(listed)


def test_open_clip_files_are_tried_in_the_library_s_order(tmp_path: Path) -> None:
    entry = find_entry("open_clip:ViT-B-32/openai", tmp_path)
    files = list(entry.files[0].candidates())
    assert [Path(file.path).name for file in files] == [
        "open_clip_model.safetensors",
        "open_clip_pytorch_model.bin",
        "ViT-B-32.pt",
    ]
    digest = "40d365715913c9da98579312b702a82c18be219cc2a73407c4526f58eba950af"
    assert [file.sha256 for file in files] == [None, None, digest]
    (named,) = find_entry("open_clip:ViTamin-S/datacomp1b", tmp_path).files
    assert [file.url.rpartition("/resolve/main/")[2] for file in named.candidates()] == [
        "pytorch_model.safetensors",
        "pytorch_model.bin",
    ]


@pytest.mark.parametrize(
    ("config", "urls"),
    [
        (
            {"url": f"https://openaipublic.azureedge.net/clip/models/{'a' * 64}/X.pt"},
            [f"https://openaipublic.azureedge.net/clip/models/{'a' * 64}/X.pt"],
        ),
        ({"hf_hub": "who/what/"}, ["who/what/resolve/main/open_clip_model.safetensors", None]),
    ],
)
def test_tables_of_other_versions_of_open_clip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, config: dict[str, str], urls: list[str | None]
) -> None:
    monkeypatch.setattr(open_clip, "get_pretrained_cfg", lambda model, tag: config)
    files = list(find_entry("open_clip:X/y", tmp_path).files[0].candidates())
    assert len(files) == len(urls)
    assert all(file.url.endswith(url) for file, url in zip(files, urls, strict=True) if url)
    assert ("openaipublic" in files[0].url) == (files[0].sha256 == "a" * 64)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("sam:vit_x", "sam:vit_h.*grounded_sam:swin_t.*open_clip:MODEL/TAG.*manifest.toml"),
        ("open_clip:ViT-B-16/nothing", "no tag 'nothing' of ViT-B-16.*laion2b_s34b_b88k"),
        ("open_clip:ViT-B16/openai", "model 'ViT-B16'.*ViT-B-16"),
        ("open_clip:ViT-B-16", "open_clip:MODEL/TAG"),
    ],
)
def test_unknown_names_say_what_is_known(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        find_entry(name, tmp_path)


def test_own_entries_are_added(tmp_path: Path) -> None:
    own(tmp_path, toml(more='size = 5\nsha256 = "' + "AB" * 32 + '"'))
    entry = find_entry("mine", tmp_path)
    assert entry.files == (
        WeightsFile(path="mine/w.pth", url="https://example.org/w.pth", size=5, sha256="ab" * 32),
    )
    assert list(known(tmp_path)) == [*shipped(), "mine"]
    assert entry.size == 5 and shipped()["bert-base-uncased"].size == 570 + 466062 + 48 + 231508


@pytest.mark.parametrize(
    "path",
    [
        "../out.pth",
        "/etc/passwd",
        "a/../../b.pth",
        "a//b.pth",
        "a\\\\..\\\\b.pth",
        ".hidden/w.pth",
        "a/.w.pth",
        "",
        "manifest.toml",
        "a/w.pth.sha256",
        "./w.pth",
        "a/",
    ],
)
def test_paths_stay_inside_the_folder(tmp_path: Path, path: str) -> None:
    own(tmp_path, toml(path=path))
    with pytest.raises(ModelError, match=r"manifest\.toml, checkpoints\.0\.files\.0\.path"):
        known(tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[checkpoints", "not TOML"),
        (toml(url="file:///etc/passwd"), "files.0.url"),
        (toml(url="ftp://example.org/w.pth"), "files.0.url"),
        (toml(more='sha256 = "abc"'), "files.0.sha256"),
        (toml(more="size = 0"), "files.0.size"),
        (toml(more="sice = 1"), "files.0.sice"),
        (toml(licence=""), "checkpoints.0.licence"),
        (toml(name="with blank"), "checkpoints.0.name"),
        ('[[checkpoints]]\nname = "a"\n', "checkpoints.0.role"),
        (toml() + toml(), "mine stands there twice"),
        (toml() + toml("other", url="https://example.org/other.pth"), "mine and other put"),
        (toml("x", path="sam/sam_vit_b_01ec64.pth"), "sam:vit_b and x put different files"),
    ],
)
def test_an_unusable_manifest_names_the_place(tmp_path: Path, text: str, said: str) -> None:
    path = own(tmp_path, text)
    with pytest.raises(ModelError, match=said) as error:
        find_entry(SAM_B, tmp_path)
    assert str(path) in str(error.value)


def test_a_known_name_may_have_a_mirror_and_nothing_else(tmp_path: Path) -> None:
    (file,) = shipped()[SAM_B].files
    digest = f'sha256 = "{file.sha256}"'
    mirror = "http://mirror.example/sam.pth"
    own(tmp_path, toml(SAM_B, path=file.path, more=digest, url=mirror))
    (mirrored,) = find_entry(SAM_B, tmp_path).files
    assert mirrored.url == mirror and mirrored.sha256 == file.sha256
    for wrong in ("", 'sha256 = "' + "0" * 64 + '"'):
        own(tmp_path, toml(SAM_B, path=file.path, more=wrong, url=mirror))
        with pytest.raises(ModelError, match="sam:vit_b is a known checkpoint with other files"):
            known(tmp_path)
    own(tmp_path, toml("open_clip:ViT-B-16/laion2b_s34b_b88k"))
    with pytest.raises(ModelError, match="without a digest"):
        known(tmp_path)

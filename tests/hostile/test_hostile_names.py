"""Names and links out of files: none of them leads out of the folder that it is meant for."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
import pytest
from hostile_inputs import TEXTS
from hostile_trees import EXPORTS, native_scene, published_tree, some_cameras, some_gaussians
from hypothesis import given
from hypothesis import strategies as st

from datasets.camera_checks import image_name
from datasets.capture import CaptureImage
from datasets.frames import match_frame
from datasets.mask_folders import queries_for, view_names
from datasets.native import read_scene
from datasets.native_records import check_name
from datasets.own import own_scene
from datasets.registry import get_dataset
from flows.lines import file_name
from gvr_core.errors import CameraFormatError, DatasetError, GVRError, StoreError
from gvr_core.exports import write_indices
from reports.result_check import PICTURE_NAME
from tasks.prefect_results import StageResultStorage
from tasks.store import Store

HERE = Path("here")
NAMES = st.text(max_size=300) | TEXTS


@given(NAMES)
def test_names_of_scenes_and_lines_as_files(name: str) -> None:
    made = file_name(name)
    assert PICTURE_NAME.fullmatch(f"pictures/{made}/q.png")
    assert len(made) < 120 and made not in (".", "..")


def test_names_that_are_replaced_stay_apart() -> None:
    assert file_name("w/o RFL") == "w_o_RFL"
    names = ["küche", "käche", "кухня", "кухни", "x" * 200, "x" * 201]
    assert len({file_name(name) for name in names}) == len(names)


@given(NAMES)
def test_names_of_images_stay_below_their_folder(text: str) -> None:
    try:
        name = image_name(text, HERE, "place")
    except CameraFormatError as error:
        assert error.place == "place" and error.accepted
        return
    parts = PurePosixPath(name).parts
    assert parts and ".." not in parts and not name.startswith("/")
    assert os.path.normpath(HERE / name).startswith("here/")
    view = view_names([CaptureImage(name, some_cameras(1)["v00"], None)], HERE)[name]
    assert "/" not in view


@given(NAMES)
def test_names_of_scenes_views_and_objects_are_one_component(text: str) -> None:
    try:
        name = check_name(text, "object", HERE)
    except DatasetError:
        return
    assert name.isascii() and len(name) <= 64 and not set(name) & set('/\\.:*?"<>|\0')


@given(st.lists(NAMES, max_size=5, unique=True))
def test_prompts_become_ids_of_queries(texts: list[str]) -> None:
    prompts = [text[:400] for text in texts if text.strip() and text.isprintable()]
    for query in queries_for(list(dict.fromkeys(prompts))):
        assert PICTURE_NAME.fullmatch(f"pictures/{query.id}.png")


def test_numbers_of_thousands_of_digits_in_names() -> None:
    images = [CaptureImage(f"{'1' * 900}/{i}.png", some_cameras(1)["v00"], None) for i in range(2)]
    assert match_frame(images, f"{'1' * 900}/00000") is images[0]
    with pytest.raises(CameraFormatError, match="up to 1024"):
        image_name("9" * 5000, HERE, "place")


@pytest.mark.parametrize("layout", EXPORTS)
def test_exports_of_hostile_objects_stay_in_their_root(tmp_path: Path, layout: str) -> None:
    data = read_scene(native_scene(tmp_path / "native"))
    first, second = data.truth.objects
    outside = set(tmp_path.rglob("*"))
    for number, name in enumerate(["../../x", "/tmp/x", "a\0b", "con", "\u202e", "", "x" * 300]):
        renamed = {first: name, second: second}
        masks = {(v, renamed[o]): mask for (v, o), mask in data.truth.masks.items()}
        truth = replace(data.truth, objects=(name, second), masks=masks)
        queries = tuple(
            q.model_copy(update={"target": name, "text": f"{name}/.."}) if q.target == first else q
            for q in data.queries
        )
        root = tmp_path / f"root{number}" / "inner"
        with pytest.raises(GVRError, match="can be the name"):
            EXPORTS[layout](replace(data, truth=truth, queries=queries), root, None)  # type: ignore[arg-type]
        left = [p for p in set(tmp_path.rglob("*")) - outside if p.is_file()]
        assert left == []


# Links. Who made a data set's folder may have links in it, and they are followed, as a disk is
# full and pictures lie elsewhere. Nothing that a file says can lead outside, and what the project
# writes itself, its store and its results, holds no links.


@pytest.mark.parametrize("layout", EXPORTS)
def test_folders_of_a_data_set_may_be_links(tmp_path: Path, layout: str) -> None:
    root = published_tree(layout, tmp_path / "made")
    dataset = get_dataset(layout, {"root": str(root)})
    (scene,) = dataset.scenes()
    before = dataset.load(scene)
    for name in ("images", "sparse"):
        place = root / scene / name
        place.rename(tmp_path / name)
        place.symlink_to(tmp_path / name)
    picture = next((tmp_path / "images").iterdir())
    picture.rename(tmp_path / "one picture")
    picture.symlink_to(tmp_path / "one picture")
    after = get_dataset(layout, {"root": str(root)}).load(scene)
    assert after.digests == before.digests


@pytest.mark.parametrize("layout", EXPORTS)
def test_links_in_circles_are_no_pictures(tmp_path: Path, layout: str) -> None:
    root = published_tree(layout, tmp_path / "made")
    (scene,) = get_dataset(layout, {"root": str(root)}).scenes()
    (root / scene / "images" / "up").symlink_to(root)
    (root / scene / "images" / "self.png").symlink_to("self.png")
    (root / "loop").symlink_to("loop")
    found = get_dataset(layout, {"root": str(root)})
    assert list(found.scenes()) == [scene]
    found.load(scene)


def test_a_link_in_place_of_a_camera_file_leads_no_name_astray(tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("root:x:0:0\n" * 3)
    scene = native_scene(tmp_path / "scene")
    for name in ("scene.json", "queries.json", "sparse/0/images.txt"):
        path = scene / name
        content = path.read_bytes()
        path.unlink()
        path.symlink_to(secret)
        with pytest.raises(GVRError):
            read_scene(scene)
        path.unlink()
        path.write_bytes(content)


@pytest.mark.parametrize("special", ["pipe", "/dev/zero", "/dev/full"])
def test_what_is_no_regular_file_blocks_nobody(tmp_path: Path, special: str) -> None:
    scene = native_scene(tmp_path / "scene")
    files = sorted(path for path in scene.rglob("*") if path.is_file())
    needed = 0
    for path in files:
        content = path.read_bytes()
        path.unlink()
        if special == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to(special)
        try:
            read_scene(scene)
        except GVRError:
            needed += 1
        path.unlink()
        path.write_bytes(content)
    assert needed >= len(files) - 1  # points3D.txt may be missing


def test_files_of_holes_do_not_fill_the_memory(tmp_path: Path) -> None:
    scene = native_scene(tmp_path / "scene")
    for name in ("scene.json", "queries.json", "labels.npy"):
        path = scene / name
        content = path.read_bytes()
        os.truncate(path, 2**40)
        with pytest.raises(DatasetError):
            read_scene(scene)
        path.write_bytes(content)


def test_records_of_the_store_are_no_links(tmp_path: Path) -> None:
    store, key = Store(tmp_path / "store"), "a" * 64
    path = store.record_path("render", key)
    path.parent.mkdir(parents=True)
    elsewhere = tmp_path / "elsewhere.json"
    elsewhere.write_text("{}")
    path.symlink_to(elsewhere)
    assert store.lookup("render", key) is None
    assert store.counts.unreadable == 1
    path.unlink()
    path.parent.rmdir()
    path.parent.symlink_to(tmp_path)
    with pytest.raises(StoreError, match="symbolic link"):
        store.lookup("render", key)


def test_results_of_prefect_are_no_links(tmp_path: Path) -> None:
    storage, key = StageResultStorage(root=str(tmp_path)), f"render-{'a' * 64}"
    (tmp_path / "prefect-results").mkdir()
    (tmp_path / "prefect-results" / "render").symlink_to("/etc")
    with pytest.raises(ValueError, match="symbolic link"):
        storage.read_path(key)


def test_an_answer_replaces_a_link_and_does_not_follow_it(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("kept")
    (tmp_path / "q0.indices.npy").symlink_to(precious)
    write_indices(tmp_path / "q0.indices.npy", np.array([True, False]))
    assert precious.read_text() == "kept"
    assert not (tmp_path / "q0.indices.npy").is_symlink()


def test_questions_of_ones_own_are_no_names(tmp_path: Path) -> None:
    from datasets.inria_cameras import write_inria_cameras
    from gvr_core.splat_io import write_ply

    write_ply(tmp_path / "a.ply", some_gaussians())
    write_inria_cameras(tmp_path / "cameras.json", list(some_cameras().items()))
    data = own_scene(tmp_path / "a.ply", tmp_path / "cameras.json", ["../../x", "a\0b", "/etc"])
    assert [query.id for query in data.queries] == ["q0", "q1", "q2"]

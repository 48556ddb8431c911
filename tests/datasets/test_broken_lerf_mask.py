"""Trees of LERF-Mask in which something is missing, does not fit, or had to be put right."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mask_trees import (
    SCENE,
    all_masks,
    drop_image,
    edit_mask,
    exported,
    save_as_palette,
    save_in_colour,
    save_with_16_bits,
    save_with_alpha,
)

from datasets.base import SceneData
from datasets.export_lerf_mask import export_lerf_mask
from datasets.images import read_mask
from datasets.lerf_mask import LerfMaskDataset
from gvr_core.errors import DatasetError, InputError


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(export_lerf_mask, tmp_path_factory.mktemp("lerf_mask"))[1]


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "root")) / SCENE


def load(folder: Path) -> SceneData:
    return LerfMaskDataset(folder.parent).load(SCENE)


RED = "test_mask/0/a red box.png"
Change = Callable[[Path], object]


def smaller_mask(folder: Path) -> None:
    edit_mask(folder / RED, lambda grey: grey[1:])


def masks_of_another_shape(folder: Path) -> None:
    for path in (folder / "test_mask/0").iterdir():
        edit_mask(path, lambda grey: grey[:, :-12])


def rename_test_image(folder: Path, old: str, new: str) -> None:
    path = folder / "sparse/0/images.txt"
    path.write_text(path.read_text().replace(f" {old}.jpg", f" {new}.jpg"))
    (folder / f"images/{old}.jpg").rename(folder / f"images/{new}.jpg")


def distorted(folder: Path) -> None:
    path = folder / "sparse/0/cameras.txt"
    path.write_text("1 SIMPLE_RADIAL 96 72 83 48 36 0.1\n")


@pytest.mark.parametrize(
    "change, words",
    [
        # masks
        (lambda f: shutil.rmtree(f / "test_mask"), "no scene here"),
        (lambda f: [shutil.rmtree(p) for p in (f / "test_mask").iterdir()], "no view has masks"),
        (lambda f: [p.unlink() for p in (f / "test_mask").glob("*/*")], "test_mask: no mask"),
        (smaller_mask, "a red box.png: the mask has 96 x 71 pixels (accepted: 96 x 72"),
        (masks_of_another_shape, "test_mask/0: the masks have 84 x 72 pixels (accepted: 96 x 72"),
        (lambda f: (f / RED).write_bytes(b"no picture"), "a red box.png: the picture cannot"),
        (lambda f: (f / RED).write_bytes((f / RED).read_bytes()[:-60]), "a red box.png: the pict"),
        (lambda f: save_with_16_bits(f / RED), "a red box.png: the pixels have the mode I;16"),
        # prompts
        (lambda f: shutil.copy(f / RED, f / "test_mask/0/a red box.v2.png"), "there twice"),
        (lambda f: shutil.copy(f / RED, f / "test_mask/0/A Red Box.png"), "differ only in case"),
        (lambda f: shutil.copy(f / RED, f / "test_mask/0/a red box .png"), "there twice"),
        (lambda f: (f / RED).rename(f / "test_mask/0/A RED BOX.png"), "differ only in case"),
        (lambda f: (f / RED).rename(f / "test_mask/0/ .png"), "the text ' ' cannot be a prompt"),
        (lambda f: (f / RED).rename(f / "test_mask/0/a\tred.png"), "cannot be a prompt"),
        # which view
        (
            lambda f: (f / "test_mask/1").rename(f / "test_mask/2"),
            "there is no test image 2 (accepted: 0 to 1, which count test_0.jpg, test_1.jpg)",
        ),
        (
            lambda f: shutil.copytree(f / "test_mask/1", f / "test_mask/test_1"),
            "holds masks of the view 'test_1', as 1/ does",
        ),
        (
            lambda f: (f / "test_mask/1").rename(f / "test_mask/v02"),
            "'v02.jpg' is a training image",
        ),
        (
            lambda f: (f / "test_mask/1").rename(f / "test_mask/later"),
            "the frame 'later' is not among the 5 registered images",
        ),
        (
            lambda f: (drop_image(f, "test_1.jpg"), (f / "test_mask/1").rename(f / "test_mask/b")),
            "'b' is not among the 4 registered images",
        ),
        (lambda f: drop_image(f, "test_1.jpg"), "there is no test image 1"),
        (
            lambda f: drop_image(f, "test_0.jpg"),
            "test_mask/0: the folder means 'test_1.jpg' by its index, and 'test_0.jpg' by its name",
        ),
        (
            lambda f: rename_test_image(f, "test_1", "test_03"),
            "there is no test image 3",
        ),
        # split and cameras
        (
            lambda f: [p.unlink() for p in (f / "images_train").iterdir()],
            "0 training images and 5 test images",
        ),
        (
            lambda f: shutil.copytree(f / "images", f / "images_train", dirs_exist_ok=True),
            "5 training images and 0 test images",
        ),
        (lambda f: shutil.rmtree(f / "sparse"), "camera"),
        (distorted, "SIMPLE_RADIAL"),
        (lambda f: shutil.rmtree(f / "point_cloud"), "splat"),
    ],
)
def test_what_cannot_be_used_is_refused(folder: Path, change: Change, words: str) -> None:
    if words == "there is no test image 3":
        (folder / "test_mask/1").rename(folder / "test_mask/3")
    change(folder)
    with pytest.raises(InputError) as caught:
        load(folder)
    assert words in str(caught.value)
    assert str(folder.parent) in str(caught.value)


def test_a_folder_and_a_name_that_disagree_are_refused(folder: Path) -> None:
    for old, new in (("test_1", "test_2"), ("test_0", "test_1")):
        rename_test_image(folder, old, new)
    with pytest.raises(DatasetError, match=r"'test_2.jpg' by its index, and 'test_1.jpg' by its n"):
        load(folder)


def test_a_picture_without_a_camera_is_named(folder: Path) -> None:
    drop_image(folder, "test_1.jpg")
    (folder / "test_mask/1").rename(folder / "test_mask/test_1")
    with pytest.raises(DatasetError, match=r"the picture 'test_1.jpg', which has no camera"):
        load(folder)


def semitransparent(folder: Path) -> None:
    """A white picture, which is opaque where the object is."""
    mask = read_mask(folder / RED)
    save_with_alpha(folder / RED, np.full(mask.shape, 255, np.uint8), mask * np.uint8(255))


def junk(folder: Path) -> None:
    (folder / "test_mask/.DS_Store").write_bytes(b"x")
    (folder / "test_mask/0/Thumbs.db").write_bytes(b"x")
    (folder / "test_mask/0/._a red box.png").write_bytes(b"x")
    (folder / ".git").mkdir()


@pytest.mark.parametrize(
    "change, notes",
    [
        (junk, ()),
        (lambda f: save_as_palette(f / RED), ()),
        (lambda f: save_in_colour(f / RED), ()),
        (lambda f: (f / RED).rename((f / RED).with_suffix(".PNG")), ()),
        (
            semitransparent,
            (
                "masks with an alpha channel, transparent taken for background: 1"
                " (0/a red box.png)",
                "masks that the published evaluator would read otherwise: 1 (0/a red box.png)",
            ),
        ),
        (
            lambda f: (f / "test_mask/0/notes.txt").write_text("x"),
            ("files that are no PNG among the masks, left out: 1 (0/notes.txt)",),
        ),
        (
            lambda f: shutil.copytree(f / "test_mask/0", f / "test_mask/0/older"),
            ("folders among the masks, left out: 1 (0/older)",),
        ),
        (
            lambda f: (f / "test_mask/extra").mkdir(),
            ("folders in test_mask/ without masks, left out: 1 (extra)",),
        ),
        (
            lambda f: (f / "test_mask/readme.txt").write_text("x"),
            ("files in test_mask/ outside its folders, left out: 1 (readme.txt)",),
        ),
        (
            lambda f: [(f / name).mkdir() for name in ("extra", "old masks")],
            ("folders that the layout does not have, left out: 2 (extra, old masks)",),
        ),
        (
            lambda f: shutil.copy(f / "images/v00.jpg", f / "images_train/v77.jpg"),
            ("pictures in images_train/ without a camera, left out: 1 (v77)",),
        ),
    ],
)
def test_what_is_put_right_is_counted(folder: Path, change: Change, notes: tuple[str]) -> None:
    expected = all_masks(load(folder))
    change(folder)
    data = load(folder)
    assert data.notes == notes
    found = all_masks(data)
    assert set(found) == set(expected)
    for key, mask in found.items():
        np.testing.assert_array_equal(mask, expected[key])


def test_a_mask_of_ones_is_empty_and_noted(folder: Path) -> None:
    edit_mask(folder / RED, lambda grey: grey // 255)
    data = load(folder)
    assert not data.truth.mask(data.truth.test_views[0], "a red box").any()
    assert data.notes == (
        "masks that are not black, yet empty: nothing is above 128: 1 (0/a red box.png)",
    )

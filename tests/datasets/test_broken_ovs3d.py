"""Trees of 3D-OVS in which something is missing, does not fit, or had to be put right."""

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
    save_with_16_bits,
    save_with_alpha,
)

from datasets.base import SceneData
from datasets.export_ovs3d import export_ovs3d
from datasets.images import read_mask
from datasets.ovs3d import Ovs3dDataset
from gvr_core.errors import InputError


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(export_ovs3d, tmp_path_factory.mktemp("ovs3d"))[1]


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "root")) / SCENE


def load(folder: Path) -> SceneData:
    return Ovs3dDataset(folder.parent).load(SCENE)


MASKS = "segmentations"
RED = "segmentations/01/a red box.png"
CLASSES = "segmentations/classes.txt"
Change = Callable[[Path], object]


def move(old: str, new: str) -> Change:
    return lambda folder: (folder / MASKS / old).rename(folder / MASKS / new)


def classes(content: bytes) -> Change:
    return lambda folder: (folder / CLASSES).write_bytes(content)


def masks_of_another_shape(folder: Path) -> None:
    for path in (folder / MASKS / "01").iterdir():
        edit_mask(path, lambda grey: grey[:-9])


def number_images(folder: Path, first: int) -> None:
    """Call the pictures by consecutive numbers."""
    path = folder / "sparse/0/images.txt"
    text = path.read_text()
    for i in range(5):
        text = text.replace(f" v0{i}.jpg", f" {i + first:02d}.jpg")
        (folder / f"images/v0{i}.jpg").rename(folder / f"images/{i + first:02d}.jpg")
    path.write_text(text)


@pytest.mark.parametrize(
    "change, words",
    [
        # masks
        (lambda f: shutil.rmtree(f / MASKS), "no scene here"),
        (lambda f: (f / RED).unlink(), "segmentations/01: no mask of a red box"),
        (lambda f: [p.unlink() for p in (f / MASKS / "01").iterdir()], "01: no mask of a blue box"),
        (lambda f: [shutil.rmtree(f / MASKS / n) for n in ("01", "04")], "no view has masks"),
        (lambda f: edit_mask(f / RED, lambda grey: grey[1:]), "the mask has 96 x 71 pixels"),
        (masks_of_another_shape, "segmentations/01: the masks have 96 x 63 pixels"),
        (lambda f: (f / RED).write_bytes(b""), "a red box.png: the picture cannot be decoded"),
        (lambda f: save_with_16_bits(f / RED), "a red box.png: the pixels have the mode I;16"),
        (lambda f: shutil.copy(f / RED, f / MASKS / "01/a red box .png"), "has another mask"),
        # classes
        (lambda f: (f / CLASSES).unlink(), "classes.txt: cannot be read"),
        (classes(b""), "classes.txt: no class"),
        (classes(b"\n \n\r\n"), "classes.txt: no class"),
        (classes(b"a red box\na blue box\na red box\n"), "the class 'a red box' is there twice"),
        (classes(b"a red box\na blue box\n a red box\n"), "'a red box' is there twice"),
        (classes(b"a red box\na blue box\nA Red Box\n"), "differ only in case"),
        (classes(b"a red box\na blue box\na cow\n"), "segmentations/01: no mask of a cow"),
        (classes("a red box\n".encode("utf-16")), "classes.txt: no text"),
        (classes(b"a red box\n../a blue box\n"), "line 2: no mask can be called '../a blue box'"),
        (classes(b"a red box\n\x07\n"), "line 2: the text '\\x07' cannot be a prompt"),
        # which view
        (move("04", "05"), "the frame '05' has the index 5 (accepted: 0 to 4"),
        (move("04", "v09"), "the frame 'v09' is not among the 5 registered images"),
        (move("04", "test"), "the frame 'test' is not among the 5 registered images"),
        (lambda f: drop_image(f, "v04.jpg"), "is the picture 'v04.jpg', which has no camera"),
        (lambda f: number_images(f, 1), "is the picture '01.jpg' by its name, but its index 1"),
        (lambda f: number_images(f, 3), "the frame '01' is not among the 5 registered images"),
        (
            lambda f: shutil.copytree(f / MASKS / "04", f / MASKS / "v04"),
            "holds masks of the view 'v04', as 04/ does",
        ),
        # cameras
        (lambda f: shutil.rmtree(f / "sparse"), "camera"),
        (lambda f: shutil.rmtree(f / "point_cloud"), "splat"),
    ],
)
def test_what_cannot_be_used_is_refused(folder: Path, change: Change, words: str) -> None:
    change(folder)
    with pytest.raises(InputError) as caught:
        load(folder)
    assert words in str(caught.value)
    assert str(folder.parent) in str(caught.value)


def with_alpha(folder: Path) -> None:
    """A white picture, which is opaque where the object is."""
    mask = read_mask(folder / RED)
    save_with_alpha(folder / RED, np.full(mask.shape, 255, np.uint8), mask * np.uint8(255))


def junk(folder: Path) -> None:
    (folder / MASKS / ".DS_Store").write_bytes(b"x")
    (folder / MASKS / "01/Thumbs.db").write_bytes(b"x")
    (folder / MASKS / "__MACOSX").mkdir()


@pytest.mark.parametrize(
    "change, notes",
    [
        (junk, ()),
        (lambda f: save_as_palette(f / RED), ()),
        (classes(b"a red box\na blue box"), ()),
        (
            classes(b"\xef\xbb\xbfa red box\r\n\r\na blue box\r\n"),
            (
                "byte order marks in classes.txt, dropped: 1 (line 1)",
                "Windows' line ends in classes.txt, dropped: 3 (line 1, line 2, line 3)",
                "blank lines in classes.txt, dropped: 1 (line 2)",
            ),
        ),
        (
            move("01/a red box.png", "01/a red box .png"),
            ("outer spaces in names of masks, dropped: 1 (01/a red box .png)",),
        ),
        (
            lambda f: shutil.copy(f / RED, f / MASKS / "01/a cow.png"),
            ("masks of no class of classes.txt, left out: 1 (01/a cow.png)",),
        ),
        (
            with_alpha,
            (
                "masks with an alpha channel, transparent taken for background: 1"
                " (01/a red box.png)",
                "masks that the published evaluator would read otherwise: 1 (01/a red box.png)",
            ),
        ),
        (
            lambda f: edit_mask(f / RED, lambda grey: np.minimum(grey, 254)),
            ("masks that the published evaluator would read otherwise: 1 (01/a red box.png)",),
        ),
        (
            lambda f: (f / MASKS / "extra").mkdir(),
            ("folders in segmentations/ without masks, left out: 1 (extra)",),
        ),
        (
            lambda f: (f / MASKS / "notes.txt").write_text("x"),
            ("files in segmentations/ outside its folders, left out: 1 (notes.txt)",),
        ),
        (
            lambda f: (f / "extra").mkdir(),
            ("folders that the layout does not have, left out: 1 (extra)",),
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

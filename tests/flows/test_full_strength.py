"""SAM, CLIP and Grounding DINO through their own libraries, from the suite file to the result.

Their weights are random and their networks small, so nothing is said about accuracy here: the
whole flow runs on what the real libraries give, and computes again what other weights change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tiny_grounding_dino import TinyGroundingDino, write_tiny_grounding_dino
from tiny_open_clip import TinyOpenClip, write_tiny_open_clip
from tiny_sam import save_tiny_sam

from gvr_core.books import PatchBook, SemanticVectorBook, ViewBook
from gvr_core.models.checkpoints import checkpoint
from gvr_core.models.crops import crop_patches
from reports.record import Result, SceneResult
from reports.result_io import read_result
from tasks.groundings import RING
from tasks.store import Store

SUITE = """
name = "full-strength"
limit = 2
[[datasets]]
name = "folder:{data}"
[[methods]]
method = "gvr-paper"
[[methods]]
method = "gvr-robust"
[models]
segmenter = "sam:{sam}"
encoder = "open_clip:tiny/mine"
text_segmenter = "grounded_sam:swin_t"
device = "cpu"
[models.sam]
points_per_side = 3
crop_layers = 0
pred_iou = 0.5
stability = 0.2
nms_iou = 1
min_area = 0
[models.open_clip]
checkpoint = "{clip}"
config = "{clip_config}"
[models.grounding_dino]
checkpoint = "{dino}"
config = "{dino_config}"
bert = "{bert}"
box_threshold = 0.0
text_threshold = 0.0
shorter_side = 96
longest_side = 160
"""


@dataclass(frozen=True)
class Files:
    """What the suite names."""

    data: Path
    sam: Path
    clip: TinyOpenClip
    dino: TinyGroundingDino

    def suite(self, path: Path) -> str:
        path.write_text(
            SUITE.format(
                data=self.data,
                sam=self.sam,
                clip=self.clip.safetensors,
                clip_config=self.clip.config,
                dino=self.dino.checkpoint,
                dino_config=self.dino.config,
                bert=self.dino.bert,
            )
        )
        return str(path)


@pytest.fixture
def files(two_boxes_folder: Path, tmp_path: Path) -> Files:
    return Files(
        two_boxes_folder,
        save_tiny_sam(tmp_path / "tiny_sam.pth"),
        write_tiny_open_clip(tmp_path / "clip"),
        write_tiny_grounding_dino(tmp_path / "dino"),
    )


def test_the_flow_runs_on_the_real_libraries(gvr, home, tmp_path, files, prefect_server) -> None:
    suite = files.suite(tmp_path / "full.toml")
    result = _run(gvr, home, suite)
    paper = _scene(result, "gvr-paper")
    _names_hold_the_digests(paper, files)
    _the_books_hold_what_the_libraries_give(home, paper, files)
    for scene in result.scenes:
        assert scene.status == "completed", scene.error
        assert scene.n_patches > scene.n_views  # several patches a view
    _ring_views_were_segmented(home, paper)

    again = _run(gvr, home, suite)
    assert {t.state for scene in again.scenes for t in scene.stages} == {"cached"}

    save_tiny_sam(files.sam, seed=7)
    other = _scene(_run(gvr, home, suite), "gvr-paper")
    states = {timing.stage: timing.state for timing in other.stages}
    assert states["render"] == states["depth"] == "cached"
    assert states["masks"] == states["segment"] == "computed"
    assert other.models["segmenter"] != paper.models["segmenter"]


def test_a_checkpoint_that_is_not_there_ends_the_run_before_it_begins(
    gvr, home, tmp_path, files
) -> None:
    suite = files.suite(tmp_path / "full.toml")
    files.dino.checkpoint.unlink()
    code, _, error = gvr("run", suite, "--quiet", "--no-mlflow")
    assert code == 2 and "tiny.pth" in error and not (home / "results").exists()


def test_the_papers_models_are_asked_for_by_name(gvr, home, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("GVR_MODELS", str(tmp_path / "empty"))
    code, _, error = gvr("run", "bench", "--models", "paper", "--no-mlflow")
    assert code == 2 and "gvr models fetch sam:vit_h" in error


def _run(gvr: Callable[..., tuple[int, str, str]], home: Path, suite: str) -> Result:
    code, _, error = gvr("run", suite, "--quiet", "--no-mlflow")
    assert code == 0, error
    return read_result(max((home / "results").iterdir(), key=lambda path: path.stat().st_mtime_ns))[
        0
    ]


def _scene(result: Result, method: str) -> SceneResult:
    scene = next(scene for scene in result.scenes if scene.method == method)
    assert scene.status == "completed", scene.error
    return scene


def _names_hold_the_digests(scene: SceneResult, files: Files) -> None:
    sam, clip, dino = (
        checkpoint(path).tag for path in (files.sam, files.clip.safetensors, files.dino.checkpoint)
    )
    assert scene.models["segmenter"].startswith(f"sam/1:local@{sam}")
    assert f"@{clip}" in scene.models["encoder"]
    assert f"@{dino}" in scene.models["text_segmenter"]
    assert scene.models["segmenter"] in scene.models["text_segmenter"], "boxes prompt the same SAM"


def _artifact(home: Path, scene: SceneResult, stage: str, name: str) -> dict[str, np.ndarray]:
    store = Store(home / "store")
    key = next(timing.key for timing in scene.stages if timing.stage == stage)
    record = store.lookup(stage, key)
    assert record is not None
    return store.load_arrays(record.artifacts[name])


def _the_books_hold_what_the_libraries_give(home: Path, scene: SceneResult, files: Files) -> None:
    """One view's vectors against open_clip called directly on the crops of that view."""
    import torch

    views = ViewBook.from_arrays(_artifact(home, scene, "render", "views"))
    patches = PatchBook.from_arrays(_artifact(home, scene, "masks", "patches"))
    features = _artifact(home, scene, "encode", "features")["features"]
    book = SemanticVectorBook(features, patches)
    model, preprocess, _ = files.clip.library_model()
    masks = patches.masks_of(0)
    rgb = views.rgb(0).astype(np.float32) / 255
    crops = crop_patches(rgb, masks, "masked", 32, fill=(0, 0, 0))
    with torch.no_grad():
        direct = model.encode_image(torch.stack([preprocess(Image.fromarray(c)) for c in crops]))
    direct = direct / direct.norm(dim=1, keepdim=True)
    # half precision rounds numbers below 1 by 2^-12 at most
    np.testing.assert_allclose(book.vectors[: len(masks)], direct.numpy(), rtol=0, atol=2.5e-4)


def _ring_views_were_segmented(home: Path, scene: SceneResult) -> None:
    evidence = _artifact(home, scene, "segment", "groundings")
    ring = PatchBook.from_arrays(
        {k.removeprefix("evidence."): v for k, v in evidence.items() if k.startswith("evidence.")}
    )
    roles = evidence["evidence.role"]
    found = [i for i in np.flatnonzero(roles == RING) if ring.masks_of(int(i))]
    assert found, "no ring view has a mask of Grounding DINO's box"

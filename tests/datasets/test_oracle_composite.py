"""The geometry is right whatever the models: oracles on composites of real splats.

Needs the shared splats. `python tests/datasets/test_oracle_composite.py` prints the figures.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from numpy.typing import NDArray
from oracle_scenes import OracleScene

from datasets.registry import get_dataset
from gvr_core.gaussians import Gaussians
from gvr_core.methods import MethodConfig
from gvr_core.segment import VirtualView, frustum_filter

UNOCCLUDED = ("apart", "open")
"""Composite scenes in which every object can be seen whole from most views."""


def oracle_figures(scene: OracleScene) -> Iterator[tuple[str, dict[str, float]]]:
    """Query text and `flags_3d` metrics of gvr-paper with oracle models."""
    method, gaussians = scene.method(MethodConfig()), scene.data.scene.gaussians
    for query in scene.present:
        grounding = method.ground(scene.data.scene, scene.books, query)
        ring = [ring_shares(gaussians, view, scene.truth(query)) for view in grounding.ring]
        metrics = scene.scores(grounding, query)
        metrics["least_in_ring_picture"] = min((inside for inside, _ in ring), default=0.0)
        metrics["least_kept_of_that"] = min((kept for _, kept in ring), default=0.0)
        yield query.text, metrics


def ring_shares(
    gaussians: Gaussians, view: VirtualView, flags: NDArray[np.bool_]
) -> tuple[float, float]:
    """Share of an object inside a ring picture, and share of that which its mask keeps."""
    camera = view.frame.camera
    everything = np.ones((camera.height, camera.width), np.bool_)
    inside = frustum_filter(gaussians, camera, everything) & flags
    mask = everything & False if view.mask is None else view.mask.pixels
    kept = frustum_filter(gaussians, camera, mask) & flags
    return float(inside.sum() / flags.sum()), float(kept.sum() / max(1, inside.sum()))


@pytest.mark.slow
@pytest.mark.parametrize("scene", UNOCCLUDED)
def test_oracles_find_real_splats(scene: str, shared: Path, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("GVR_SPLATS", str(shared / "data" / "splats"))
    monkeypatch.setenv("GVR_DATA", str(tmp_path))
    figures = list(oracle_figures(OracleScene(get_dataset("composite", {}).load(scene))))
    for text, values in figures:
        print(f"{text:40s} {values}")
    assert len(figures) >= 3
    assert np.mean([values["iou"] for _, values in figures]) >= 0.75
    assert np.mean([values["within_radius"] for _, values in figures]) >= 0.95


if __name__ == "__main__":
    for name in UNOCCLUDED:
        for text, values in oracle_figures(OracleScene(get_dataset("composite", {}).load(name))):
            shown = ", ".join(f"{key} {value:.3f}" for key, value in values.items())
            print(f"{name:8s} {text:40s} {shown}", flush=True)

"""Calibrate how `gvr-robust` reads an encoder, on scenes that no suite reports.

    python benchmarks/calibrate.py [SEED ...]

Gallery scenes of seeds 1000 to 1005 (the suites report 0 to 3), the onboard models, every query for
something that is there, and queries for things that are not: the generator's own absent ones and
the wordings of all photographs that the scene does not show. Printed, with and without canonical
phrases: how often L_3D lies in the object, how well the confidence tells absent from present
(AUROC), and the confidence that 95 % of the present queries reach. The figures in
`gvr_core/robust/calibration.py` are those.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from sklearn.metrics import roc_auc_score

from datasets.base import SceneData
from datasets.gallery import ABSENT, GalleryDataset
from datasets.photographs import PHOTOGRAPHS
from gvr_core.books import Books
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.metrics import flags_3d
from gvr_core.models.registry import build_models
from gvr_core.rendering import get_renderer
from gvr_core.robust.config import RobustConfig
from gvr_core.scene import Query

SEEDS = (1000, 1001, 1002, 1003, 1004, 1005)
REACHED_BY = 0.95
"""The threshold is the confidence that this part of the present queries reaches."""


def questions(data: SceneData) -> list[Query]:
    """The scene's own queries for what is there, and many for what is not."""
    there = {photo.name for photo in PHOTOGRAPHS if photo.name in data.truth.objects}
    others = [text for photo in PHOTOGRAPHS if photo.name not in there for text in photo.wordings]
    present = [query for query in data.queries if query.target]
    absent = [
        Query(id=f"not-here-{i}", text=text, absent=True)
        for i, text in enumerate([*ABSENT, *others])
    ]
    return [*present, *absent]


def answers(
    phrases: bool, scenes: list[tuple[SceneData, Books]], tools: Toolbox
) -> Iterator[tuple[bool, float, float]]:
    """Of each question: is it there, how sure is the method, does its place lie in the object."""
    # Calibrating is asking what the threshold should be, so none is in force.
    switches = RobustConfig(phrases=phrases, refuse_below=0.0, min_views=1)
    method = build_method(MethodConfig(method="gvr-robust", robust=switches), tools)
    for data, books in scenes:
        for query in questions(data):
            found = method.locate(data.scene, books, query)
            sureness = 0.0 if found is None else found.confidence
            if query.target is None:
                yield False, sureness, 0.0
                continue
            truth = data.truth.flags(query.target)
            place = None if found is None else found.location
            if truth is not None:
                scores = flags_3d(truth, truth, data.scene.gaussians.means, place)
                yield True, sureness, scores["within_radius"]


def main(seeds: list[int]) -> None:
    """Print the table."""
    tools = Toolbox(get_renderer("numba"), build_models())
    robust = build_method(MethodConfig(method="gvr-robust"), tools)
    with tempfile.TemporaryDirectory() as folder:
        dataset = GalleryDataset(Path(folder), seeds)
        loaded = [dataset.load(name) for name in dataset.scenes()]
        scenes = [(data, robust.prepare(data.scene)) for data in loaded]
        print(f"encoder {tools.models.encoder.name}")
        print(f"{'canonical phrases':20s}{'present':>9s}{'absent':>8s}{'located':>9s}", end="")
        print(f"{'AUROC':>8s}{'95 % reach':>12s}{'absent refused there':>22s}")
        for phrases in (True, False):
            rows = np.array(list(answers(phrases, scenes, tools)))
            there, sure = rows[:, 0] > 0, rows[:, 1]
            threshold = float(np.quantile(sure[there], 1 - REACHED_BY))
            print(
                f"{'with' if phrases else 'without':20s}{there.sum():9d}{(~there).sum():8d}"
                f"{rows[there, 2].mean():9.3f}{roc_auc_score(there, sure):8.3f}"
                f"{threshold:12.3f}{(sure[~there] < threshold).mean():22.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]] or list(SEEDS))

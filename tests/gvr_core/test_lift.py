"""The lifting baseline against a dense oracle written straight from its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracle_boxes import ABSENT, BLUE, RED, World, boxes, moved
from render_scenes import one_torch_thread
from small_scene import flat_gaussians, two_boxes

from gvr_core.books import Books
from gvr_core.gaussians import Gaussians
from gvr_core.methods.base import prepare_books
from gvr_core.methods.lift import Lift, LiftConfig
from gvr_core.metrics import iou
from gvr_core.models.oracle import oracle_models
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.rendering import get_renderer
from gvr_core.rendering.torch_reference import TorchReference
from gvr_core.robust.ballot import UNSEEN
from gvr_core.robust.config import NEGATIVES
from gvr_core.scene import Query
from gvr_core.toolbox import Toolbox


@pytest.fixture(scope="module")
def world() -> World:
    """Few views, small pictures, and two Gaussians that no view sees."""
    scene, labels = two_boxes(4, 48, 36)
    hidden = flat_gaussians(np.array([(0, 0, 50.0), (0, 0, -50.0)]), (1, 1, 1), 0.05)
    thinned = np.arange(len(scene.gaussians)) % 3 == 0
    gaussians = Gaussians.concatenate([scene.gaussians.subset(thinned), hidden])
    named = np.append(labels[thinned], [-1, -1]).astype(np.int16)
    return World(replace(scene, gaussians=gaussians), named)


def blind(world: World, **settings: float | bool) -> Lift:
    """The oracle's patches with vectors that are dense and mixed, so that every term counts."""
    models = replace(oracle_models(world.oracle), encoder=RandomEncoder(3, 8))
    return Lift(Toolbox(get_renderer("numba"), models), LiftConfig.model_validate(settings))


@pytest.fixture(scope="module")
def books(world: World) -> Books:
    return blind(world).prepare(world.scene)


@pytest.fixture(scope="module")
def dense(world: World, books: Books) -> np.ndarray:
    """F (N, c) = sum over patches of W_gj f_j, drawn by the slow renderer, in float64."""
    patches, features = books.semantics.patches, books.semantics.features.astype(np.float64)
    lifted = np.zeros((len(world.scene.gaussians), features.shape[1]))
    with one_torch_thread():
        for j in range(len(patches)):
            camera = world.scene.views[patches.view_of(j)].camera
            mask = patches.pixels(j).astype(np.float32)
            drawn = TorchReference().render(world.scene.gaussians, camera, mask=mask)
            assert drawn.weight_inside is not None
            weights = drawn.weight_inside.astype(np.float64)
            for g in np.flatnonzero(weights > UNSEEN):
                lifted[g] += weights[g] * features[j]
    return lifted


def test_lengths_are_those_of_the_dense_vectors(world, books, dense) -> None:
    lengths = books.index["lengths"]
    assert lengths.dtype == np.float32 and lengths.shape == (len(world.scene.gaussians),)
    expected = np.linalg.norm(dense, axis=1)
    assert (expected > 0).mean() > 0.3
    np.testing.assert_allclose(lengths, expected, rtol=2e-3, atol=5e-3)
    assert not lengths[-2:].any()


def logit(p: np.ndarray | float) -> np.ndarray:
    return np.log(p) - np.log1p(-np.asarray(p))


@pytest.mark.parametrize("phrases", [True, False])
@pytest.mark.parametrize("text", ["x", "the third"])
def test_flags_are_those_of_the_dense_cosines(world, books, dense, text, phrases) -> None:
    """Where a threshold cuts shows the scores themselves; so thresholds are swept."""
    lengths = np.linalg.norm(dense, axis=1)
    seen = books.index["lengths"] > 0
    texts = RandomEncoder(3, 8).encode_texts([text, *NEGATIVES]).astype(np.float64)
    cosines = (dense @ texts.T) / np.maximum(lengths, 1e-12)[:, None]
    likeness = np.exp(10 * cosines)
    typical = np.exp(10 * np.median(cosines[seen, 0]))
    others = likeness[:, 1:].T if phrases else [np.full(len(seen), typical)]
    scores = np.min([likeness[:, 0] / (likeness[:, 0] + other) for other in others], axis=0)
    clear = seen & (lengths > 0.05)
    best = np.percentile(scores[seen], 99)
    assert best > 0.95
    query = Query(id="q", text=text)
    cuts = np.percentile(scores[clear & (scores > 0.5)], (10, 50, 80))
    settings = [({"threshold": float(cut), "share": 0.0}, float(cut)) for cut in cuts]
    settings += [({"share": share}, 0.5 + share * (best - 0.5)) for share in (0.0, 0.5, 0.9)]
    for values, threshold in settings:
        found = blind(world, phrases=phrases, **values).ground(world.scene, books, query)
        # of a score right at the threshold the two renderers' rounding decides
        sure = clear & (np.abs(logit(scores) - logit(threshold)) > 0.05)
        assert sure.sum() > 0.8 * clear.sum()
        np.testing.assert_array_equal(found.flags[sure], scores[sure] > threshold)
        assert found.flags[sure].any() and not found.flags[sure].all()
        assert not found.flags[~seen].any()
        assert found.confidence == pytest.approx(best, rel=0.01)


def test_the_index_is_a_sparse_matrix_without_zeros(world, books) -> None:
    index, n = books.index, len(world.scene.gaussians)
    assert set(index) == {"weights", "patches", "row_ptr", "lengths"}
    assert index["row_ptr"][0] == 0 and index["row_ptr"][-1] == len(index["weights"])
    assert len(index["row_ptr"]) == n + 1 and (np.diff(index["row_ptr"]) >= 0).all()
    assert index["patches"].max() < len(books.semantics.features)
    assert index["weights"].min() > UNSEEN and index["weights"].dtype == np.float32


def test_true_names_give_the_surfaces_of_the_true_object() -> None:
    world = boxes()
    method = world.method("lift")
    books = method.prepare(world.scene)
    seen = books.index["lengths"] > 0
    for query in (RED, BLUE):
        found = method.ground(world.scene, books, query)
        truth = world.truth(query)
        assert found.found and found.confidence > 0.99
        assert iou(found.flags & seen, truth & seen) >= 0.85
        np.testing.assert_array_equal(found.scores, found.flags.astype(np.float32))
        np.testing.assert_array_equal(found.instances[0], found.flags)
        middle = world.scene.gaussians.means[truth].mean(axis=0)
        assert np.linalg.norm(found.location - middle) < 0.6
    absent = method.ground(world.scene, books, ABSENT)
    assert not absent.found and not absent.flags.any() and absent.location is None
    assert absent.confidence <= 0.5
    assert method.locate(world.scene, books, RED) is None


def test_the_unit_of_the_scene_does_not_matter(world, books) -> None:
    large = moved(world, scale=100.0)
    index = blind(large).index(large.scene, books)
    np.testing.assert_allclose(index["lengths"], books.index["lengths"], rtol=0.02, atol=0.02)


def test_a_scene_without_patches_finds_nothing(world, books) -> None:
    features = np.empty((0, 8), np.float32)
    none = type(books.semantics.patches).of_masks([[]] * 4, [(36, 48)] * 4)
    bare = replace(books, semantics=replace(books.semantics, features=features, patches=none))
    method = blind(world)
    index = method.index(world.scene, bare)
    assert not index["lengths"].any() and len(index["weights"]) == 0
    found = method.ground(world.scene, replace(bare, index=index), RED)
    assert not found.found and found.confidence == 0.0


def test_the_books_are_the_common_ones(world, books) -> None:
    plain = prepare_books(world.scene, blind(world).tools)
    assert plain.index == {}
    np.testing.assert_array_equal(plain.semantics.features, books.semantics.features)
    np.testing.assert_array_equal(plain.depths.median, books.depths.median)

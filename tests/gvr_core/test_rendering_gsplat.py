"""The CUDA renderer's own arithmetic, on a processor: a test double stands for gsplat's kernels."""

from __future__ import annotations

import gc
import inspect
import sys
from collections.abc import Iterator
from importlib import util
from pathlib import Path

import numpy as np
import pytest
import torch
from gsplat_double import GsplatDouble, project, tile_lists
from render_scene import corner_camera, surface_scene
from render_scenes import camera, cloud, front_camera, gaussians_of, one_torch_thread

from flows.suite import parse_suite
from gvr_core.cameras import Camera, look_at
from gvr_core.errors import ConfigError, InputError
from gvr_core.gaussians import Gaussians
from gvr_core.rendering import Rendering, get_renderer
from gvr_core.rendering import gsplat_functions as loading
from gvr_core.rendering.base import NEAR
from gvr_core.rendering.gsplat_renderer import (
    GsplatRenderer,
    batches,
    camera_matrices,
    exact_origin,
)
from gvr_core.rendering.gsplat_view import CHANNELS
from gvr_core.rendering.margins import decision_margins
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.rendering.torch_reference import TorchReference

BACKGROUND = (0.2, 0.5, 0.9)
P999, MOST = 1e-5, 1e-4
"""The bars of the CPU renderer: 99.9 % of the pixels, and all of them away from decisions."""
NEAR_ALPHA, NEAR_STOP, NEAR_MEDIAN = 1e-4, 1e-3, 1e-4
"""Margins, relative, within which gsplat's rounding may turn a decision over."""
CUDA = torch.cuda.is_available() and util.find_spec("gsplat") is not None
needs_cuda = pytest.mark.skipif(
    not CUDA, reason="gsplat's kernels need a CUDA GPU and the package gsplat"
)


@pytest.fixture(autouse=True)
def _plain_torch() -> Iterator[None]:
    with one_torch_thread():
        yield


@pytest.fixture
def double() -> GsplatDouble:
    return GsplatDouble([])


@pytest.fixture(params=["double", pytest.param("gsplat", marks=needs_cuda)])
def renderer(request: pytest.FixtureRequest, double: GsplatDouble) -> GsplatRenderer:
    """The CUDA renderer, over the test double everywhere and over gsplat where there is a GPU."""
    return GsplatRenderer() if request.param == "gsplat" else GsplatRenderer(double, "0", "cpu")


def soft_mask(view: Camera) -> np.ndarray:
    mask = np.random.default_rng(1).random((view.height, view.width), dtype=np.float32)
    mask[: view.height // 3], mask[-view.height // 3 :] = 0, 1
    return mask


def check_agreement(ours: Rendering, gaussians: Gaussians, view: Camera, mask: np.ndarray) -> None:
    """Hold a picture to the CPU renderer's bars, against the float64 oracle."""
    truth = TorchReference().render(gaussians, view, BACKGROUND, mask)
    margins = decision_margins(gaussians, view)
    at_alpha, at_stop = margins.alpha < NEAR_ALPHA, margins.stop < NEAR_STOP
    away = ~(at_alpha | at_stop)
    assert away.mean() > 0.9
    for name in ("rgb", "alpha", "expected_depth"):
        theirs = getattr(truth, name)
        error = np.abs(getattr(ours, name) - theirs)
        if name == "expected_depth":
            # gsplat divides by 1 - T, of which float32 has few digits where there is little.
            there = away & (truth.alpha > 0.1)
            error = np.where(there, error / np.maximum(theirs, NEAR), 0)
        if name == "rgb":
            error = error.max(axis=2)
        assert np.quantile(error, 0.999) <= P999, name
        assert error[away].max() <= MOST, name
    same_half = away & (margins.median >= NEAR_MEDIAN)
    assert (truth.median_depth[same_half] > 0).mean() > 0.3
    np.testing.assert_allclose(
        ours.median_depth[same_half], truth.median_depth[same_half], rtol=3e-6
    )
    for name in ("weight_inside", "weight_outside"):
        mine, theirs = getattr(ours, name), getattr(truth, name)
        assert np.quantile(np.abs(mine - theirs) / np.maximum(theirs, 1e-2), 0.99) <= 3 * P999
        bound = 2 / 255 * at_alpha.sum() + 0.1 * at_stop.sum()
        assert (np.abs(mine - theirs) <= MOST * np.maximum(theirs, 1) + bound).all()


@pytest.mark.parametrize(
    "view",
    [
        corner_camera(101, 75),
        camera(64, 48, eye=(2.5, 1.2, 0.3), target=(-1, -0.5, 0), offset=(9.0, -7.0), aspect=1.3),
    ],
    ids=["corner", "off-centre"],
)
def test_surfaces_agree_with_the_oracle(renderer: GsplatRenderer, view: Camera) -> None:
    scene, mask = surface_scene(4000), soft_mask(view)
    check_agreement(renderer.render(scene, view, BACKGROUND, mask), scene, view, mask)


def test_a_scene_far_from_the_origin_agrees_with_the_oracle(renderer: GsplatRenderer) -> None:
    near = surface_scene(4000)
    far = np.array([900.0, -1100.0, 1000.0], np.float32)
    moved = Gaussians(near.means + far, near.scales, near.quats, near.opacities, near.sh)
    pose = look_at(*(far + np.array([[2.5, 1.2, 0.3], [-1, -0.5, -0.2]])), [0, 0, 1])
    view = Camera(corner_camera(120, 90).K, pose, 120, 90)
    mask = soft_mask(view)
    check_agreement(renderer.render(moved, view, BACKGROUND, mask), moved, view, mask)


@pytest.mark.parametrize("size", [0.1, 1.0, 3.0])
def test_clouds_of_needles_agree_roughly_with_the_cpu(
    renderer: GsplatRenderer, size: float
) -> None:
    # gsplat's inverse covariances cancel in float32 where a Gaussian is hundreds of times as long
    # as wide, so that the bars above are not to be had here.
    scene, view = cloud(int(size * 10), 3000, 2, size), camera()
    mask = soft_mask(view)
    ours, cpu = (r.render(scene, view, BACKGROUND, mask) for r in (renderer, NumbaRenderer()))
    for name in ("rgb", "alpha"):
        error = np.abs(getattr(ours, name) - getattr(cpu, name))
        assert np.quantile(error, 0.99) <= 1e-4, name
        assert np.quantile(error, 0.999) <= 1e-3, name
    median = np.abs(ours.median_depth - cpu.median_depth) / np.maximum(cpu.median_depth, 0.1)
    assert (median > 1e-5).mean() <= 0.001
    assert np.abs(ours.weight_inside - cpu.weight_inside).max() <= 2e-3 * cpu.weight_inside.max()


def test_many_views_are_one_call_for_each_size(double: GsplatDouble) -> None:
    renderer = GsplatRenderer(double, "0", "cpu")
    scene = surface_scene(1500)
    eyes = [(2.5, 1.2, 0.3), (2.0, -1.0, 0.5), (-2.0, 1.0, 0.0), (-2.0, -1.0, 0.2), (0, 0, 0.1)]
    sizes = [(48, 40), (48, 40), (33, 40), (48, 40), (48, 40)]
    views = [camera(*size, eye=eye) for size, eye in zip(sizes, eyes, strict=True)]
    together = list(renderer.render_many(scene, views, BACKGROUND))
    assert double.calls == [2, 1, 2]
    for view, picture in zip(views, together, strict=True):
        alone = renderer.render(scene, view, BACKGROUND)
        for name in ("rgb", "alpha", "expected_depth", "median_depth"):
            np.testing.assert_allclose(
                getattr(picture, name), getattr(alone, name), rtol=1e-4, atol=1e-6, err_msg=name
            )
    assert not np.array_equal(together[0].rgb, together[1].rgb)


def test_weights_of_many_masks_are_those_of_each(renderer: GsplatRenderer) -> None:
    scene, view = surface_scene(1500), corner_camera(48, 40)
    masks = np.random.default_rng(0).random((CHANNELS + 3, 40, 48)) < 0.3
    weights = renderer.weights(scene, view, masks)
    assert weights.shape == (1500, CHANNELS + 3)
    assert 0 < weights.nnz < weights.shape[0] * weights.shape[1]
    cpu = NumbaRenderer()
    for i in (0, CHANNELS - 1, CHANNELS, CHANNELS + 2):
        truth = cpu.render(scene, view, mask=masks[i].astype(np.float32)).weight_inside
        np.testing.assert_allclose(weights.toarray()[:, i], truth, rtol=1e-3, atol=1e-3)
    assert renderer.weights(scene, view, masks[:0]).shape == (1500, 0)


def test_hidden_gaussians_are_not_there(renderer: GsplatRenderer) -> None:
    scene, view = surface_scene(1500), corner_camera(48, 40)
    shown = np.random.default_rng(0).random(1500) < 0.5
    mask = soft_mask(view)
    part = renderer.render(scene, view, BACKGROUND, mask, shown=shown)
    alone = renderer.render(scene.subset(shown), view, BACKGROUND, mask)
    for name in ("rgb", "alpha", "expected_depth", "median_depth"):
        np.testing.assert_allclose(
            getattr(part, name), getattr(alone, name), rtol=1e-4, atol=1e-6, err_msg=name
        )
    np.testing.assert_allclose(part.weight_inside[shown], alone.weight_inside, rtol=1e-4, atol=1e-6)
    assert not part.weight_inside[~shown].any()
    (again,) = renderer.render_many(scene, [view], BACKGROUND, shown)
    np.testing.assert_allclose(again.rgb, part.rgb, rtol=1e-4, atol=1e-6)


def test_weights_behind_an_opaque_wall_keep_their_digits(renderer: GsplatRenderer) -> None:
    # T = 1.2e-4 behind the wall: 1 - alpha has three digits of it, and gsplat's gradient begins
    # with that, so that without the correction all weights of the pixel would be off by 1e-4.
    opacities = [0.97, 0.9, 0.96]
    scene = gaussians_of([[0, 0, 2], [0, 0, 3], [0, 0, 4]], 50.0, opacities, [1, 1, 1])
    view = front_camera()
    mask = np.ones((32, 32), np.float32)
    drawn = renderer.render(scene, view, mask=mask)
    truth = TorchReference().render(scene, view, mask=mask)
    assert 1e-4 < 1 - truth.alpha.max() < 2e-4
    np.testing.assert_allclose(drawn.weight_inside, truth.weight_inside, rtol=5e-6)


def test_the_median_depth_is_found_beyond_one_block_of_a_list(renderer: GsplatRenderer) -> None:
    # 300 dots in one pixel stand first in the lists of all pixels of their tile; what covers the
    # whole tile comes in the second block of the list.
    dots = np.column_stack([np.full((300, 2), 1.5 - 16.5) / 40, np.ones(300)])
    sheets = [[0, 0, 3], [0, 0, 4], [0, 0, 5]]
    scales = np.concatenate([np.full((300, 3), 1e-4), np.full((3, 3), 1e3)])
    opacities = np.concatenate([np.full(300, 0.3), [0.3, 0.4, 0.5]])
    scene = gaussians_of(np.concatenate([dots, sheets]), scales, opacities, [1, 1, 1])
    depth = renderer.render(scene, front_camera()).median_depth
    assert depth[1, 1] == 1
    np.testing.assert_array_equal(depth[4:, 4:], 4)  # 0.7 * 0.6 < 0.5


@pytest.mark.parametrize("where", ["behind", "beside", "transparent"])
def test_an_empty_view_is_the_background(renderer: GsplatRenderer, where: str) -> None:
    mean = {"behind": (0, 0, -2), "beside": (50, 0, 2), "transparent": (0, 0, 2)}[where]
    opacity = 1 / 256 if where == "transparent" else 0.9
    scene = gaussians_of([mean, mean], 0.05, [opacity, opacity], [1, 0, 0])
    view = front_camera()
    picture = renderer.render(scene, view, BACKGROUND, soft_mask(view))
    np.testing.assert_allclose(picture.rgb, np.broadcast_to(BACKGROUND, picture.rgb.shape))
    for zero in ("alpha", "expected_depth", "median_depth", "weight_inside", "weight_outside"):
        assert not getattr(picture, zero).any(), zero


def test_bad_backgrounds_and_masks_are_refused(double: GsplatDouble) -> None:
    renderer = GsplatRenderer(double, "0", "cpu")
    scene, view = surface_scene(50), front_camera()
    with pytest.raises(InputError, match="background"):
        renderer.render(scene, view, (0, 0, 2))
    with pytest.raises(InputError, match="mask has shape"):
        renderer.render(scene, view, mask=np.ones((3, 3), np.float32))
    with pytest.raises(InputError, match="masks have shape"):
        renderer.weights(scene, view, np.ones((1, 32, 31), np.bool_))
    with pytest.raises(InputError, match="flags of what to draw"):
        renderer.render(scene, view, shown=np.ones(49, np.bool_))
    assert double.calls == []


def test_a_set_goes_to_the_card_once_and_leaves_with_its_last_user(double: GsplatDouble) -> None:
    renderer = GsplatRenderer(double, "0", "cpu")
    scene, view = surface_scene(50), front_camera()
    renderer.render(scene, view)
    kept = renderer._last
    renderer.render(scene, view)
    assert kept is not None
    assert renderer._last is kept
    other = scene.dyed(np.ones(50, np.bool_))
    red = renderer.render(other, view, mask=np.ones((32, 32), np.float32))
    assert renderer._last is not kept
    assert red.rgb[..., 1:].max() <= 1e-6  # not the first set's colours
    del other
    gc.collect()
    assert renderer._last is None


def test_batches_keep_order_size_and_limit() -> None:
    small, large = camera(8, 8), camera(9, 8)
    given = [small, small, small, large, small]
    assert [len(batch) for batch in batches(given, 2)] == [2, 1, 1, 1]
    assert [view for batch in batches(given, 2) for view in batch] == given
    assert list(batches([], 2)) == []


def test_the_origin_is_taken_off_without_rounding() -> None:
    rng = np.random.default_rng(0)
    means = rng.normal(0, 1, (500, 3)).astype(np.float32)
    assert not exact_origin(means).any()
    far = (means + np.float32([900, -1100, 3])).astype(np.float32)
    origin = exact_origin(far)
    assert np.abs(origin[:2]).min() > 500
    moved = far.astype(np.float64) - origin
    np.testing.assert_array_equal(moved.astype(np.float32), moved)
    view = camera(eye=(901, -1101, 3), target=(900, -1100, 3))
    poses, _ = camera_matrices([view], origin)
    seen = moved @ poses[0, :3, :3].T + poses[0, :3, 3]
    np.testing.assert_allclose(seen, view.to_camera(far), atol=1e-3)


def test_without_a_gpu_the_renderer_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match=r"CUDA GPU.*numba.*pip install 'gvr-bench\[cuda\]'"):
        get_renderer("gsplat")
    suite = tmp_path / "suite.toml"
    suite.write_text('name = "s"\nrenderer = "gsplat"\n[[datasets]]\nname = "gallery"\n')
    with pytest.raises(ConfigError, match=r"suite\.toml.*CUDA GPU"):
        parse_suite(suite)


def test_without_gsplat_the_renderer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(loading.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"package gsplat.*pip install 'gvr-bench\[cuda\]'"):
        get_renderer("gsplat")


@pytest.fixture
def broken_gsplat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Test double: a package gsplat whose CUDA code is the file given here."""
    package = tmp_path / "gsplat"
    (package / "cuda").mkdir(parents=True)
    (package / "__init__.py").write_text("__version__ = '1.5.9'\n")
    (package / "cuda" / "__init__.py").write_text("")
    before = {name: sys.modules.pop(name) for name in list(sys.modules) if _of_gsplat(name)}
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    yield package / "cuda" / "_backend.py"
    for name in [name for name in sys.modules if _of_gsplat(name)]:
        del sys.modules[name]
    sys.modules.update(before)


def _of_gsplat(name: str) -> bool:
    return name.partition(".")[0] == "gsplat"


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("raise OSError('no libcudart')", "does not load: OSError: no libcudart"),
        ("raise IndexError('arch')", "does not load: IndexError: arch"),
        ("_C = None", "there was no nvcc"),
    ],
)
def test_a_gsplat_without_its_kernels_is_reported(
    broken_gsplat: Path, code: str, says: str
) -> None:
    broken_gsplat.write_text(code)
    renderer = get_renderer("gsplat")
    assert renderer.name == "gsplat/1/1.5.9"
    with pytest.raises(ConfigError, match=says):
        renderer.render(surface_scene(50), front_camera())


def test_the_double_projects_and_bins_as_gsplat_does() -> None:
    # gsplat's own pure-torch twins of its kernels, which run without a GPU.
    twin = pytest.importorskip(
        "gsplat.cuda._torch_impl", reason="gsplat is not installed", exc_type=ImportError
    )
    scene, views = surface_scene(300), [corner_camera(48, 40), camera(48, 40, eye=(2, -1, 0.5))]
    poses, lenses = (torch.from_numpy(array) for array in camera_matrices(views, np.zeros(3)))
    means, quats, scales = (torch.tensor(a) for a in (scene.means, scene.quats, scene.scales))
    covariances, _ = twin._quat_scale_to_covar_preci(quats, scales, compute_preci=False)
    theirs = twin._fully_fused_projection(means, covariances, poses, lenses, 48, 40)
    opaque = torch.ones(300)
    ours = project(means, quats, scales, opaque, poses, lenses, 48, 40, 0.01, 0.3)
    seen = (ours[0] > 0).all(-1)
    assert 50 < seen.sum() < 600
    assert torch.equal(seen, (theirs[0] > 0).all(-1))
    for mine, its in zip(ours[1:], theirs[1:4], strict=True):
        torch.testing.assert_close(mine[seen], its[seen], rtol=1e-4, atol=1e-4)
    _, keys, ids = twin._isect_tiles(theirs[1], theirs[0], theirs[2], 16, 3, 3)
    starts = twin._isect_offset_encode(keys, 2, 3, 3)
    my_starts, my_ids = tile_lists(theirs[1], theirs[0], theirs[2], 16, 48, 40)
    assert torch.equal(my_starts, starts)
    assert torch.equal(my_ids, ids)


def test_gsplat_takes_the_arguments_that_it_is_given() -> None:
    gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed", exc_type=ImportError)
    for name in ("rasterization", "rasterize_to_pixels", "rasterize_to_indices_in_range"):
        known = inspect.signature(getattr(gsplat, name)).parameters
        assert set(inspect.signature(getattr(GsplatDouble, name)).parameters) - {"self"} <= set(
            known
        )

"""The CPU renderer: project, sort by depth, bin into tiles, blend.

The algorithm is the tile rasteriser of 3D Gaussian Splatting (Kerbl et al., 2023), with the
opacity-aware extent that gsplat uses, as compiled kernels over pieces of the work. A picture
does not depend on the number of threads: every sum has one owner and one order.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gvr_core.cameras import Camera
from gvr_core.errors import ConfigError
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import Rendering, one_by_one
from gvr_core.rendering.binning import bin_piece, cursors
from gvr_core.rendering.blending import blend_tiles
from gvr_core.rendering.compiled import (
    available_threads,
    in_background,
    result_of,
    run_pieces,
)
from gvr_core.rendering.inputs import (
    checked_background,
    checked_mask,
    checked_masks,
    checked_shown,
)
from gvr_core.rendering.layout import DEPTH, TILE, Window, empty_rows
from gvr_core.rendering.mask_sums import masked_tiles, sums_under_masks
from gvr_core.rendering.projection import camera_numbers, project
from gvr_core.rendering.sorting import radix_argsort
from gvr_core.rendering.spherical_harmonics import shade
from gvr_core.rendering.weights import sum_pairs

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int32]

_GAUSSIANS_A_PIECE = 16384
_TILES_A_PIECE = 20


@dataclass(frozen=True)
class StageSeconds:
    """Wall-clock seconds of one render, by stage."""

    project: float
    """Projection and colour."""
    sort: float
    bin: float
    blend: float = 0.0
    """Blending, and the sums of a mask's weights."""

    @property
    def total(self) -> float:
        """All stages together, seconds."""
        return self.project + self.sort + self.bin + self.blend


@dataclass(frozen=True, eq=False)
class Binned:
    """The n Gaussians seen, front to back, and the tiles that they touch."""

    rows: FloatArray
    """(n, 16), see :mod:`gvr_core.rendering.layout`."""
    order: IntArray
    """(n,) their numbers in the set."""
    tiles: tuple[int, int]
    """Tiles in a row, and rows of tiles."""
    first_pair: NDArray[np.int64]
    """(tiles + 1,) where each tile's pairs begin."""
    pairs: IntArray
    """(P,) places in ``rows``, of each tile in turn, front to back."""
    seconds: StageSeconds


class NumbaRenderer:
    """Draws Gaussians on the CPU; safe to use from several threads, and after a fork.

    Args:
        threads: Most threads to use; None for all processors that the process may use.

    Raises:
        ConfigError: for less than one thread.
    """

    def __init__(self, threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise ConfigError(f"{threads} threads to render with", accepted="1 or more")
        self.threads = available_threads() if threads is None else threads

    @property
    def name(self) -> str:
        """Name and version of the backend; the version changes when a picture may change."""
        return "numba/1"

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        mask: FloatArray | None = None,
        shown: BoolArray | None = None,
    ) -> Rendering:
        """Draw one picture; see :class:`gvr_core.rendering.base.Renderer`.

        Raises:
            InputError: for a background, a mask or flags that do not fit.
        """
        return self.render_timed(gaussians, camera, background, mask, shown)[0]

    def render_many(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        shown: BoolArray | None = None,
    ) -> Iterator[Rendering]:
        """Draw several pictures at a time; see :class:`gvr_core.rendering.base.Renderer`.

        Each is drawn by a thread of its own, as far as there are threads: no thread then waits
        for the steps of a render that only one can do. As many pictures as threads, and one
        more, are held at a time.

        Raises:
            InputError: for a background or flags that do not fit.
        """
        at_once = min(self.threads, len(cameras))
        if at_once < 2:
            yield from one_by_one(self, gaussians, cameras, background, shown)
            return
        each = NumbaRenderer(self.threads // at_once)
        laid_out = gaussians.contiguous()
        flags = checked_shown(shown, len(gaussians))
        waiting = iter(cameras)
        running: deque[tuple[Future[Rendering], Callable[[], Rendering]]] = deque()
        try:
            while True:
                while len(running) <= at_once and (camera := next(waiting, None)) is not None:
                    work = partial(each.render, laid_out, camera, background, shown=flags)
                    running.append((in_background(work), work))
                if not running:
                    return
                yield result_of(*running.popleft())
        finally:
            for future, _ in running:
                future.cancel()

    def weights(
        self,
        gaussians: Gaussians,
        camera: Camera,
        masks: BoolArray,
        shown: BoolArray | None = None,
    ) -> sparse.csr_array:
        """Weights under masks; see :class:`gvr_core.rendering.base.Renderer`.

        One walk for all masks, without colours, over the tiles alone that they have pixels in.

        Raises:
            InputError: for masks or flags that do not fit.
        """
        masks, n = checked_masks(masks, camera), len(gaussians)
        where = masked_tiles(masks, self.threads)
        if where is None:
            return sparse.csr_array((n, len(masks)), dtype=np.float32)
        binned = self.project_and_bin(
            gaussians, camera, shown=shown, window=where.window, colours=False
        )
        return sums_under_masks(
            n, masks, where, binned.rows, binned.order, binned.tiles[0], binned.first_pair,
            binned.pairs, self.threads,
        )  # fmt: skip

    def render_timed(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        mask: FloatArray | None = None,
        shown: BoolArray | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> tuple[Rendering, StageSeconds]:
        """Draw one picture, and say what each stage took.

        Args:
            gaussians: As of :meth:`render`.
            camera: As of :meth:`render`.
            background: As of :meth:`render`.
            mask: As of :meth:`render`.
            shown: As of :meth:`render`.
            clock: Gives the time, seconds; ``time.thread_time`` tells the processor's time where
                there is one thread.

        Raises:
            InputError: for a background, a mask or flags that do not fit.
        """
        colour = checked_background(background)
        portion = None if mask is None else checked_mask(mask, camera)
        binned = self.project_and_bin(gaussians, camera, clock, shown)
        start = clock()
        rendering = self._blend(len(gaussians), camera, binned, colour, portion)
        return rendering, replace(binned.seconds, blend=clock() - start)

    def project_and_bin(
        self,
        gaussians: Gaussians,
        camera: Camera,
        clock: Callable[[], float] = time.perf_counter,
        shown: BoolArray | None = None,
        window: Window | None = None,
        colours: bool = True,
    ) -> Binned:
        """All that comes before blending.

        Args:
            gaussians: The set to draw.
            camera: Where from.
            clock: Gives the time, seconds.
            shown: (N,) flags of the Gaussians to draw; None for all.
            window: The tiles that will be drawn; None for the whole picture.
            colours: Whether colours will be asked for.
        """
        times = [clock()]
        rows, seen = self._project(gaussians, camera, shown, window, colours)
        times.append(clock())
        order = radix_argsort(rows[seen, DEPTH].view(np.uint32), seen)
        rows = self._in_order(rows, order)
        times.append(clock())
        tiles = (-(-camera.width // TILE), -(-camera.height // TILE))
        first_pair, pairs = self._bin(rows, tiles, window or Window((0, tiles[0]), (0, tiles[1])))
        times.append(clock())
        return Binned(rows, order, tiles, first_pair, pairs, StageSeconds(*np.diff(times).tolist()))

    def _project(
        self,
        gaussians: Gaussians,
        camera: Camera,
        shown: BoolArray | None = None,
        window: Window | None = None,
        colours: bool = True,
    ) -> tuple[FloatArray, IntArray]:
        n, laid_out = len(gaussians), gaussians.contiguous()
        rows, flags = empty_rows(n), checked_shown(shown, n)
        seen = np.empty(n, np.bool_)
        pose, lens, rotation, limits = camera_numbers(camera, window)
        step = _GAUSSIANS_A_PIECE

        def project_piece(piece: int) -> None:
            span = piece * step, min((piece + 1) * step, n)
            project(
                *span, laid_out.means, laid_out.scales, laid_out.quats, laid_out.opacities,
                pose, lens, rotation, limits, flags, rows, seen,
            )  # fmt: skip

        run_pieces(project_piece, -(-n // step), self.threads)
        visible = np.flatnonzero(seen).astype(np.int32)
        if not colours:
            return rows, visible
        position = np.ascontiguousarray(camera.position, dtype=np.float64)

        def shade_piece(piece: int) -> None:
            span = piece * step, min((piece + 1) * step, visible.size)
            shade(*span, visible, laid_out.means, laid_out.sh, position, rows)

        run_pieces(shade_piece, -(-visible.size // step), self.threads)
        return rows, visible

    def _in_order(self, rows: FloatArray, order: IntArray) -> FloatArray:
        """Copies of the rows seen, front to back: binning and blending then read them in turn."""
        n, step = order.size, _GAUSSIANS_A_PIECE
        ordered = empty_rows(n)

        def copy_piece(piece: int) -> None:
            part = slice(piece * step, min((piece + 1) * step, n))
            # mode="clip" only because the default would go through a buffer.
            np.take(rows, order[part], axis=0, out=ordered[part], mode="clip")

        run_pieces(copy_piece, -(-n // step), self.threads)
        return ordered

    def _bin(
        self, rows: FloatArray, tiles: tuple[int, int], window: Window
    ) -> tuple[NDArray[np.int64], IntArray]:
        pieces = 4 * self.threads
        edges = np.linspace(0, len(rows), pieces + 1).astype(np.int64)
        cursor = np.zeros((pieces, tiles[0] * tiles[1]), np.int64)
        first_pair = np.empty(tiles[0] * tiles[1] + 1, np.int64)
        nothing = np.empty(0, np.int32)

        def bin_one(piece: int, pairs: IntArray, emit: bool) -> None:
            span = edges[piece], edges[piece + 1]
            bin_piece(
                *span, rows, tiles[0], *window.columns, *window.rows, cursor[piece], pairs, emit
            )

        run_pieces(lambda piece: bin_one(piece, nothing, False), pieces, self.threads)
        cursors(cursor, first_pair)
        pairs = np.empty(int(first_pair[-1]), np.int32)
        run_pieces(lambda piece: bin_one(piece, pairs, True), pieces, self.threads)
        return first_pair, pairs

    def _blend(
        self,
        n: int,
        camera: Camera,
        binned: Binned,
        background: FloatArray,
        mask: FloatArray | None,
    ) -> Rendering:
        shape = camera.height, camera.width
        rgb = np.empty((*shape, 3), np.float32)
        alpha, expected, median = (np.empty(shape, np.float32) for _ in range(3))
        pairs, columns = binned.pairs, binned.tiles[0]
        inside = None if mask is None else np.zeros(pairs.size, np.float32)
        outside = None if mask is None else np.zeros(pairs.size, np.float32)
        count, step = columns * binned.tiles[1], _TILES_A_PIECE

        def blend_piece(piece: int) -> None:
            span = piece * step, min((piece + 1) * step, count)
            blend_tiles(
                *span, binned.first_pair, pairs, binned.rows, columns, background,
                rgb, alpha, expected, median, mask, inside, outside,
            )  # fmt: skip

        run_pieces(blend_piece, -(-count // step), self.threads)
        if inside is None or outside is None:
            return Rendering(rgb, alpha, expected, median)
        seen = binned.order.size
        sums = np.zeros((2, n), np.float32)
        sums[0, binned.order] = sum_pairs(seen, pairs, inside)
        sums[1, binned.order] = sum_pairs(seen, pairs, outside)
        return Rendering(rgb, alpha, expected, median, sums[0], sums[1])

"""What the hot loops of the CPU renderer are compiled to: float32, in vectors.

A constant without ``np.float32`` around it makes numba compute in double, which once cost the
blending a factor of ten.
"""

from __future__ import annotations

import re
import shutil
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from render_scenes import camera, cloud

from gvr_core.rendering import (
    binning,
    blending,
    compiled,
    projection,
    sorting,
    spherical_harmonics,
    weighing,
)
from gvr_core.rendering.numba_renderer import NumbaRenderer

ARITHMETIC = re.compile(
    r"\b(fadd|fsub|fmul|fdiv|frem|fneg)\b[^=\n]*?(?:<\d+ x )?\bdouble\b"
    r"|@llvm\.(\w+)\.(?:v\d+)?f64|call [^\n@]*double @(\w+)\("
)


@cache
def llvm_of(kernel: Any) -> str:
    """LLVM code of all versions that a kernel has been used in, compiled afresh."""
    NumbaRenderer().render(cloud(0, 50, 3), camera())
    NumbaRenderer().render(cloud(0, 50, 3), camera(), mask=np.ones((101, 150), np.float32))
    NumbaRenderer().weights(cloud(0, 50, 3), camera(), np.ones((1, 101, 150), np.bool_))
    fresh = numba.jit(**kernel.targetoptions)(kernel.py_func)
    for signature in kernel.nopython_signatures:
        fresh.compile(signature.args)
    return "\n".join(fresh.inspect_llvm().values())


def double_arithmetic(llvm: str) -> Counter[str]:
    """Operations on float64 by name, loads and conversions not counted."""
    return Counter(next(filter(None, match.groups())) for match in ARITHMETIC.finditer(llvm))


@pytest.mark.parametrize(
    ("kernel", "allowed"),
    [
        (blending.blend_tiles, {}),
        (weighing.weigh_tiles, {}),
        (binning.bin_piece, {}),
        (sorting.radix_argsort, {}),
        # From the camera to the mean, where a scene far from the origin would lose its digits.
        (spherical_harmonics.shade, {"fsub": 3}),
        # The projected mean: nine products and sums, two quotients, two times focal length and
        # principal point, and what float32 leaves of them.
        (projection.project, {"fmul": 11, "fadd": 11, "fdiv": 2, "fsub": 2}),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_no_arithmetic_in_double(kernel: Any, allowed: dict[str, int]) -> None:
    llvm = llvm_of(kernel)
    assert "float" in llvm or kernel is sorting.radix_argsort
    found = double_arithmetic(llvm)
    assert all(count <= allowed.get(name, 0) for name, count in found.items()), found


def test_the_check_notices_a_constant_in_double() -> None:
    def doubled(values: Any) -> None:
        for n in range(values.shape[0]):
            values[n] = values[n] * 0.3 + np.sqrt(values[n] * 1.5)

    fresh = numba.njit(doubled)
    fresh.compile((numba.types.Array(numba.float32, 1, "C"),))
    assert double_arithmetic("\n".join(fresh.inspect_llvm().values())).total() >= 2


@pytest.mark.parametrize("kernel", [blending.blend_tiles, weighing.weigh_tiles])
def test_a_row_of_pixels_is_blended_in_vectors(kernel: Any) -> None:
    llvm = llvm_of(kernel)
    lanes = [int(width) for width in re.findall(r"fmul[^=\n]*<(\d+) x float>", llvm)]
    # Eight lanes with AVX, sixteen with AVX-512, four with SSE or NEON.
    assert max(lanes, default=1) >= 4
    assert len(lanes) >= 8


def test_code_compiled_with_other_constants_is_not_taken_from_the_cache(tmp_path: Path) -> None:
    folder = Path(compiled.__file__).parent
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    same = compiled.digest_of_shared_files(tmp_path)
    assert blending.blend_tiles.py_func.__qualname__ == f"blend_tiles_{same}"  # type: ignore[attr-defined]
    cache_file = Path(blending.blend_tiles._cache.cache_path)  # type: ignore[attr-defined]
    llvm_of(blending.blend_tiles)
    assert any(same in path.name for path in cache_file.glob("blending.blend_tiles*.nbi"))
    for name in ("base.py", "layout.py", "compiled.py", "tile_rows.py"):
        before = compiled.digest_of_shared_files(tmp_path)
        with (tmp_path / name).open("a") as file:
            file.write("# changed")
        assert compiled.digest_of_shared_files(tmp_path) != before

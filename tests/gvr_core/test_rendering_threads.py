"""The same bits from every run, thread, process and number of threads."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from render_scenes import camera, cloud

from gvr_core.rendering import Rendering
from gvr_core.rendering.numba_renderer import NumbaRenderer

VIEW = camera(200, 151)
MASK = np.random.default_rng(0).random((151, 200), dtype=np.float32)


def digest(renderer: NumbaRenderer, seed: int = 0) -> str:
    picture: Rendering = renderer.render(cloud(seed, 20_000, 1, 0.5), VIEW, (0.1, 0.2, 0.3), MASK)
    total = hashlib.sha256()
    for values in vars(picture).values():
        total.update(values.tobytes())
    return total.hexdigest()


def test_the_number_of_threads_does_not_change_a_bit() -> None:
    digests = {digest(NumbaRenderer(threads)) for threads in (None, 1, 2, 3, 7) for _ in range(3)}
    assert len(digests) == 1
    assert digest(NumbaRenderer(), seed=1) not in digests


def test_renders_from_several_python_threads_do_not_disturb_each_other() -> None:
    renderer = NumbaRenderer(threads=2)
    expected = [digest(renderer, seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            assert list(pool.map(lambda seed: digest(renderer, seed), range(4))) == expected


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_child_can_render() -> None:
    expected = digest(NumbaRenderer(threads=2))  # so that the parent has its threads
    child = os.fork()
    if child == 0:
        signal.alarm(60)  # rather than to wait for ever
        os._exit(0 if digest(NumbaRenderer(threads=2)) == expected else 1)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0


def test_a_second_process_takes_the_compiled_code_from_the_cache() -> None:
    digest(NumbaRenderer())  # fills the cache, where nothing has yet
    NumbaRenderer().render(cloud(0, 10), VIEW)
    program = """
import sys
from render_scenes import camera, cloud
import numpy as np
from gvr_core.rendering import binning, blending, projection, sorting, spherical_harmonics, weights
from gvr_core.rendering.numba_renderer import NumbaRenderer
for mask in (None, np.ones((101, 150), np.float32)):
    NumbaRenderer().render(cloud(0, 500, 3), camera(), mask=mask)
kernels = (projection.project, spherical_harmonics.shade, sorting.radix_argsort, binning.bin_piece,
           binning.cursors, blending.blend_tiles, weights.sum_pairs)
for kernel in kernels:
    stats = kernel.stats
    print(kernel.__name__, sum(stats.cache_misses.values()), sum(stats.cache_hits.values()))
"""
    tests, repository = Path(__file__).parent.parent, Path(__file__).parent.parent.parent
    path = os.pathsep.join([str(tests), str(repository), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    lines = [line.split() for line in run.stdout.splitlines()]
    assert [line[0] for line in lines] == [
        *("project", "shade", "radix_argsort", "bin_piece", "cursors", "blend_tiles", "sum_pairs")
    ]
    for name, compiled, loaded in lines:
        assert int(compiled) == 0, name
        assert int(loaded) == (2 if name == "blend_tiles" else 1), name

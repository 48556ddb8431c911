"""The same bits from every run, thread, process and number of threads."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from render_scenes import camera, cloud

from gvr_core.rendering import Rendering, compiled
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
    NumbaRenderer().weights(cloud(0, 10), VIEW, MASK[None] > 0.5)
    program = """
import sys
from render_scenes import camera, cloud
import numpy as np
from gvr_core.rendering import binning, blending, projection, sorting, spherical_harmonics
from gvr_core.rendering import weighing, weights
from gvr_core.rendering.numba_renderer import NumbaRenderer
for mask in (None, np.ones((101, 150), np.float32)):
    NumbaRenderer().render(cloud(0, 500, 3), camera(), mask=mask)
NumbaRenderer().weights(cloud(0, 500, 3), camera(), np.ones((2, 101, 150), bool))
kernels = (projection.project, spherical_harmonics.shade, sorting.radix_argsort, binning.bin_piece,
           binning.cursors, blending.blend_tiles, weights.sum_pairs,
           weighing.mark_tiles, weighing.weigh_tiles, weighing.sum_weights)
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
        *("project", "shade", "radix_argsort", "bin_piece", "cursors", "blend_tiles", "sum_pairs"),
        *("mark_tiles", "weigh_tiles", "sum_weights"),
    ]
    for name, missed, loaded in lines:
        assert int(missed) == 0, name
        assert int(loaded) == (2 if name == "blend_tiles" else 1), name


PROGRAM = """
import sys
from pathlib import Path
import gvr_core.rendering.sorting as sorting
import numpy as np
assert Path(sorting.__file__).is_relative_to(sys.argv[1]), sorting.__file__
order = sorting.radix_argsort(np.uint32([5, 3, 9]), np.int32([0, 1, 2]))
stats = sorting.radix_argsort.stats
print(order.tolist(), sum(stats.cache_misses.values()), sum(stats.cache_hits.values()))
"""


def started(root: Path, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(root)],
        env={**os.environ, "PYTHONPATH": str(root), **environment},
        cwd=root,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def said(process: subprocess.Popen[str]) -> str:
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return out.strip()


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of the package that nothing has been compiled for yet."""
    source = Path(compiled.__file__).parent.parent
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(source, tmp_path / "gvr_core", ignore=ignored)
    return tmp_path


def test_two_processes_that_compile_at_once_agree_and_leave_a_sound_cache(copied: Path) -> None:
    both = [started(copied), started(copied)]
    assert {said(process).split("]")[0] for process in both} == {"[1, 0, 2"}
    assert said(started(copied)) == "[1, 0, 2] 0 1"


@pytest.mark.skipif(os.name != "posix", reason="permissions as POSIX has them")
def test_where_no_cache_can_be_written_each_process_compiles_for_itself(copied: Path) -> None:
    nowhere = copied / "file"
    nowhere.touch()
    # Even the superuser can make no folder where a file has its name.
    (copied / "gvr_core" / "rendering" / "__pycache__").touch()
    homes = {name: str(nowhere) for name in ("HOME", "XDG_CACHE_HOME", "IPYTHONDIR")}
    for _ in range(2):
        assert said(started(copied, PYTHONDONTWRITEBYTECODE="1", **homes)) == "[1, 0, 2] 1 0"

"""What a block cost: its own peak, and what is in it of blocks beside it."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from tasks.measure import Measurement, peak_resident

linux = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux only")


@linux
def test_blocks_at_the_same_time_are_marked_and_one_alone_is_not() -> None:
    begun, over = threading.Event(), threading.Event()
    beside = Measurement()

    def run_beside() -> None:
        with beside:
            begun.set()
            assert over.wait(30)

    thread = threading.Thread(target=run_beside)
    with Measurement() as first:
        thread.start()
        assert begun.wait(30)
    over.set()
    thread.join(30)
    with Measurement() as alone:
        pass
    # the one that began first learns of the other when it ends, and the other way round
    assert (first.peak_of, beside.peak_of, alone.peak_of) == ("shared", "shared", "stage")


@linux
def test_a_block_that_begins_takes_no_peak_from_one_that_runs() -> None:
    """In a fresh process: libraries that other tests load keep freed memory for themselves."""
    code = """
import numpy as np
from tasks.measure import Measurement, peak_resident
outer = Measurement()
with outer:
    np.ones(50_000_000).sum()  # 400 MB, gone before the inner block resets the peak
    with Measurement() as inner:
        pass
print(outer.peak_bytes - inner.peak_bytes)
"""
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert int(run.stdout) > 250e6


def test_where_the_kernel_resets_nothing_the_peak_is_the_process_s(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr("tasks.measure._CLEAR_REFS", tmp_path / "none" / "clear_refs")
    with Measurement() as measured:
        block = np.ones(1_000_000)
    assert measured.peak_of == "process" and measured.peak_bytes > block.nbytes


def test_the_peak_is_not_the_parents() -> None:
    big = b"x" * (400 * 2**20)
    command = "from tasks.measure import peak_resident; print(peak_resident())"
    child = subprocess.run([sys.executable, "-c", command], capture_output=True, check=True)
    assert len(big) <= peak_resident()
    assert 2**20 < int(child.stdout) < 200 * 2**20

"""Whole data sets with one file spoilt, missing, a folder, or a link: errors of ours, or read."""

from __future__ import annotations

import pytest
from hostile_inputs import quickly, read, seeds
from hypothesis import given, settings
from hypothesis import strategies as st

LAYOUTS = ["native", "lerf_ovs", "lerf_mask", "ovs3d"]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_file_in_each_way(layout: str) -> None:
    accepted = [read(f"tree-{layout}", seed) for seed in seeds(f"tree-{layout}")]
    assert not all(accepted)


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(quickly, max_examples=40)
@given(data=st.data())
def test_damaged_files(layout: str, data: st.DataObject) -> None:
    change = st.tuples(st.integers(0, 255), st.sampled_from([0, 1, 2, 3]), st.binary(max_size=40))
    which, kind, content = data.draw(change)
    read(f"tree-{layout}", bytes([which, kind]) + content)

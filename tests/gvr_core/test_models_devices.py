"""Batches follow free memory, halve where it runs out, and say so."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import pytest
import torch

from gvr_core.errors import ConfigError, ModelError
from gvr_core.models import devices
from gvr_core.models.devices import Batches, is_out_of_memory, pick_device

CPU = torch.device("cpu")
CPU_MESSAGE = "[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried to allocate 9"


class Sizes:
    """Returns its batches and fails where one is larger than the memory."""

    def __init__(self, fits: int, error: Exception) -> None:
        self.fits = fits
        self.error = error
        self.tried: list[int] = []

    def __call__(self, items: Sequence[int]) -> list[int]:
        self.tried.append(len(items))
        if len(items) > self.fits:
            raise self.error
        return list(items)


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """What the device has free, bytes; tests may change it."""
    memory = {"bytes": 10**12}
    monkeypatch.setattr(devices, "free_bytes", lambda device: memory["bytes"])
    return memory


def test_the_size_follows_the_free_memory(free: dict[str, int]) -> None:
    batches = Batches("patches", item_bytes=1000, most=64)
    assert batches.size(CPU) == 64
    free["bytes"] = 20_000
    assert batches.size(CPU) == 20_000 * devices.USED_SHARE // 1000
    free["bytes"] = 10
    assert batches.size(CPU) == 1


def test_items_come_in_order_in_full_batches(free: dict[str, int]) -> None:
    work = Sizes(10, MemoryError())
    assert Batches("patches", 1, most=4).run(work, range(10), CPU) == [
        [0, 1, 2, 3],
        [4, 5, 6, 7],
        [8, 9],
    ]
    assert work.tried == [4, 4, 2]
    assert Batches("patches", 1, most=4).run(work, range(0), CPU) == []


@pytest.mark.parametrize(
    "error",
    [
        torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB"),
        RuntimeError("CUDA error: out of memory"),
        RuntimeError(CPU_MESSAGE),
        MemoryError(),
    ],
    ids=["cuda", "cuda-late", "cpu", "python"],
)
def test_out_of_memory_halves_says_so_and_sticks(
    error: Exception, free: dict[str, int], caplog: pytest.LogCaptureFixture
) -> None:
    batches, work = Batches("patches", 1, most=16), Sizes(5, error)
    with caplog.at_level(logging.WARNING, devices.__name__):
        parts = batches.run(work, range(10), CPU)
    assert [i for part in parts for i in part] == list(range(10))
    assert work.tried == [10, 5, 5]
    messages = [record.getMessage() for record in caplog.records]
    assert messages == ["cpu ran out of memory with 10 patches at once; going on with 5"]
    work.tried.clear()
    batches.run(work, range(12), CPU)
    assert work.tried == [5, 5, 2]


def test_it_halves_as_often_as_it_takes(
    free: dict[str, int], caplog: pytest.LogCaptureFixture
) -> None:
    work = Sizes(1, MemoryError())
    parts = Batches("texts", 1, most=8).run(work, range(9), CPU)
    assert parts == [[i] for i in range(9)]
    assert work.tried == [8, 4, 2, *[1] * 9]
    assert len(caplog.records) == 3


def test_one_item_that_does_not_fit_is_an_error(free: dict[str, int]) -> None:
    work = Sizes(0, MemoryError())
    with pytest.raises(ModelError, match="cpu runs out of memory with one of the patches"):
        Batches("patches", 1, most=4).run(work, range(4), CPU)
    assert work.tried == [4, 2, 1]


def test_other_errors_pass_through(free: dict[str, int]) -> None:
    work = Sizes(0, RuntimeError("mat1 and mat2 shapes cannot be multiplied"))
    with pytest.raises(RuntimeError, match="shapes cannot be multiplied"):
        Batches("patches", 1, most=4).run(work, range(4), CPU)
    assert work.tried == [4]
    assert not is_out_of_memory(ValueError("shapes"))


def test_free_memory_is_that_of_this_machine() -> None:
    assert 2**20 < devices.free_bytes(CPU) < 2**50


def test_devices_by_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert pick_device() == pick_device("cpu") == CPU
    with pytest.raises(ConfigError, match="auto, cpu"):
        pick_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert pick_device().type == pick_device("cuda").type == "cuda"
    assert pick_device("cpu") == CPU

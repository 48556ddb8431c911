"""Where networks compute, and how much at once."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

from gvr_core.errors import ConfigError, ModelError

if TYPE_CHECKING:
    import torch

log = logging.getLogger(__name__)

DeviceChoice = Literal["auto", "cpu", "cuda"]
"""``"auto"`` is a CUDA device where there is one, else the processor."""

USED_SHARE = 0.5
"""Part of the free memory that one batch may take: activations are estimates, and others live
here too."""

_SIGNS = (
    "out of memory",
    "can't allocate memory",
    "CUBLAS_STATUS_ALLOC_FAILED",
    "CUDNN_STATUS_ALLOC_FAILED",
)
"""What errors say that are of no class of their own: torch has one on CUDA only, and the
libraries that it calls do not use it."""

Result = TypeVar("Result")


class Sliceable(Protocol):
    """Items in a row: a list, an array, a tensor."""

    def __len__(self) -> int:
        """How many."""
        ...

    def __getitem__(self, part: slice, /) -> Any:
        """Some of them, in the same form."""
        ...


def pick_device(choice: DeviceChoice = "auto") -> torch.device:
    """The device that a choice means on this machine.

    Raises:
        ConfigError: if CUDA is demanded and there is none.
    """
    import torch

    has_cuda = torch.cuda.is_available()
    if choice == "cuda" and not has_cuda:
        raise ConfigError("device is 'cuda', and torch finds none", accepted="auto, cpu")
    return torch.device("cuda" if has_cuda and choice != "cpu" else "cpu")


def free_bytes(device: torch.device) -> int:
    """Memory that is free on a device, bytes."""
    import psutil
    import torch

    if device.type == "cuda":
        return int(torch.cuda.mem_get_info(device)[0])
    return int(psutil.virtual_memory().available)


class Batches:
    """Runs a function over many items in batches that fit into memory.

    The size follows the free memory at each run. Where that guess was too bold and the device
    runs out, the size is halved, which is logged, and the failed batch is taken again; later runs
    stay at what worked.

    Args:
        what: What is batched, for the log, e.g. ``"patches"``.
        item_bytes: Estimate of what one item takes while it is computed, bytes.
        most: No batch is larger.
    """

    def __init__(self, what: str, item_bytes: int, most: int) -> None:
        self._what = what
        self._item_bytes = item_bytes
        self._most = most

    def size(self, device: torch.device) -> int:
        """Items in a batch, at least 1."""
        return max(1, min(self._most, int(free_bytes(device) * USED_SHARE) // self._item_bytes))

    def run(
        self,
        function: Callable[[Any], Result],
        items: Sliceable,
        device: torch.device,
    ) -> list[Result]:
        """The function's results for one batch after the other.

        Args:
            function: Takes a batch, which is a slice of the items.
            items: A list, an array or a tensor.
            device: Where it computes.

        Raises:
            ModelError: if not even one item fits.
        """
        results: list[Result] = []
        start, size = 0, self.size(device)
        while start < len(items):
            try:
                results.append(function(items[start : start + size]))
            except (RuntimeError, MemoryError) as error:
                if not is_out_of_memory(error):
                    raise
                failed = min(size, len(items) - start)
            else:
                start += size
                continue
            # Outside of the except block: the error's traceback holds the batch's tensors.
            size = self._halve(failed, device)
        return results

    def _halve(self, size: int, device: torch.device) -> int:
        if size == 1:
            raise ModelError(
                f"{device} runs out of memory with one of the {self._what}",
                accepted="a smaller model, smaller pictures, or device = 'cpu'",
            )
        _release(device)
        self._most = size // 2
        log.warning(
            "%s ran out of memory with %d %s at once; going on with %d",
            device,
            size,
            self._what,
            self._most,
        )
        return self._most


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that memory ran out."""
    import torch

    if isinstance(error, (torch.cuda.OutOfMemoryError, MemoryError)):
        return True
    return any(sign in str(error) for sign in _SIGNS)


def _release(device: torch.device) -> None:
    import torch

    if device.type == "cuda":
        torch.cuda.empty_cache()

"""Masks that a data set states as pictures, each read by the data set's own rule."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.images import read_mask


@dataclass(frozen=True)
class GreyMask:
    """A grey picture, foreground where it is brighter than a threshold of its own."""

    path: Path
    size: tuple[int, int]
    """Width and height that the picture must have, pixels."""
    threshold: int
    """Foreground is brighter than this, of 0 to 255."""

    def pixels(self) -> NDArray[np.bool_]:
        """(H, W) True on the foreground; transparent pixels are background.

        Raises:
            DatasetError: if the picture cannot be read, or has another size.
        """
        return read_mask(self.path, size=self.size, threshold=self.threshold)

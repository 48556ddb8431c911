"""Masks that a data set states as polygons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PolygonMask:
    """The union of polygons in a picture."""

    polygons: tuple[NDArray[np.float64], ...]
    """Each (k, 2), x and y of its corners in pixels, k >= 3."""
    size: tuple[int, int]
    """Width and height of the picture, pixels."""

    def pixels(self) -> NDArray[np.bool_]:
        """(H, W) True inside and on the outline.

        As LangSplat's evaluator draws labels (eval/utils.py): corners cut to whole numbers, and
        OpenCV's filling.
        """
        import cv2

        width, height = self.size
        canvas = np.zeros((height, width), np.uint8)
        for polygon in self.polygons:
            cv2.fillPoly(canvas, [polygon.astype(np.int32)], (1,))
        return canvas.astype(np.bool_)

    def is_visible(self) -> bool:
        """Whether `pixels` would have any, told from the corners: nothing is drawn.

        A polygon colours a pixel if an edge crosses the picture, or else if it goes all round it.
        """
        import cv2

        frame = (0, 0, *self.size)
        for polygon in self.polygons:
            corners = polygon.astype(np.int32)
            if ((corners >= 0) & (corners < self.size)).all(axis=1).any():
                return True
            starts, ends = corners.tolist(), np.roll(corners, -1, axis=0).tolist()
            if any(cv2.clipLine(frame, a, b)[0] for a, b in zip(starts, ends, strict=True)):
                return True
            if cv2.pointPolygonTest(corners, (0.0, 0.0), False) > 0:
                return True
        return False

"""What every protocol asks of a prediction and its truth before it scores them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import DatasetError
from gvr_core.protocols.base import ViewPrediction, ViewTruth


def check_pair(prediction: ViewPrediction, truth: ViewTruth) -> None:
    """Refuse what has no score.

    Raises:
        DatasetError: for maps that are not of the truth's size, or not finite.
    """
    size = truth.mask.shape
    if truth.mask.ndim != 2 or truth.mask.dtype != np.bool_ or not truth.mask.size:
        raise DatasetError(
            f"a truth of shape {size} and type {truth.mask.dtype}",
            accepted="a mask (H, W) of bool with at least one pixel",
        )
    _check_map("soft", prediction.soft, size)
    if prediction.isolated is not None:
        _check_map("isolated", prediction.isolated, size)
    if prediction.relevancy is not None:
        levels = prediction.relevancy.shape[:1]
        _check_map("relevancy", prediction.relevancy, (max(1, *levels), *size))


def _check_map(name: str, values: NDArray[np.float32], shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise DatasetError(
            f"a prediction of shape {values.shape}", place=name, accepted=f"shape {shape}"
        )
    if not np.isfinite(values).all():
        raise DatasetError(
            "a prediction that is not a number everywhere", place=name, accepted="finite values"
        )

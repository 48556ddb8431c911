"""What no view has seen follows its neighbours, and what stands alone is dropped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

BoolArray = NDArray[np.bool_]

MARGIN = 0.02
"""The box around the target is widened by this part of its diagonal."""
STRAY_SHARE = 0.25
"""A flagged Gaussian of whose neighbours fewer than this part are flagged is a stray."""


def follow_neighbours(
    means: NDArray[np.float32], flags: BoolArray, seen: BoolArray, neighbours: int
) -> BoolArray:
    """Decide for unseen Gaussians by majority of the seen ones around them, and drop strays.

    Views see surfaces. The inside of an object has no transmittance left, so nothing is known
    of it, and taking the object away would leave its core hanging in the air.

    Args:
        means: (N, 3) centres.
        flags: (N,) what the views say.
        seen: (N,) whether they say anything.
        neighbours: How many are asked.

    Returns:
        (N,) flags.
    """
    voted = flags & seen
    if np.count_nonzero(voted) < neighbours:
        return flags
    low, high = means[voted].min(axis=0), means[voted].max(axis=0)
    margin = MARGIN * float(np.linalg.norm(high - low))
    near = ((means >= low - margin) & (means <= high + margin)).all(axis=1)
    judges = np.flatnonzero(near & seen)
    tree = KDTree(means[judges])
    k = min(neighbours, len(judges))

    kept = flags.copy()
    kept[~seen] = False
    unseen = np.flatnonzero(near & ~seen)
    if len(unseen):
        around = tree.query(means[unseen], k=k, workers=-1)[1].reshape(len(unseen), k)
        kept[unseen] = flags[judges][around].mean(axis=1) > 0.5
    members = np.flatnonzero(voted)
    around = tree.query(means[members], k=k, workers=-1)[1].reshape(len(members), k)
    kept[members] = flags[judges][around].mean(axis=1) >= STRAY_SHARE
    return kept

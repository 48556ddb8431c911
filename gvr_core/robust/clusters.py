"""From candidates to places: density clusters at the object's own scale, every instance kept."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gvr_core.localize import Place
from gvr_core.rendering.compiled import precise_kernel
from gvr_core.robust.candidates import Candidate

Float64Array = NDArray[np.float64]

MIN_SAMPLES = 3
"""A cluster's core has at least so many candidates around it, where there are that many."""
REACH_PERCENTILE = 95.0
"""A place's radius is this percentile of its surface points' distances."""
WEISZFELD_STEPS = 64
"""Iterations of the geometric median; it is at rest long before."""


def cluster_candidates(
    candidates: Sequence[Candidate], radii: float, min_share: float
) -> tuple[NDArray[np.int64], float]:
    """DBSCAN over the candidates' points.

    Ester et al., "A Density-Based Algorithm for Discovering Clusters" (KDD 1996).

    Args:
        candidates: At least one.
        radii: Reach in median candidate radii.
        min_share: Least share of all candidates around a core, but at least 3 candidates.

    Returns:
        (v,) index of each candidate's cluster, -1 for none, and the reach in scene units.
    """
    # scikit-learn takes most of a second to import, and every command imports this module.
    from sklearn.cluster import DBSCAN

    points = np.stack([candidate.point for candidate in candidates])
    reach = radii * float(np.median([candidate.radius for candidate in candidates]))
    least = min(len(points), max(MIN_SAMPLES, int(np.ceil(min_share * len(points)))))
    # a reach of nothing is a single point seen many times; the origin must not matter
    points = points - np.median(points, axis=0)
    reach = max(reach, 1e-6 * float(np.abs(points).max()), np.finfo(np.float64).tiny)
    labels = DBSCAN(eps=reach, min_samples=least).fit(points).labels_
    if labels.max() < 0:
        # Few views look at opposite faces, a diameter apart, with none in between to link them.
        reach *= 2
        labels = DBSCAN(eps=reach, min_samples=least).fit(points).labels_
    return labels.astype(np.int64), reach


def places_of(
    candidates: Sequence[Candidate], labels: NDArray[np.int64], share: float, most: int
) -> tuple[NDArray[np.int64], tuple[Place, ...]]:
    """The places of clusters, the one with the most behind it first.

    Args:
        candidates: The candidates.
        labels: (v,) cluster of each, -1 for none.
        share: A further place has at least this part of the first one's weight.
        most: At most so many places.

    Returns:
        (v,) index of each candidate's place, -1 for none, and the places.
    """
    found = []
    for label in range(int(labels.max(initial=-1)) + 1):
        members = [c for c, own in zip(candidates, labels, strict=True) if own == label]
        found.append((sum(c.evidence for c in members), label, members))
    found.sort(key=lambda entry: (-entry[0], -len(entry[2]), entry[1]))
    renamed = np.full(len(labels), -1, np.int64)
    places: list[Place] = []
    for weight, label, members in found[:most]:
        if places and (weight <= 0 or weight < share * places[0].weight):
            break
        renamed[labels == label] = len(places)
        surface = np.concatenate([c.surface for c in members])
        centre = geometric_median(surface)
        distances = np.linalg.norm(surface - centre, axis=1)
        radius = float(np.percentile(distances, REACH_PERCENTILE))
        least = float(np.median([c.radius for c in members]))
        places.append(Place(centre, max(radius, least), weight))
    return renamed, tuple(places)


def geometric_median(points: Float64Array) -> Float64Array:
    """The point with the least sum of distances to all others (Weiszfeld's iteration).

    It withstands up to half of the points being wrong, as the medoid does; but where cameras
    stand all around, the medoid of surface points lies on one side of the object, and this lies
    inside of it.

    Args:
        points: (n, 3), n >= 1.
    """
    points = np.ascontiguousarray(points, np.float64)
    centre: Float64Array = np.median(points, axis=0)
    scale = float(np.abs(points - centre).max())
    for _ in range(WEISZFELD_STEPS):
        moved = _weighted_mean(points, centre, 1e-6 * scale + 1e-300)
        if np.linalg.norm(moved - centre) <= 1e-6 * scale:
            return np.asarray(moved, np.float64)
        centre = moved
    return centre


@precise_kernel
def _weighted_mean(points: Float64Array, centre: Float64Array, least: float) -> Float64Array:
    """Mean of points (n, 3), each weighted by 1 / its distance from a centre (3,)."""
    total, mean = 0.0, np.zeros(3)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
        weight = 1 / max(math.sqrt(dx * dx + dy * dy + dz * dz), least)
        total += weight
        mean[0] += weight * x
        mean[1] += weight * y
        mean[2] += weight * z
    return mean / total

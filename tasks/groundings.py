"""Answers of a method as stored arrays, and back: flags, locations, and the evidence for them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import PatchBook
from gvr_core.errors import StoreError
from gvr_core.localize import Localization, Place, Retrieval
from gvr_core.methods import Grounding
from gvr_core.untrusted import parse_json

BEV, RING = 0, 1
"""Roles of virtual views in the evidence."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What is kept of a grounding for scoring it and showing it."""

    flags: NDArray[np.bool_]
    """(N,) I_tar."""
    scores: NDArray[np.float32]
    """(N,) soft membership in [0, 1]."""
    location: NDArray[np.float64] | None
    """(3,) L_3D, world frame."""
    found: bool
    confidence: float
    given: Mapping[str, NDArray[Any]] | None = None
    """View name -> mask or relevancy maps, of methods that give pictures; see ``Grounding``."""
    answered: bool = True
    """Whether there is an answer at all."""


def pack_localization(localization: Localization | None) -> dict[str, Any] | None:
    """A localisation as JSON values; numbers come back exactly."""
    if localization is None:
        return None
    retrieval = localization.retrieval
    return {
        "places": [
            {"location": place.location.tolist(), "radius": place.radius, "weight": place.weight}
            for place in localization.places
        ],
        "labels": localization.labels.tolist(),
        "radius": localization.radius,
        "confidence": localization.confidence,
        "is_stuff": localization.is_stuff,
        "views": retrieval.views.tolist(),
        "patches": retrieval.patches.tolist(),
        "relevancies": [float(value) for value in retrieval.relevancies],
        "pixels": retrieval.pixels.tolist(),
        "points": retrieval.points.tolist(),
    }


def unpack_localization(data: Mapping[str, Any] | None) -> Localization | None:
    """The localisation that :func:`pack_localization` put away."""
    if data is None:
        return None
    retrieval = Retrieval(
        np.array(data["views"], np.int64),
        np.array(data["patches"], np.int64),
        np.array(data["relevancies"], np.float32),
        np.array(data["pixels"], np.float64).reshape(-1, 2),
        np.array(data["points"], np.float64).reshape(-1, 3),
    )
    places = tuple(
        Place(np.array(place["location"], np.float64), place["radius"], place["weight"])
        for place in data["places"]
    )
    return Localization(
        retrieval,
        np.array(data["labels"], np.int64),
        places,
        data["radius"],
        data["confidence"],
        data["is_stuff"],
    )


def pack_groundings(groundings: Sequence[Grounding], n: int) -> dict[str, NDArray[Any]]:
    """The groundings of all queries of a scene as named arrays.

    Flags are packed eight to a byte. Scores are kept only where they say more than the flags.

    Args:
        groundings: One for each query.
        n: N, the number of Gaussians.
    """
    flags = np.array([g.flags for g in groundings], np.bool_).reshape(-1, n)
    scores = np.array([g.scores for g in groundings], np.float32).reshape(-1, n)
    nowhere = np.full(3, np.nan)
    arrays: dict[str, NDArray[Any]] = {
        "flags": np.packbits(flags, axis=1),
        "n": np.array([n], np.int64),
        "locations": np.array(
            [nowhere if g.location is None else g.location for g in groundings], np.float64
        ).reshape(-1, 3),
        "found": np.array([g.found for g in groundings], np.bool_),
        "confidence": np.array([g.confidence for g in groundings], np.float64),
    }
    if not np.array_equal(scores, flags):
        arrays["scores"] = scores
    if not all(g.answered for g in groundings):
        arrays["answered"] = np.array([g.answered for g in groundings], np.bool_)
    return arrays | _pack_given(groundings) | _pack_evidence(groundings)


def unpack_answers(arrays: Mapping[str, NDArray[Any]]) -> list[Answer]:
    """The answers that :func:`pack_groundings` put away, one for each query.

    Raises:
        StoreError: for arrays that it never made.
    """
    try:
        return _unpacked(arrays)
    except (LookupError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise StoreError(
            f"no stored answers: {type(error).__name__}: {error}"
            " (accepted: the arrays of pack_groundings)"
        ) from error


def _unpacked(arrays: Mapping[str, NDArray[Any]]) -> list[Answer]:
    n = int(arrays["n"][0])
    # Unpacking fills up with zeros whatever count it is told.
    if arrays["flags"].shape != (len(arrays["found"]), (n + 7) // 8):
        raise ValueError(f"flags of shape {arrays['flags'].shape} for {n} Gaussians")
    flags = np.unpackbits(arrays["flags"], axis=1, count=n).astype(np.bool_)
    scores = arrays["scores"] if "scores" in arrays else flags.astype(np.float32)
    places = [None if np.isnan(place).any() else place for place in arrays["locations"]]
    pictures = _unpack_given(arrays)
    return [
        Answer(
            flags[i],
            scores[i],
            places[i],
            bool(found),
            float(arrays["confidence"][i]),
            pictures.get(i),
            bool(arrays["answered"][i]) if "answered" in arrays else True,
        )
        for i, found in enumerate(arrays["found"])
    ]


def _pack_given(groundings: Sequence[Grounding]) -> dict[str, NDArray[Any]]:
    """Pictures of methods that give such, and which query and view each is of."""
    arrays: dict[str, NDArray[Any]] = {}
    listed: list[tuple[int, str]] = []
    for query, grounding in enumerate(groundings):
        for view, picture in (grounding.given or {}).items():
            arrays[f"given.{len(listed)}"] = picture
            listed.append((query, view))
    having = [i for i, grounding in enumerate(groundings) if grounding.given is not None]
    if having:
        listing = json.dumps({"queries": having, "pictures": listed}).encode()
        arrays["given.listing"] = np.frombuffer(listing, np.uint8)
    return arrays


def _unpack_given(arrays: Mapping[str, NDArray[Any]]) -> dict[int, dict[str, NDArray[Any]]]:
    if "given.listing" not in arrays:
        return {}
    listing = parse_json(arrays["given.listing"].tobytes())
    pictures: dict[int, dict[str, NDArray[Any]]] = {i: {} for i in listing["queries"]}
    for number, (query, view) in enumerate(listing["pictures"]):
        pictures[query][view] = arrays[f"given.{number}"]
    return pictures


def _pack_evidence(groundings: Sequence[Grounding]) -> dict[str, NDArray[Any]]:
    """Cameras and masks of the virtual views; their pictures can be rendered again."""
    views = [
        (query, role, view)
        for query, grounding in enumerate(groundings)
        for role, view in [
            *([(BEV, grounding.bev)] if grounding.bev else []),
            *((RING, view) for view in grounding.ring),
        ]
    ]
    masks = PatchBook.of_masks(
        [[view.mask] if view.mask else [] for _, _, view in views],
        [(view.frame.camera.height, view.frame.camera.width) for _, _, view in views],
    )
    cameras = [view.frame.camera for _, _, view in views]
    return {
        "evidence.query": np.array([query for query, _, _ in views], np.int32),
        "evidence.role": np.array([role for _, role, _ in views], np.int8),
        "evidence.K": np.array([camera.K for camera in cameras], np.float64).reshape(-1, 3, 3),
        "evidence.world_to_camera": np.array(
            [camera.world_to_camera for camera in cameras], np.float64
        ).reshape(-1, 4, 4),
        **{f"evidence.{name}": array for name, array in masks.to_arrays().items()},
    }

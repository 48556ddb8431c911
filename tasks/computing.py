"""What each stage of a scene computes: plain functions from handles to handles.

One rendering pass makes both the View Book and the Depth Book; ``depth`` hands the latter on. Books
are written view by view and read by memory map, so that no stage holds all views at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gvr_core import preparation
from gvr_core.errors import StoreError
from gvr_core.methods import build_method
from tasks.arrays import StoredArrays
from tasks.drawing import draw_query
from tasks.evaluation import score_scene
from tasks.evidence import gather_evidence
from tasks.groundings import (
    pack_groundings,
    pack_localization,
    small_pictures,
    unpack_answers,
    unpack_localization,
    without_pictures,
)
from tasks.open_books import NO_BOOKS, OpenBooks
from tasks.query_times import QueryTimes
from tasks.scene_job import SceneJob
from tasks.store import StageOutput, Store

Inputs = Mapping[str, Any]
"""Name -> the digest of a part of the scene, or how an earlier stage ended (a StageRun)."""

Config = Mapping[str, Any]
"""A stage's own slice of the configuration."""


def compute_render(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Render every knowledge view once: the View Book, and the Depth Book for the next stage."""
    scene = job.data.scene
    sizes = preparation.view_sizes(scene.views)
    pixels = _n_pixels(sizes)
    pictures = preparation.render_each(
        scene.gaussians,
        scene.views,
        job.tools.renderer,
        job.method.background,
        lambda views: job.track(views, "render"),
    )
    view_layout = {"values": ("u1", (pixels, 3)), "alphas": ("u1", (pixels,))}
    depth_layout = {"expected": ("f4", (pixels,)), "median": ("f4", (pixels,))}
    of_sizes = {"sizes": ("i4", sizes.shape)}
    with (
        store.new_arrays("view_book", view_layout | of_sizes) as views,
        store.new_arrays("depth_book", depth_layout | of_sizes) as depths,
    ):
        views.append("sizes", sizes)
        depths.append("sizes", sizes)
        for picture in pictures:
            views.append("values", picture.values)
            views.append("alphas", picture.alphas)
            depths.append("expected", picture.expected)
            depths.append("median", picture.median)
    artifacts = {"views": views.artifact, "depths": depths.artifact}
    return StageOutput(artifacts, {"n_views": len(sizes)})


def compute_depth(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """The Depth Book: what the render stage has drawn of it, if it is one of these views.

    Raises:
        StoreError: It is not.
    """
    artifact = inputs["render"]["depths"]
    sizes = preparation.view_sizes(job.data.scene.views)
    pixels = _n_pixels(sizes)
    # Of its content, that the render stage or its look-up has just checked, the header is read.
    book = StoredArrays(store.locate(artifact))
    found = {name: book.shape(name) for name in book}
    expected = {"expected": (pixels,), "median": (pixels,), "sizes": sizes.shape}
    if found != expected or not np.array_equal(book["sizes"], sizes):
        raise StoreError(
            f"depth book {artifact.path} holds {found} (accepted: {expected}, the cameras' sizes)"
        )
    return StageOutput({"depths": artifact}, {"n_views": len(sizes)})


def compute_masks(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Cut every view into patches."""
    opened = OpenBooks(store, inputs)
    book = preparation.segment_views(
        opened.views,
        opened.depths,
        job.data.scene.views,
        job.tools.models.segmenter,
        lambda views: opened.let_go_after_each(job.track(views, "masks")),
    )
    artifact = store.put_arrays("patch_book", book.to_arrays())
    return StageOutput({"patches": artifact}, {"n_patches": len(book)})


def compute_encode(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Encode every patch: the Semantic Vector Book."""
    opened = OpenBooks(store, inputs)
    book = preparation.encode_patches(
        opened.views,
        opened.depths,
        job.data.scene.views,
        opened.patches,
        job.tools.models.encoder,
        lambda views: opened.let_go_after_each(job.track(views, "encode")),
    )
    artifact = store.put_arrays("semantic_vectors", {"features": book.features})
    return StageOutput({"features": artifact}, {"c": int(book.features.shape[1])})


def compute_index(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """The method's own part of the preparation; the paper's has none."""
    method = build_method(job.method, job.tools)
    arrays = method.index(job.data.scene, OpenBooks(store, inputs).all)
    return StageOutput({"index": store.put_arrays("index", arrays)}, {"arrays": sorted(arrays)})


def compute_query(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """RFL: localise every query."""
    method, scene = build_method(job.method, job.tools), job.data.scene
    opened = OpenBooks(store, inputs)
    books = opened.all
    shared = method.share(scene, books, job.queries)
    places, times = {}, QueryTimes(shared)
    for query in opened.let_go_after_each(job.track(job.queries, "query")):
        place = times.time(query.id, partial(method.locate, scene, books, query, shared))
        places[query.id] = pack_localization(place)
    artifact = store.put_json("localizations", places)
    detail = {"seconds": times.seconds, "shared_seconds_each": times.shared_each}
    return StageOutput({"localizations": artifact}, detail)


def compute_segment(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Segment every query's target, given where it is."""
    method, scene = build_method(job.method, job.tools), job.data.scene
    opened = OpenBooks(store, inputs)
    books = opened.all
    places = store.load_json(inputs["query"]["localizations"])
    shared = method.share(scene, books, job.queries)
    groundings, pictures, times = [], [], QueryTimes(shared)
    for query in opened.let_go_after_each(job.track(job.queries, "segment")):
        place = unpack_localization(places[query.id])
        segment = partial(method.segment, scene, books, place, query, shared)
        grounding = times.time(query.id, segment)
        pictures.append(small_pictures(grounding))
        groundings.append(without_pictures(grounding))
    seconds = {
        query: grounding.seconds | {"segment": own}
        for grounding, (query, own) in zip(groundings, times.seconds.items(), strict=True)
    }
    arrays = pack_groundings(groundings, len(scene.gaussians), pictures)
    artifact = store.put_arrays("groundings", arrays)
    detail = {"seconds": seconds, "shared_seconds_each": times.shared_each}
    return StageOutput({"groundings": artifact}, detail)


def compute_evaluate(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Score every query, draw it, and gather the evidence for it."""
    groundings = store.load_arrays(inputs["segment"]["groundings"])
    answers = unpack_answers(groundings)
    scores = score_scene(job.data, job.queries, answers, job.tools.renderer)
    artifacts = {"rows": store.put_json("rows", scores.rows)}
    for query, answer in job.track(list(zip(job.queries, answers, strict=True)), "evaluate"):
        own = [row for row in scores.rows if row["query"] == query.id]
        picture = draw_query(job.data, query, answer, own, job.tools.renderer)
        artifacts[f"picture.{query.id}"] = store.put_bytes("picture", picture, ".png")
    if config["evidence"]:
        has_books = inputs["render"] != NO_BOOKS
        opened = OpenBooks(store, inputs)
        evidence = gather_evidence(
            job.data,
            job.queries,
            groundings,
            store.load_json(inputs["query"]["localizations"]),
            opened.views if has_books else None,
            opened.patches if has_books else None,
            job.tools.renderer,
        )
        content = evidence.model_dump_json().encode()
        artifacts["evidence"] = store.put_bytes("evidence", content, ".json")
    left_out = {"unlabelled": scores.unlabelled, "left_out": scores.left_out}
    return StageOutput(artifacts, left_out)


def _n_pixels(sizes: NDArray[np.int32]) -> int:
    """P: pixels of all views together."""
    return int(sizes.prod(axis=1, dtype=np.int64).sum())

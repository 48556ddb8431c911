"""Grounding in one scene of one's own, through the same cached stages as a benchmark."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from prefect import flow

from datasets.base import SceneData
from flows.progress import Progress
from flows.scene import make_job
from gvr_core.atomic import atomic_write
from gvr_core.methods import MethodConfig
from gvr_core.scene import Query
from gvr_core.splat_io import write_ply
from tasks.groundings import Answer, unpack_answers
from tasks.stages import run_stages
from tasks.store import Store


@dataclass(frozen=True)
class OwnAnswer:
    """The answer to one question, and the files that hold it."""

    text: str
    found: bool
    n_flagged: int
    location: tuple[float, ...] | None
    files: tuple[Path, ...]


@flow(name="ground", validate_parameters=False)
def ground_own(
    data: SceneData, method: str, out: Path, store: Path, progress: bool = False
) -> list[OwnAnswer]:
    """Ground every query of a scene of one's own.

    For each query the folder ``out`` gets a picture with the target dyed red (``.png``), the
    flags (N,) of its Gaussians (``.npy``), and where something was found the target alone
    (``.ply``).

    Args:
        data: From :func:`datasets.own.own_scene`.
        method: Name of the method.
        out: Folder of the files; made where missing.
        store: Root of the artifact store.
        progress: Show progress bars.

    Raises:
        ConfigError: for a method that is not known.
        ModelError: for weights that are missing or wrong.
    """
    config = MethodConfig(method=method)
    with Progress(shown=progress) as bars:
        job = make_job(data, config, Store(store), progress=bars)
        runs = run_stages(job)
    given = unpack_answers(job.store.load_arrays(runs["segment"]["groundings"]))
    return [
        _export(data, query, answer, out, job.store.path(runs["evaluate"][f"picture.{query.id}"]))
        for query, answer in zip(job.queries, given, strict=True)
    ]


def _export(data: SceneData, query: Query, answer: Answer, out: Path, picture: Path) -> OwnAnswer:
    stem = out / query.id
    flags = io.BytesIO()
    np.save(flags, answer.flags, allow_pickle=False)
    files = [
        _write(stem.with_suffix(".png"), picture.read_bytes()),
        _write(stem.with_suffix(".npy"), flags.getvalue()),
    ]
    if answer.found:
        write_ply(stem.with_suffix(".ply"), data.scene.gaussians.subset(answer.flags))
        files.append(stem.with_suffix(".ply"))
    place = None if answer.location is None else tuple(float(x) for x in answer.location)
    return OwnAnswer(query.text, answer.found, int(answer.flags.sum()), place, tuple(files))


def _write(path: Path, data: bytes) -> Path:
    with atomic_write(path) as stream:
        stream.write(data)
    return path

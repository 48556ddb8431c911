"""Grounding in one scene of one's own, through the same cached stages as a benchmark."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from prefect import flow

from datasets.own import own_scene
from flows.progress import Progress
from flows.scene import make_job, run_stages
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.atomic import atomic_write
from gvr_core.errors import ConfigError
from gvr_core.methods import MethodConfig
from gvr_core.ply_io import write_ply
from tasks.groundings import unpack_answers
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
def ground_flow(
    splat: str,
    cameras: str,
    texts: Sequence[str],
    method: str,
    out: str,
    max_views: int | None,
    store: str,
    progress: bool,
) -> list[OwnAnswer]:
    """Ground texts in a splat file; see :func:`ground_own`."""
    data = own_scene(Path(splat), Path(cameras), texts, max_views)
    suite = SuiteConfig(
        name="ground",
        datasets=(DatasetChoice(name="gallery"),),
        methods=(MethodConfig(method=method),),
    )
    with Progress(shown=progress) as bars:
        job = make_job(data, suite, suite.methods[0], Store(store), bars)
        runs = run_stages(job)
    given = unpack_answers(job.store.load_arrays(runs["segment"]["groundings"]))
    answers = []
    for query, answer in zip(job.queries, given, strict=True):
        stem = Path(out) / query.id
        picture = job.store.load_bytes(runs["evaluate"][f"picture.{query.id}"])
        flags = io.BytesIO()
        np.save(flags, answer.flags, allow_pickle=False)
        files = [
            _write(stem.with_suffix(".png"), picture),
            _write(stem.with_suffix(".npy"), flags.getvalue()),
        ]
        if answer.found:
            target = stem.with_suffix(".ply")
            write_ply(target, data.scene.gaussians.subset(answer.flags))
            files.append(target)
        place = None if answer.location is None else tuple(float(x) for x in answer.location)
        answers.append(
            OwnAnswer(query.text, answer.found, int(answer.flags.sum()), place, tuple(files))
        )
    return answers


def ground_own(
    splat: Path,
    cameras: Path,
    texts: Sequence[str],
    method: str,
    out: Path,
    max_views: int | None,
    store: Path,
    progress: bool = False,
) -> list[OwnAnswer]:
    """Ground texts in a splat file.

    For each text the folder ``out`` gets a picture with the target dyed red (``.png``), the
    flags (N,) of its Gaussians (``.npy``), and where something was found the target alone
    (``.ply``).

    Args:
        splat: A .ply or .splat file.
        cameras: A cameras.json, or a folder with a COLMAP model.
        texts: What to find.
        method: Name of the method.
        out: Folder of the files; made where missing.
        max_views: Use only so many cameras, evenly spaced; None uses all.
        store: Root of the artifact store.
        progress: Show progress bars.

    Raises:
        InputError: for files or names that cannot be used; nothing is written then.
    """
    if max_views is not None and max_views < 1:
        raise ConfigError(f"--max-views is {max_views}", accepted="1 or more")
    return ground_flow(
        str(splat), str(cameras), list(texts), method, str(out), max_views, str(store), progress
    )


def _write(path: Path, data: bytes) -> Path:
    with atomic_write(path) as stream:
        stream.write(data)
    return path

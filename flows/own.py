"""Grounding in one scene of one's own, through the same cached stages as a benchmark."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from prefect import flow

from datasets.base import SceneData
from flows.progress import Progress
from flows.scene_setup import make_job
from gvr_core.atomic import atomic_write, file_digest
from gvr_core.errors import ConfigError, SplatFormatError
from gvr_core.exports import RED, RGB, write_dyed, write_indices, write_target, write_without
from gvr_core.methods import MethodConfig
from gvr_core.models.registry import ModelConfig
from gvr_core.scene import Query
from tasks.groundings import Answer, unpack_answers
from tasks.scene_job import SceneJob
from tasks.stages import run_stages
from tasks.store import Store

SUMMARY = "answers.json"
"""All answers of a call, in the folder of its files."""

INDICES, PICTURE = "indices", "picture"
"""What the files that every query gets are called in the summary, next to the kinds of export."""


@dataclass(frozen=True)
class OwnAnswer:
    """The answer to one question, and the files that hold it."""

    id: str
    """``q0`` for the first question, and so on; the files' names begin with it."""
    text: str
    found: bool
    confidence: float
    """How sure the method is; comparable only within one method and its models."""
    location: tuple[float, ...] | None
    """(3,) world frame; the best guess where nothing was found, None without any."""
    count: int
    """Flagged Gaussians."""
    files: dict[str, str]
    """``indices``, ``picture`` or a kind of export -> name of the file."""


@flow(name="ground", validate_parameters=False)
def ground_own(
    data: SceneData,
    splat: Path,
    method: str,
    out: Path,
    store: Path | str,
    exports: Sequence[str] = ("target",),
    dye: RGB = RED,
    progress: bool = False,
    models: ModelConfig | None = None,
) -> list[OwnAnswer]:
    """Ground every query of a scene of one's own, and write the answers.

    The folder ``out`` gets, for the query with the id ``q0`` (then ``q1``, ...):

    * ``q0.indices.npy``: (n,) int64, ascending: the target's rows in the splat file, from 0;
    * ``q0.png``: the target dyed red in the view that shows most of it;
    * ``q0.target.ply``, ``q0.without.ply``, ``q0.dyed.ply``: the exports that were asked for
      (:data:`gvr_core.exports.EXPORTS`), each only where it says something: none where nothing
      was found, and no ``without`` where nothing would be left. What an earlier call left under
      such a name is removed, so that it cannot pass for this answer.

    and last ``answers.json``: the scene, the method, and every :class:`OwnAnswer`.

    Args:
        data: From :func:`datasets.own.own_scene`.
        splat: The file that ``data`` was read from; exports copy its rows.
        method: Name of the method.
        out: Folder of the files; made where missing.
        store: Root of the artifact store, or its URL.
        exports: Kinds of export.
        dye: Colour of the target in ``dyed``, channels in [0, 1].
        progress: Show progress bars.
        models: Which models; the onboard ones where none are given.

    Raises:
        ConfigError: for a method that is not known, or a file that cannot be written.
        ModelError: for weights that are missing or wrong.
        SplatFormatError: if the splat file changed meanwhile.
    """
    config = MethodConfig(method=method)
    with Progress(shown=progress) as bars:
        job = make_job(data, config, Store(store), models, progress=bars)
        runs = run_stages(job)
    given = unpack_answers(job.store.load_arrays(runs["segment"]["groundings"]))
    if file_digest(splat) != data.digests["gaussians"]:
        raise SplatFormatError(
            "the file changed while it was grounded in", path=splat, accepted="the file as read"
        )
    writers: dict[str, Callable[..., None]] = {
        "target": write_target,
        "without": write_without,
        "dyed": partial(write_dyed, rgb=dye),
    }
    chosen = {kind: writers[kind] for kind in dict.fromkeys(exports)}
    answers = []
    try:
        for query, answer in zip(job.queries, given, strict=True):
            picture = job.store.path(runs["evaluate"][f"picture.{query.id}"])
            answers.append(_write_answer(query, answer, splat, picture, out, chosen))
        _write_summary(out, splat, job, answers)
    except OSError as error:
        raise ConfigError(
            f"the answers cannot be written: {error.strerror or error}",
            path=out,
            accepted="a folder that can be written, with room on its disk",
        ) from error
    return answers


def check_out(data: SceneData, splat: Path, out: Path, exports: Sequence[str]) -> None:
    """Refuse a folder that cannot take the answers, before anything is computed for it.

    Args:
        data: The scene and its queries.
        splat: The scene's file, which no export may replace.
        out: The folder; it need not exist.
        exports: Kinds of export.

    Raises:
        ConfigError: saying what is wrong with the folder.
    """
    known = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not known.is_dir() or not os.access(known, os.W_OK | os.X_OK):
        raise ConfigError(
            "--out cannot be written: "
            + ("no permission" if known.is_dir() else f"{known} is no folder"),
            path=out,
            accepted="a folder that can be written, or a new one",
        )
    for path in (_ply(out, query, kind) for query in data.queries for kind in exports):
        if path.exists() and path.samefile(splat):
            raise ConfigError(
                f"--out: the scene itself would be replaced by the export {path.name}",
                path=out,
                accepted="another folder",
            )


def _ply(out: Path, query: Query, kind: str) -> Path:
    return out / f"{query.id}.{kind}.ply"


def _write_answer(
    query: Query,
    answer: Answer,
    splat: Path,
    picture: Path,
    out: Path,
    writers: dict[str, Callable[..., None]],
) -> OwnAnswer:
    """Write the files of one query."""
    flags = answer.flags
    files = {INDICES: f"{query.id}.indices.npy", PICTURE: f"{query.id}.png"}
    write_indices(out / files[INDICES], flags)
    _write(out / files[PICTURE], picture.read_bytes())
    for kind, write in writers.items():
        path = _ply(out, query, kind)
        if answer.found and flags.any() and not (kind == "without" and flags.all()):
            write(path, splat, flags)
            files[kind] = path.name
        else:
            path.unlink(missing_ok=True)
    place = None if answer.location is None else tuple(float(x) for x in answer.location)
    return OwnAnswer(
        query.id, query.text, answer.found, answer.confidence, place, int(flags.sum()), files
    )


def _write_summary(out: Path, splat: Path, job: SceneJob, answers: Sequence[OwnAnswer]) -> None:
    summary = {
        "splat": splat.name,
        "sha256": job.data.digests["gaussians"],
        "n_gaussians": len(job.data.scene.gaussians),
        "method": job.method.method,
        "models": job.model_names(),
        "answers": [asdict(answer) for answer in answers],
    }
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    _write(out / SUMMARY, f"{text}\n".encode())


def _write(path: Path, data: bytes) -> None:
    with atomic_write(path) as stream:
        stream.write(data)

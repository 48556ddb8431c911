"""What must hold before a result is written."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gvr_core.errors import GVRError, InputError
from reports.record import Result, Row

PICTURE_NAME = re.compile(r"pictures(/[A-Za-z0-9_-][A-Za-z0-9_.-]{0,199})+")


class ResultError(InputError):
    """A result that cannot be written as asked, or a result's folder that cannot be read."""


class ResultWriteError(GVRError):
    """The disk does not take a result: it is full, or may not be written."""


def check_consistent(
    folder: Path, result: Result, rows: Sequence[Row], pictures: Mapping[str, Path | bytes]
) -> None:
    """Refuse a result that would be misread later.

    Args:
        folder: Where it is to be written; only named in the errors.
        result: The run.
        rows: Its rows.
        pictures: Path in the folder -> the picture.

    Raises:
        ResultError: for a number that is not finite, a scene and method that is listed twice, a
            reference to a method that is not there, two rows with the same key, a row of a scene
            that the result does not list, or pictures that do not fit the result.
    """
    for what, record in (("result", result), *((f"rows[{i}]", r) for i, r in enumerate(rows))):
        for place in _not_finite(record.model_dump(), what):
            raise ResultError(
                "a number is not finite",
                path=folder,
                place=place,
                accepted="finite numbers; what is undefined is left out",
            )
    _check_lines(folder, result)
    scenes = {(s.dataset, s.scene, s.method) for s in result.scenes}
    seen: dict[tuple[str | None, ...], int] = {}
    for i, row in enumerate(rows):
        if (row.dataset, row.scene, row.method) not in scenes:
            raise ResultError(
                f"a row of ({row.dataset}, {row.scene}, {row.method})",
                path=folder,
                place=f"rows[{i}]",
                accepted="rows of the result's own scenes and methods",
            )
        key = (row.dataset, row.scene, row.method, row.query, row.view, row.protocol)
        if key in seen:
            raise ResultError(
                f"the row of {key} is there twice",
                path=folder,
                place=f"rows[{seen[key]}] and rows[{i}]",
                accepted="one row per dataset, scene, method, query, view and protocol",
            )
        seen[key] = i
    for name in pictures:
        if not PICTURE_NAME.fullmatch(name):
            raise ResultError(
                f"a picture named {name!r}", path=folder, accepted="pictures/<name>, plain letters"
            )
    for scene in result.scenes:
        for query in scene.queries:
            if query.picture is not None and query.picture not in pictures:
                raise ResultError(
                    f"no picture {query.picture!r} was given",
                    path=folder,
                    place=f"query {query.query} of ({scene.dataset}, {scene.scene})",
                    accepted="every picture that the result names",
                )


def _check_lines(folder: Path, result: Result) -> None:
    first: dict[tuple[str, str, str], int] = {}
    for i, scene in enumerate(result.scenes):
        key = (scene.dataset, scene.scene, scene.method)
        if first.setdefault(key, i) < i:
            raise ResultError(
                f"{key} is there twice",
                path=folder,
                place=f"scenes[{first[key]}] and scenes[{i}]",
                accepted="one result per dataset, scene and method",
            )
    for i, scene in enumerate(result.scenes):
        against = (scene.dataset, scene.scene, scene.reference)
        if scene.reference is not None and (
            scene.reference == scene.method or against not in first
        ):
            raise ResultError(
                f"{scene.method!r} is compared with {scene.reference!r}",
                path=folder,
                place=f"scenes[{i}].reference",
                accepted="another method that ran on the same scene",
            )


def _not_finite(value: Any, place: str) -> Iterator[str]:
    if isinstance(value, float) and not math.isfinite(value):
        yield place
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _not_finite(inner, f"{place}.{key}")
    elif isinstance(value, (list, tuple)):
        for i, inner in enumerate(value):
            yield from _not_finite(inner, f"{place}[{i}]")

"""The small files of the native layout: names, ``scene.json``, ``queries.json``, labels."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from gvr_core.errors import DatasetError
from gvr_core.npy_files import mapped_npy
from gvr_core.scene import Query
from gvr_core.untrusted import parse_json, read_regular

PLY = Path("point_cloud/iteration_30000/point_cloud.ply")
MODEL = Path("sparse/0")
"""Where the splat and the COLMAP model lie in a scene's folder."""

NAME_RULE = "1 to 64 of A-Z a-z 0-9 space _ -, without a space at either end, no device name"

_NAME = re.compile(r"[A-Za-z0-9_-](?:[A-Za-z0-9 _-]{0,62}[A-Za-z0-9_-])?", re.ASCII)
_DEVICE = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])", re.IGNORECASE)


class SceneFile(BaseModel):
    """``scene.json``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["gvr-scene"] = "gvr-scene"
    version: Literal[1] = 1
    """Raised whenever the layout changes."""
    dataset: str = Field(min_length=1, max_length=64)
    """The data set that the scene was made for."""
    name: str
    """The scene's name."""
    up: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None
    """Up direction, world frame, any length above zero; null where nobody states it, and methods
    take it from the cameras."""
    objects: tuple[str, ...]
    """Names of the labelled objects; ``labels.npy`` holds indices into them."""
    test_views: tuple[str, ...]
    """Names of the views with masks; all the others are knowledge views."""
    provenance: str
    """Where the content comes from, and under which licence."""
    recipe: str = ""
    """sha256 of what a generated scene was made from; empty for others."""


def check_name(name: str, kind: str, path: Path, place: str | None = None) -> str:
    """A name that becomes a file name, on any system.

    Args:
        name: Of a scene, a view or an object.
        kind: Which of these, for the message.
        path: The file or folder that it stands in, for the message.
        place: Where in the file, for the message.

    Raises:
        DatasetError: unless it is as `NAME_RULE` says.
    """
    if not _NAME.fullmatch(name) or _DEVICE.fullmatch(name):
        raise DatasetError(
            f"the {kind} name {name[:100]!r} cannot be a file name",
            path=path,
            place=place,
            accepted=NAME_RULE,
        )
    return name


def check_distinct(names: Sequence[str], kind: str, path: Path, place: str | None = None) -> None:
    """Refuse two names that one file name would stand for, in upper or lower case.

    Raises:
        DatasetError: naming the second of them.
    """
    seen: dict[str, str] = {}
    for name in names:
        if name.lower() in seen:
            raise DatasetError(
                f"the {kind} {name!r} is there twice"
                if seen[name.lower()] == name
                else f"the {kind}s {seen[name.lower()]!r} and {name!r} differ only in case",
                path=path,
                place=place,
                accepted=f"{kind}s with different names",
            )
        seen[name.lower()] = name


def read_scene_file(path: Path) -> SceneFile:
    """``scene.json``, checked.

    Raises:
        DatasetError: naming the line or key that is not as the layout says.
    """
    try:
        record = SceneFile.model_validate(_read_json(path))
    except ValidationError as error:
        raise validation_error(error, path) from error
    check_scene_file(record, path)
    return record


def check_scene_file(record: SceneFile, path: Path) -> None:
    """What the types of `SceneFile` cannot say: usable and distinct names, an up direction.

    Raises:
        DatasetError: naming the key.
    """
    check_name(record.name, "scene", path, "name")
    for key, names in (("objects", record.objects), ("test_views", record.test_views)):
        kind = "object" if key == "objects" else "view"
        for index, name in enumerate(names):
            check_name(name, kind, path, f"{key}[{index}]")
        check_distinct(names, kind, path, key)
    if record.up is not None and not any(abs(x) > 1e-9 for x in record.up):
        raise DatasetError(
            "no direction", path=path, place="up", accepted="a vector not zero, or null"
        )


def read_queries(path: Path, objects: Sequence[str]) -> tuple[Query, ...]:
    """``queries.json``: a list of queries whose targets are among the objects.

    Raises:
        DatasetError: naming the line, or the number of the query and its key.
    """
    content = _read_json(path)
    if not isinstance(content, list):
        raise DatasetError(
            f"{type(content).__name__} at the top", path=path, accepted="a list of queries"
        )
    queries = []
    for index, item in enumerate(content):
        try:
            queries.append(Query.model_validate(item))
        except ValidationError as error:
            raise validation_error(error, path, f"[{index}]") from error
    check_queries(queries, objects, path)
    return tuple(queries)


def check_queries(queries: Sequence[Query], objects: Sequence[str], path: Path) -> None:
    """Distinct ids, targets that exist, and nothing both absent and meant.

    Raises:
        DatasetError: naming the number of the query and its key.
    """
    seen = set()
    for index, query in enumerate(queries):
        if query.id in seen:
            raise DatasetError(
                f"the query id {query.id!r} is there twice",
                path=path,
                place=f"[{index}].id",
                accepted="each id once",
            )
        seen.add(query.id)
        if query.target is not None and query.target not in objects:
            raise DatasetError(
                f"query {query.id!r} means {query.target!r}, which is no object of the scene",
                path=path,
                place=f"[{index}].target",
                accepted=", ".join(objects) or "null: the scene has no objects",
            )
        if query.absent and query.target is not None:
            raise DatasetError(
                f"query {query.id!r} is absent, and has a target",
                path=path,
                place=f"[{index}].absent",
                accepted="absent only where target is null",
            )


def read_labels(path: Path, n: int, objects: int) -> NDArray[np.int16]:
    """``labels.npy``, checked; nothing in it is ever run.

    Args:
        path: The file.
        n: Number of Gaussians.
        objects: Number of objects.

    Returns:
        (N,) int16.

    Raises:
        DatasetError: for a file that is no array of that kind.
    """
    try:
        labels = mapped_npy(path)
    except (OSError, ValueError) as error:
        raise DatasetError(
            f"no array: {error}"[:200], path=path, accepted="an .npy file without pickle"
        ) from error
    check_labels(labels, n, objects, path)
    return np.array(labels)


def check_labels(labels: NDArray[np.int16], n: int, objects: int, path: Path) -> None:
    """One label for each Gaussian: an object's index, or -1.

    Raises:
        DatasetError: for another length, dtype or range.
    """
    if labels.shape != (n,) or labels.dtype != np.int16:
        raise DatasetError(
            f"labels of shape {labels.shape} and dtype {labels.dtype}",
            path=path,
            accepted=f"({n},) int16: one label for each Gaussian",
        )
    wrong = np.flatnonzero((labels < -1) | (labels >= objects))
    if wrong.size:
        raise DatasetError(
            f"label {labels[wrong[0]]}",
            path=path,
            place=f"Gaussian {wrong[0]}",
            accepted=f"-1 to {objects - 1}",
        )


def validation_error(error: ValidationError, path: Path, prefix: str = "") -> DatasetError:
    """A complaint of pydantic as an error of this project: file, key, what is wrong.

    A misspelt key is both unknown and, under its right name, missing: the former says more.
    """
    errors = error.errors()
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    place = prefix
    # "<...>" is no key: it tells which kind of table pydantic took a value for
    for part in (p for p in first["loc"] if not str(p).startswith("<")):
        place += f"[{part}]" if isinstance(part, int) else f".{part}" if place else str(part)
    if first["type"] == "extra_forbidden":
        return DatasetError("an unknown key", path=path, place=place, accepted="the layout's keys")
    message = first["msg"].removeprefix("Value error, ")
    if not isinstance(first["input"], dict):
        message = f"{str(first['input'])[:80]!r}: {message}"
    return DatasetError(message, path=path, place=place or None)


def _read_json(path: Path) -> Any:
    """The content of a JSON file."""
    try:
        return parse_json(read_regular(path).decode("utf-8"))
    except FileNotFoundError as error:
        raise DatasetError("missing file", path=path) from error
    except json.JSONDecodeError as error:
        raise DatasetError(
            f"not JSON: {error.msg}", path=path, place=f"line {error.lineno}"
        ) from error
    except (ValueError, OSError) as error:
        raise DatasetError(f"cannot be read as JSON: {error}"[:200], path=path) from error

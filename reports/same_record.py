"""Whether two results say the same, but for when, where and how fast they were made."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gvr_core.atomic import file_digest
from reports.result_io import ROWS_FILE, read_result

OWN_TOP = ("run_id", "created", "wall_seconds", "environment", "started_by", "system")
"""Fields of a result that each run has of its own."""
OWN_SCENE = ("prepare_seconds", "query_seconds", "attempts")
OWN_STAGE = (
    *("seconds", "cpu_seconds", "peak_bytes", "peak_of", "state"),
    *("damage", "fetched", "unshared"),
)
OWN_QUERY = ("seconds",)


def differences(first: Path, second: Path) -> list[str]:
    """What differs between two results' folders: fields of the record, rows, pictures, evidence.

    All but the record is compared byte by byte. Of the record all is compared but times, peak
    memory, whether a stage was cached and what was found damaged then, how often a scene was
    tried, the run's own names and who started it, its environment and the load of its machine,
    and the ``run`` table of its configuration, which says where it was computed.

    Args:
        first: Folder of a result.
        second: Folder of another.

    Returns:
        Places that differ; none where the two say the same.

    Raises:
        ResultError: for a folder that is no result.
    """
    found = list(_differing("result", comparable(first), comparable(second)))
    if (first / ROWS_FILE).read_bytes() != (second / ROWS_FILE).read_bytes():
        found.append(ROWS_FILE)
    pictures = [_pictures(folder) for folder in (first, second)]
    names = sorted(pictures[0] | pictures[1])
    found += [name for name in names if pictures[0].get(name) != pictures[1].get(name)]
    return found


def comparable(folder: Path) -> dict[str, Any]:
    """The record of a result without what each run has of its own."""
    result, _ = read_result(folder)
    record = result.model_dump(mode="json", exclude=set(OWN_TOP))
    record["config"].pop("run", None)
    for scene in record["scenes"]:
        _drop(scene, OWN_SCENE)
        for stage in scene["stages"]:
            _drop(stage, OWN_STAGE)
        for query in scene["queries"]:
            _drop(query, OWN_QUERY)
    return record


def _drop(record: dict[str, Any], names: tuple[str, ...]) -> None:
    for name in names:
        del record[name]


def _pictures(folder: Path) -> dict[str, str]:
    places = (folder / "pictures", folder / "evidence")
    paths = (path for place in places for path in place.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in paths}


def _differing(place: str, one: Any, other: Any) -> Iterator[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in one.keys() | other.keys():
            yield from _differing(f"{place}.{key}", one.get(key), other.get(key))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for i, pair in enumerate(zip(one, other, strict=True)):
            yield from _differing(f"{place}[{i}]", *pair)
    elif one != other or type(one) is not type(other):
        yield place

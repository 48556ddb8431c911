"""Write and read the folder of a result: written whole or not at all, and never overwritten."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticSerializationError

from gvr_core.atomic import file_digest, why_not_written
from gvr_core.errors import StoreError
from gvr_core.locks import file_lock
from reports.record import SCHEMA_VERSION, Result, Row
from reports.result_check import ResultError, ResultWriteError, check_consistent

RESULT_FILE = "result.json"
ROWS_FILE = "rows.jsonl"
TABLE_FILE = "rows.parquet"
SUMS_FILE = "SHA256SUMS"
_UNFINISHED = ".tmp"

_Record = TypeVar("_Record", bound=BaseModel)


def new_run_id() -> str:
    """A run id that sorts by time: UTC time to the second, and 24 random bits."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(3)}"


def write_result(
    folder: Path,
    result: Result,
    rows: Sequence[Row],
    pictures: Mapping[str, Path | bytes] | None = None,
) -> Path:
    """Write a result's folder; it appears complete, under its own name, or not at all.

    Args:
        folder: The folder to make; its parents are made too.
        result: The run.
        rows: Its rows, in the order in which they are to be kept.
        pictures: Path relative to ``folder`` (``pictures/<name>.png``) -> a file, or its bytes.

    Returns:
        ``folder``.

    Raises:
        ResultError: if ``folder`` exists; for a number that is not finite, two rows with the same
            key, a row of a scene that the result does not list, or a picture that the result
            names but ``pictures`` lacks.
        ResultWriteError: if the disk is full, or may not be written.
    """
    pictures = {} if pictures is None else pictures
    folder = Path(folder)
    if folder.exists() or folder.is_symlink():
        raise ResultError(
            "a result is here already, and results are never overwritten",
            path=folder,
            accepted="a folder that does not exist yet",
        )
    check_consistent(folder, result, rows, pictures)
    # A sibling is on the same file system, so that the rename is atomic.
    building = folder.parent / f".{folder.name}.{secrets.token_hex(4)}{_UNFINISHED}"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _sweep(folder.parent)
        # Writers share this lock; whoever sweeps takes it alone.
        with file_lock(folder.parent, shared=True):
            try:
                _build(building, result, rows, pictures)
                # A rename onto a folder that another writer has filled meanwhile fails.
                building.rename(folder)
            finally:
                shutil.rmtree(building, ignore_errors=True)
        _fsync(folder.parent)
    except PydanticSerializationError as error:
        raise ResultError(f"cannot write the result: {error}", path=folder) from error
    except OSError as error:
        if folder.exists():
            raise ResultError(
                f"cannot write the result, as another writer was faster: {error}", path=folder
            ) from error
        reason = why_not_written(error, folder.parent)
        raise ResultWriteError(f"{folder}: the result cannot be written: {reason}") from error
    return folder


def _build(
    building: Path, result: Result, rows: Sequence[Row], pictures: Mapping[str, Path | bytes]
) -> None:
    """Write all files of a result into a new folder, and wait until they are on the disk."""
    building.mkdir(parents=True)
    _write_text(building / RESULT_FILE, _json(result, indent=1) + "\n")
    _write_text(building / ROWS_FILE, "".join(_json(row) + "\n" for row in rows))
    pq.write_table(rows_table(rows), building / TABLE_FILE)
    for name, source in pictures.items():
        target = building / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(source if isinstance(source, bytes) else _picture(source))
    names = sorted(p.relative_to(building).as_posix() for p in _files(building))
    sums = "".join(f"{file_digest(building / name)}  {name}\n" for name in names)
    _write_text(building / SUMS_FILE, sums)
    for path in [*_files(building), *_folders(building)]:
        _fsync(path)


def _picture(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ResultError(f"a picture cannot be read: {error}", path=path) from error


def _sweep(root: Path) -> None:
    """Remove what killed writers left unfinished, unless somebody is writing just now."""
    try:
        with file_lock(root, timeout=0):
            for left in root.glob(f".*{_UNFINISHED}"):
                shutil.rmtree(left, ignore_errors=True)
    except StoreError:
        return  # locked: the next writer sweeps


def read_result(folder: Path) -> tuple[Result, list[Row]]:
    """Read a result and its rows, checked against the sums written with them.

    Raises:
        ResultError: for a folder that is no result, a damaged or edited file, or a result of a
            newer schema; it names the file, the place in it, and what is accepted.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ResultError("no such folder", path=folder, accepted="the folder of a result")
    result_text = _read_text(folder / RESULT_FILE)
    rows_text = _read_text(folder / ROWS_FILE)
    content = _parse_json(folder / RESULT_FILE, result_text)
    _check_version(folder / RESULT_FILE, content)
    result = _validate(Result, folder / RESULT_FILE, content)
    rows = [
        _validate(Row, folder / ROWS_FILE, _parse_json(folder / ROWS_FILE, line, number), number)
        for number, line in enumerate(rows_text.removesuffix("\n").split("\n"), start=1)
        if rows_text
    ]
    # After the parsing: a torn line is then reported with its number, and only damage that still
    # parses (a lost last line, an edited value) is left for the sums to find.
    _check_sums(folder, (RESULT_FILE, ROWS_FILE))
    return result, rows


def check_files(folder: Path) -> None:
    """Check every file of a result, the pictures too, against the sums written with them.

    Raises:
        ResultError: for a file that is missing, or was changed after it was written.
    """
    path = folder / SUMS_FILE
    names = [line.partition("  ")[2] for line in _read_text(path).splitlines()]
    for name in names:
        if not (folder / name).is_file():
            raise ResultError("the file is missing", path=folder / name)
    _check_sums(folder, names)


def list_results(root: Path) -> list[Path]:
    """The results' folders directly under ``root``, oldest name first; none if it is missing."""
    if not root.is_dir():
        return []
    return sorted(path.parent for path in root.glob(f"[!.]*/{RESULT_FILE}"))


def rows_table(rows: Sequence[Row]) -> pa.Table:
    """The rows as a table: the fields of `Row`, each metric as a column ``metric.<name>``.

    A metric that a row leaves out is null.
    """
    keys = [name for name in Row.model_fields if name != "metrics"]
    metrics = sorted({name for row in rows for name in row.metrics})
    columns: dict[str, pa.Array] = {}
    for key in keys:
        kind = pa.bool_() if key == "absent" else pa.string()
        columns[key] = pa.array([getattr(row, key) for row in rows], type=kind)
    for name in metrics:
        values = [row.metrics.get(name) for row in rows]
        columns[f"metric.{name}"] = pa.array(values, type=pa.float64())
    return pa.table(columns)


def _json(record: BaseModel, indent: int | None = None) -> str:
    return json.dumps(record.model_dump(mode="json"), allow_nan=False, indent=indent)


def _parse_json(path: Path, text: str, line: int | None = None) -> Any:
    def refuse(constant: str) -> None:
        raise ValueError(f"the number {constant}")

    try:
        return json.loads(text, parse_constant=refuse)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno if line is None else line}, column {error.colno}"
        raise ResultError(
            f"not JSON: {error.msg}", path=path, place=place, accepted="one whole JSON object"
        ) from error
    except (ValueError, RecursionError) as error:
        raise ResultError(
            f"not JSON: {error}",
            path=path,
            place=None if line is None else f"line {line}",
            accepted="finite numbers",
        ) from error


def _check_version(path: Path, content: Any) -> None:
    version = content.get("schema_version") if isinstance(content, dict) else None
    if version == SCHEMA_VERSION:
        return
    found = f"schema version {version!r}"
    if isinstance(version, int) and version > SCHEMA_VERSION:
        found += ", written by a newer version of this program"
    raise ResultError(found, path=path, place="schema_version", accepted=str(SCHEMA_VERSION))


def _validate(kind: type[_Record], path: Path, content: Any, line: int | None = None) -> _Record:
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        place = where if line is None else f"line {line}" + (f", {where}" if where else "")
        raise ResultError(
            first["msg"], path=path, place=place, accepted=f"the fields of {kind.__name__}"
        ) from error


def _check_sums(folder: Path, names: Sequence[str]) -> None:
    path = folder / SUMS_FILE
    sums = {}
    for number, line in enumerate(_read_text(path).splitlines(), start=1):
        digest, _, name = line.partition("  ")
        if not name:
            raise ResultError(
                "not a sum", path=path, place=f"line {number}", accepted="<sha256>  <file>"
            )
        sums[name] = digest
    for name in names:
        found = file_digest(folder / name)
        if sums.get(name) != found:
            raise ResultError(
                f"the file's sha256 is {found}; it was changed after it was written",
                path=folder / name,
                accepted=sums.get(name, f"a file listed in {SUMS_FILE}"),
            )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ResultError(
            "the file is missing", path=path, accepted="a folder that write_result made"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise ResultError(f"cannot be read: {error}", path=path, accepted="UTF-8 text") from error


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def _folders(folder: Path) -> list[Path]:
    return [*(path for path in folder.rglob("*") if path.is_dir()), folder]


def _fsync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

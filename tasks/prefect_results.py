"""Where Prefect keeps the results of stage tasks: JSON records, and nothing that can run code.

A Prefect result record names the serializer that it is to be read with, and Prefect obeys: a
record that names ``pickle``, or a JSON library or object decoder of somebody's choosing, runs
code in whoever looks for a cached result. This storage reads a record only if it is byte for byte
of the one form that it writes; anything else counts as not there, and is computed again.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any, ClassVar

from prefect.filesystems import WritableFileSystem
from prefect.serializers import JSONSerializer

from gvr_core.untrusted import parse_json, read_regular
from tasks.files import write_atomically
from tasks.records import DIGEST, STAGE_NAME

log = logging.getLogger(__name__)

RESULT_SERIALIZER = JSONSerializer(object_encoder=None, object_decoder=None)
"""Plain ``json``: without hooks that import classes named in the file."""

MAX_RECORD_BYTES = 16 * 2**20
"""A larger file is none of ours: a result names artifacts, and takes a few KB."""

_KEY = re.compile(rf"({STAGE_NAME.pattern})-({DIGEST.pattern})")
_METADATA = {"storage_key", "expiration", "serializer", "prefect_version", "storage_block_id"}


def result_key(stage: str, key: str) -> str:
    """The Prefect cache key of a stage and its key."""
    return f"{stage}-{key}"


class StageResultStorage(WritableFileSystem):
    """Result storage in ``prefect-results/<stage>/<key>.json`` of an artifact store.

    Prefect asks for both blocking and asynchronous methods; the files are below 100 KB, so the
    latter call the former.
    """

    _block_type_name: ClassVar[str] = "GVR stage results"
    _block_type_slug: ClassVar[str] = "gvr-stage-results"

    root: str
    """The artifact store's folder."""

    def read_path(self, path: str, **_: Any) -> bytes:  # type: ignore[override]
        """The record under a key.

        Raises:
            OSError: There is none.
            ValueError: It is not one that this storage wrote.
        """
        content = read_regular(self._file(path), MAX_RECORD_BYTES)
        problem = refuse(content, path)
        if problem is not None:
            raise ValueError(f"result record {path} is refused: {problem}")
        return content

    async def aread_path(self, path: str) -> bytes:
        """As `read_path`."""
        return self.read_path(path)

    def write_path(self, path: str, content: bytes, **_: Any) -> None:  # type: ignore[override]
        """Write the record under a key, whole or not at all.

        A disk that does not take it is no error: the store's own record decides, and this one is
        written again by the next run that wants it.

        Raises:
            ValueError: The record is not of the form that could be read again.
        """
        problem = refuse(content, path)
        if problem is not None:
            raise ValueError(f"result record {path} cannot be stored: {problem}")
        try:
            write_atomically(self._file(path), content, Path(self.root) / "tmp")
        except OSError as error:
            log.warning("Prefect's record of %s is not kept: %s", path[:40], error)

    async def awrite_path(self, path: str, content: bytes) -> None:
        """As `write_path`."""
        self.write_path(path, content)

    def _resolve_path(self, path: str) -> None:
        # Prefect puts what this returns into records and reads it back through other storages;
        # None keeps the key as it is.
        return None

    def _file(self, path: str) -> Path:
        match = _KEY.fullmatch(path)
        if match is None:
            raise ValueError(f"result key {path!r} (accepted: <stage>-<sha256>)")
        file = Path(self.root) / "prefect-results" / match[1] / f"{match[2]}.json"
        if any(step.is_symlink() for step in (file, file.parent, file.parent.parent)):
            raise ValueError(f"result key {path!r}: {file} leads elsewhere by a symbolic link")
        return file


def refuse(content: bytes, key: str) -> str | None:
    """Why a result record must not be handed to Prefect; None for one that may.

    Args:
        content: The record's bytes.
        key: The key that it was asked for with.
    """
    try:
        record = parse_json(content)
    except ValueError:
        return "not JSON"
    if not isinstance(record, dict) or set(record) != {"metadata", "result"}:
        return "not of the form metadata and result"
    metadata, result = record["metadata"], record["result"]
    if not isinstance(metadata, dict) or not set(metadata) <= _METADATA:
        return "metadata of an unknown form"
    if metadata.get("serializer") != RESULT_SERIALIZER.model_dump(mode="json"):
        return f"serializer {metadata.get('serializer')!r}"
    if metadata.get("storage_key") != key or metadata.get("storage_block_id") is not None:
        return "a record of another key or storage"
    if not isinstance(result, str):
        return "a result that is not text"
    try:
        parse_json(result)
    except ValueError:
        return "a result that is not JSON"
    return None

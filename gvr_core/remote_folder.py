"""A folder behind a URL: a few operations over fsspec, each whole or not at all.

Names are relative, checked before they reach fsspec, and cannot lead out of the folder. Content
is copied in pieces and never held in memory as a whole, but for `read` and `write`, which are
for small files.
"""

from __future__ import annotations

import errno
import importlib
import re
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gvr_core.errors import RemoteError, StoreError
from gvr_core.remote_url import check_url, open_url

_STEP = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,254}"
_NAME = re.compile(rf"{_STEP}(/{_STEP}){{0,7}}")

_FOLDERS = {"file", "local", "sftp", "ssh", "ftp", "smb", "webdav", "hdfs", "arrow_hdfs"}
"""Protocols with real folders, which have to be made, and where a file is visible while it is
written; with all others a put makes the whole object or none."""

_S3_PIECES = {"chunksize": 8 * 2**20, "max_concurrency": 4}
_PIECES: dict[str, dict[str, int]] = {"s3": _S3_PIECES, "s3a": _S3_PIECES}
"""What bounds the memory of a transfer, by protocol."""

_TIMES = ("LastModified", "mtime", "last_modified", "updated", "created")


@dataclass(frozen=True)
class Entry:
    """A file in the folder."""

    name: str
    """Relative to the folder, with forward slashes."""
    size: int
    modified: float | None
    """Seconds since the epoch by the other side's clock; None where it does not say."""


class _OtherSizeError(Exception):
    """Ends a download as soon as the other side says how long it is."""


class RemoteFolder:
    """A folder behind a URL.

    All methods raise `RemoteError` where the other side fails or refuses, and `StoreError` for a
    name that cannot be one. It can be sent to another process.

    Args:
        url: The folder.

    Raises:
        ConfigError: A URL that cannot be opened; see `gvr_core.remote_url.check_url`.
    """

    def __init__(self, url: str) -> None:
        self.url = check_url(url)
        self.protocol = self.url.partition("://")[0].lower()

    def __repr__(self) -> str:
        return f"RemoteFolder({self.url!r})"

    @property
    def concurrent(self) -> bool:
        """Whether one connection serves several threads at the same time."""
        registry = importlib.import_module("fsspec.registry")
        return bool(registry.get_filesystem_class(self.protocol).async_impl)

    # Reading

    def read(self, name: str, limit: int) -> bytes | None:
        """The first ``limit`` bytes of a file; None where there is none."""
        with self._telling("read", name) as (system, path):
            try:
                return bytes(system.cat_file(path, start=0, end=limit))
            except (FileNotFoundError, IsADirectoryError):
                return None
            except OSError as error:
                # S3 has no range of an empty object.
                if error.errno == errno.EINVAL and system.info(path)["size"] == 0:
                    return b""
                raise

    def entry(self, name: str) -> Entry | None:
        """Size and age of a file; None where there is none."""
        with self._telling("look up", name) as (system, path):
            try:
                info = system.info(path)
            except FileNotFoundError:
                return None
            return _entry(name, info) if info["type"] == "file" else None

    def download(self, name: str, target: Path, size: int) -> str | None:
        """Copy a file to a path here, if it has the size that it should have.

        Args:
            name: The file.
            target: Where the copy goes; what is left there after a finding is of no use.
            size: Bytes.

        Returns:
            What is wrong with the file as a phrase; None where nothing is.
        """
        callbacks = importlib.import_module("fsspec.callbacks")

        def stop(total: int | None, value: int, **_: Any) -> None:
            if (total is not None and total != size) or value > size:
                raise _OtherSizeError(f"has {max(total or 0, value)} bytes instead of {size}")

        with self._telling("fetch", name) as (system, path):
            try:
                if not system.async_impl:  # those that are call `stop` before the first byte
                    found = system.info(path)
                    if found["type"] != "file":
                        return "is not a file"
                    if found["size"] != size:
                        return f"has {found['size']} bytes instead of {size}"
                callback = callbacks.Callback(hooks={"stop": stop})
                system.get_file(path, str(target), callback=callback, **self._pieces())
            except FileNotFoundError:
                return "is missing"
            except _OtherSizeError as error:
                return str(error)
        if not target.is_file():
            return "is not a file"
        copied = target.stat().st_size
        return None if copied == size else f"has {copied} bytes instead of {size}"

    def entries(self, under: str) -> list[Entry]:
        """All files below a folder of that name, sorted; what is named otherwise than we do is not.

        A listing is not believed: a name in it that could not be ours is left out.
        """
        with self._telling("list", under) as (system, path):
            system.invalidate_cache()
            try:
                found = system.find(path, detail=True)
            except FileNotFoundError:
                return []
            finally:
                system.invalidate_cache()
            start = path[: len(path) - len(under)]
            entries = []
            for full, info in found.items():
                name = str(full).removeprefix(start)
                if name.startswith(f"{under}/") and _NAME.fullmatch(name):
                    entries.append(_entry(name, info))
            return sorted(entries, key=lambda entry: entry.name)

    def names_of(self, file: str) -> list[str]:
        """All ``<folder>/<file>`` directly below this folder, sorted; listings are not believed."""
        with self._telling("list", file) as (system, path):
            system.invalidate_cache()
            start = path[: len(path) - len(file)]
            found = system.glob(f"{start}*/{file}")
            system.invalidate_cache()
            names = [str(full).removeprefix(start) for full in found]
            return sorted(n for n in names if _NAME.fullmatch(n) and n.count("/") == 1)

    # Writing

    def upload(self, source: Path, name: str) -> None:
        """Copy a file to this name, replacing what is there; it appears whole or not at all."""
        with self._telling("store", name) as (system, path):
            if self.protocol in _FOLDERS:
                self._put_and_move(system, path, lambda to: system.put_file(str(source), to))
            else:
                system.put_file(str(source), path, **self._pieces())

    def write(self, name: str, data: bytes) -> None:
        """Write a small file, replacing what is there; it appears whole or not at all."""
        with self._telling("write", name) as (system, path):
            if self.protocol in _FOLDERS:
                self._put_and_move(system, path, lambda to: system.pipe_file(to, data))
            else:
                system.pipe_file(path, data)

    def create(self, name: str, data: bytes) -> bool:
        """Write a small file unless it is there.

        One of two writers at the same time succeeds, wherever the other side can promise that:
        S3 with conditional puts, Google's and Azure's stores, and real folders.

        Returns:
            Whether it was written.
        """
        with self._telling("create", name) as (system, path):
            try:
                if self.protocol in _FOLDERS:
                    system.makedirs(path.rpartition("/")[0], exist_ok=True)
                    with system.open(path, "xb") as stream:
                        stream.write(data)
                else:
                    system.pipe_file(path, data, mode="create")
            except FileExistsError:
                return False
            except OSError as error:
                if "PreconditionFailed" in str(error) or "pre-condition" in str(error).lower():
                    return False
                raise
            return True

    def remove(self, name: str) -> None:
        """Delete a file; nothing happens where there is none."""
        with self._telling("remove", name) as (system, path), suppress(FileNotFoundError):
            system.rm_file(path)

    def _put_and_move(self, system: Any, path: str, put: Any) -> None:
        root = open_url(self.url)[1].rstrip("/")
        temporary = f"{root}/tmp/{uuid.uuid4().hex}"
        for folder in (temporary, path):
            system.makedirs(folder.rpartition("/")[0], exist_ok=True)
        try:
            put(temporary)
            system.mv(temporary, path)
        except BaseException:
            with suppress(Exception):
                system.rm_file(temporary)
            raise

    def _pieces(self) -> dict[str, int]:
        return _PIECES.get(self.protocol, {})

    @contextmanager
    def _telling(self, what: str, name: str) -> Iterator[tuple[Any, str]]:
        """The file system and a name's path in it; errors of any library become ours."""
        if not _NAME.fullmatch(name):
            raise StoreError(f"{self.url}: {name!r} is no name (accepted: letters, digits, _.-/)")
        try:
            system, root = open_url(self.url)
            yield system, f"{root.rstrip('/')}/{name}"
        except StoreError:
            raise
        # Each protocol raises errors of its own library, which share no base but this.
        except Exception as error:
            reason = str(error) or type(error).__name__
            raise RemoteError(
                f"{self.url}: cannot {what} {name}: {reason}", refused=_refuses(error)
            ) from error


def _refuses(error: Exception) -> bool:
    """Whether the other side answered, with a no."""
    words = ("Credential", "Authentication", "BadHostKey")
    return (
        isinstance(error, (PermissionError, FileNotFoundError, NotImplementedError))
        or (isinstance(error, OSError) and error.errno in (errno.EROFS, errno.EPERM))
        or any(word in type(error).__name__ for word in words)
    )


def _entry(name: str, info: dict[str, Any]) -> Entry:
    found = next((info[key] for key in _TIMES if info.get(key)), None)
    if isinstance(found, str):
        with suppress(ValueError):
            found = datetime.fromisoformat(found)
    if isinstance(found, datetime):
        found = (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    modified = float(found) if isinstance(found, (int, float)) else None
    return Entry(name, int(info.get("size") or 0), modified)

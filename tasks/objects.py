"""Content-addressed, immutable objects in a folder: the lower half of the artifact store.

An object lies at ``objects/ab/<sha256><suffix>``. When is its content checked?

- Whenever it is looked up or loaded, its size is compared and its sha256 computed, at about
  1.4 GB/s on one core: little beside computing a stage anew, which is what a hit saves.
- Once an object was found right, this process does not hash it again while its stamp (device,
  inode, size, mtime, ctime) is the same. ctime cannot be set back by a program, so only a disk
  that changes bits by itself escapes, until the next process. Stamps are kept in memory only: one
  on disk could be doctored along with the object.
- An object changed less than two seconds ago is always hashed, as two changes may share a stamp.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from pydantic import JsonValue, ValidationError

from gvr_core.atomic import file_digest, why_not_written
from gvr_core.errors import StoreError
from gvr_core.locks import file_lock
from tasks.arrays import StoredArrays, write_arrays
from tasks.files import Stamp, move_into_place, storing, sync_file, temporary_name
from tasks.records import DIGEST, Artifact, canonical_json

DEFAULT_ROOT = Path(".gvr/store")

_SUFFIX = re.compile(r"(\.[a-z0-9]{1,16}){0,2}")
_OBJECT = re.compile(rf"objects/([0-9a-f]{{2}})/({DIGEST.pattern})({_SUFFIX.pattern})")


class ObjectStore:
    """Objects by content.

    Args:
        root: The store's folder; else the environment variable GVR_STORE, else ``.gvr/store``
            under the current folder. Made at the first write.
    """

    def __init__(self, root: Path | str | None = None) -> None:
        chosen = root if root is not None else os.environ.get("GVR_STORE") or DEFAULT_ROOT
        self.root = Path(chosen).expanduser().resolve()
        self._found_right: dict[str, Stamp] = {}

    @property
    def temporary(self) -> Path:
        """Where files are written before they get their names."""
        return self.root / "tmp"

    @property
    def guard(self) -> Path:
        """The lock that writers share and that the garbage collector takes for itself."""
        return self.root / "locks" / "store.lock"

    # Writing

    def put_arrays(
        self, kind: str, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any] | None = None
    ) -> Artifact:
        """Store named arrays as .safetensors; the same arrays and meta give the same digest.

        Args:
            kind: What they are.
            arrays: Any shapes; bool, (u)int8-64 and float16-64, in any memory layout.
            meta: JSON values; kept in the file as well as in the handle.

        Raises:
            StoreError: A name, dtype or meta value that cannot be stored, or a full disk.
        """
        with self._temporary(".safetensors") as temporary:
            write_arrays(temporary, arrays, meta or {})
            return self._adopt(temporary, kind, ".safetensors", meta)

    def put_json(
        self, kind: str, value: JsonValue, meta: Mapping[str, Any] | None = None
    ) -> Artifact:
        """Store a JSON value in its canonical text.

        Raises:
            StoreError: Something in it is not JSON; the message gives the place.
        """
        return self.put_bytes(kind, canonical_json(value, name=kind), ".json", meta)

    def put_bytes(
        self, kind: str, data: bytes, suffix: str = "", meta: Mapping[str, Any] | None = None
    ) -> Artifact:
        """Store bytes.

        Args:
            kind: What they are.
            data: The content.
            suffix: Of the file name, e.g. ``".png"``.
            meta: JSON values for the handle.

        Raises:
            StoreError: A suffix or meta value that cannot be used, or a full disk.
        """
        with self._temporary(".bytes") as temporary:
            temporary.write_bytes(data)
            return self._adopt(temporary, kind, suffix, meta)

    def put_file(
        self,
        path: Path,
        kind: str,
        meta: Mapping[str, Any] | None = None,
        suffix: str | None = None,
    ) -> Artifact:
        """Store a copy of a file.

        Args:
            path: The file; left as it is.
            kind: What it is.
            meta: JSON values for the handle.
            suffix: Of the object's name; the file's own, in lower case, where None.

        Raises:
            StoreError: There is no such file, a suffix that cannot be used, or a full disk.
        """
        chosen = path.suffix.lower() if suffix is None else suffix
        with self._temporary(".copy") as temporary:
            try:
                shutil.copyfile(path, temporary)
            except OSError as error:
                reason = why_not_written(error, self.root)
                raise StoreError(f"{path}: cannot be copied into the store: {reason}") from error
            return self._adopt(temporary, kind, chosen, meta)

    @contextmanager
    def _temporary(self, suffix: str) -> Iterator[Path]:
        """The name of a file that is gone at the end of the block."""
        with storing(self.root):
            temporary = temporary_name(self.temporary, suffix)
            try:
                yield temporary
            finally:
                temporary.unlink(missing_ok=True)

    def _adopt(
        self, temporary: Path, kind: str, suffix: str, meta: Mapping[str, Any] | None
    ) -> Artifact:
        """Give a finished temporary file the name of its content."""
        if not _SUFFIX.fullmatch(suffix):
            raise StoreError(f"suffix {suffix!r} (accepted: like .png or .tar.gz, in lower case)")
        canonical_json(dict(meta or {}), name=f"meta of {kind}")
        digest = file_digest(temporary)
        try:
            artifact = Artifact(
                kind=kind,
                digest=digest,
                path=f"objects/{digest[:2]}/{digest}{suffix}",
                bytes=temporary.stat().st_size,
                meta=dict(meta or {}),
            )
        except ValidationError as error:
            raise StoreError(f"kind {kind!r} (accepted: 1 to 64 characters)") from error
        temporary.chmod(0o444)
        sync_file(temporary)
        target = self.locate(artifact)
        with file_lock(self.guard, shared=True):
            # Also where the object exists: that heals a damaged one, and its fresh time stamp
            # tells the garbage collector that somebody is about to refer to it.
            move_into_place(temporary, target)
        return artifact

    # Reading

    def locate(self, artifact: Artifact) -> Path:
        """Where an artifact's file should be; it need not exist.

        Raises:
            StoreError: The path is not the one its digest gives, or a folder on it is a symbolic
                link, which may lead out of the store.
        """
        match = _OBJECT.fullmatch(artifact.path)
        if match is None or match[2] != artifact.digest or match[1] != artifact.digest[:2]:
            raise StoreError(
                f"artifact path {artifact.path!r} of digest {artifact.digest}"
                " (accepted: objects/<first two digits>/<digest><suffix>)"
            )
        path = self.root / artifact.path
        for step in (path.parent.parent, path.parent):
            if step.is_symlink():
                raise StoreError(f"{step} is a symbolic link (accepted: what the store wrote)")
        return path

    def problem(self, artifact: Artifact, *, thorough: bool = False) -> str | None:
        """What is wrong with an artifact's file; None where nothing is.

        Args:
            artifact: The handle.
            thorough: Hash the content even where this process did before.

        Returns:
            The finding as a phrase, or None.
        """
        try:
            path = self.locate(artifact)
            before = Stamp.of(path)
            if not stat.S_ISREG(path.lstat().st_mode):
                return "is a symbolic link or folder, not a file"
            if before.size != artifact.bytes:
                return f"has {before.size} bytes instead of {artifact.bytes}"
            if not thorough and self._found_right.get(artifact.path) == before:
                return None
            settled = before.settled
            if file_digest(path) != artifact.digest:
                return "has another content than its digest says"
            if settled and Stamp.of(path) == before:
                self._found_right[artifact.path] = before
        except StoreError as error:
            return str(error)
        except FileNotFoundError:
            return "is missing"
        except OSError as error:
            return f"cannot be read: {error}"
        return None

    def path(self, artifact: Artifact) -> Path:
        """The file of an artifact, its content checked (see the module's text on when).

        The file must not be written to.

        Raises:
            StoreError: It is missing or damaged, or the path leads out of the store.
        """
        path = self.locate(artifact)
        finding = self.problem(artifact)
        if finding is not None:
            raise StoreError(f"{artifact.kind} {path} {finding}")
        return path

    def load_arrays(
        self, artifact: Artifact, names: Iterable[str] | None = None
    ) -> dict[str, NDArray[Any]]:
        """Read named arrays.

        Args:
            artifact: What `put_arrays` returned.
            names: The arrays wanted; only these are read. All where None.

        Raises:
            StoreError: The object is missing, damaged or not of arrays, or a name is not in it.
        """
        stored = self.open_arrays(artifact)
        wanted = list(stored) if names is None else list(names)
        unknown = [name for name in wanted if name not in stored]
        if unknown:
            raise StoreError(
                f"{artifact.kind} has no array {unknown[0]!r} (accepted: {', '.join(stored)})"
            )
        return {name: stored[name] for name in wanted}

    def open_arrays(self, artifact: Artifact) -> StoredArrays:
        """Named arrays as a mapping that reads each when it is asked for.

        Raises:
            StoreError: The object is missing, damaged or not of arrays.
        """
        return StoredArrays(self.path(artifact))

    def load_json(self, artifact: Artifact) -> Any:
        """Read a JSON value.

        Raises:
            StoreError: The object is missing, damaged or not JSON.
        """
        try:
            return json.loads(self.load_bytes(artifact))
        except (ValueError, RecursionError) as error:
            raise StoreError(f"{artifact.kind} {artifact.path}: not JSON: {error}") from error

    def load_bytes(self, artifact: Artifact) -> bytes:
        """Read an object's content, checked as it is read.

        Raises:
            StoreError: The object is missing or damaged.
        """
        data = self.path(artifact).read_bytes()
        if hashlib.sha256(data).hexdigest() != artifact.digest:
            raise StoreError(f"{artifact.kind} {artifact.path} changed while it was read")
        return data

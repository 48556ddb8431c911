"""The models folder: which checkpoints lie there, and in what state."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from gvr_core.errors import ModelError
from gvr_core.models.checkpoints import checkpoint
from gvr_core.untrusted import expanded
from gvr_core.weights.manifest import DIGEST_SUFFIX, Entry, WeightsFile, find_entry


class State(StrEnum):
    """How much of a file is there. A present file's digest may still differ."""

    PRESENT = "present"
    PARTIAL = "partial"
    MISSING = "missing"
    WRONG_SIZE = "wrong size"


@dataclass(frozen=True)
class StoredFile:
    """A file of a checkpoint, as the models folder has it. Nothing of it was read."""

    file: WeightsFile
    path: Path
    state: State
    bytes: int
    """Bytes that are there, of a partial file those fetched so far."""
    sha256: str | None
    """What its digest has to be: the manifest's, else the one recorded when it was fetched."""

    @property
    def recorded(self) -> bool:
        """Whether the digest is only what was recorded at the first fetch."""
        return self.file.sha256 is None and self.sha256 is not None


@dataclass(frozen=True)
class Located:
    """A file that is there, with the digest that it was checked against."""

    path: Path
    sha256: str | None
    """None for a file that nobody has stated or recorded a digest of."""


def models_folder() -> Path:
    """Where checkpoints lie: GVR_MODELS, else ``models`` under GVR_HOME, else ``.gvr/models``."""
    given = os.environ.get("GVR_MODELS")
    return expanded(Path(given or Path(os.environ.get("GVR_HOME") or ".gvr") / "models"))


def located(name: str, folder: Path | None = None) -> tuple[Located, ...]:
    """The files of a checkpoint, each checked against its digest.

    A file is read for its digest once a process, as long as it does not change.

    Args:
        name: As suites say it, e.g. ``sam:vit_h``.
        folder: The models folder, where it is not the usual one.

    Returns:
        One for each file of the entry, in the manifest's order.

    Raises:
        ModelError: for an unknown name; for files that are missing, cut short or of another
            content than they should have, with the command that fetches them.
    """
    folder = folder or models_folder()
    found = stored(find_entry(name, folder), folder)
    lacking = [item for item in found if item.state is not State.PRESENT]
    if lacking:
        said = ", ".join(f"{item.file.path} is {item.state}" for item in lacking)
        raise ModelError(f"{name}: {said}", path=folder, accepted=remedy(name))
    for item in found:
        digest = checkpoint(item.path).sha256 if item.sha256 else None
        if digest != item.sha256:
            raise ModelError(
                f"is not what {name} should be: its sha256 is {digest}",
                path=item.path,
                accepted=f"sha256 {item.sha256}; {remedy(name)}",
            )
    return tuple(Located(item.path, item.sha256) for item in found)


def stored(entry: Entry, folder: Path) -> tuple[StoredFile, ...]:
    """What the models folder has of a checkpoint, without reading the files.

    Where a file may stand in for another, it is the one that is there.
    """
    return tuple(_best([look(each, folder) for each in file.candidates()]) for file in entry.files)


def look(file: WeightsFile, folder: Path) -> StoredFile:
    """What the models folder has of one file."""
    path = folder / file.path
    digest = file.sha256 or recorded_digest(path)
    if path.is_file():
        size = path.stat().st_size
        fits = file.size is None or file.size == size
        return StoredFile(file, path, State.PRESENT if fits else State.WRONG_SIZE, size, digest)
    part = part_path(path)
    if part.is_file():
        return StoredFile(file, path, State.PARTIAL, part.stat().st_size, digest)
    return StoredFile(file, path, State.MISSING, 0, digest)


def overall(files: Sequence[StoredFile]) -> State:
    """One word for all files of a checkpoint."""
    states = {item.state for item in files}
    if State.WRONG_SIZE in states:
        return State.WRONG_SIZE
    return states.pop() if len(states) == 1 else State.PARTIAL


def part_path(path: Path) -> Path:
    """The hidden neighbour that a file is fetched into."""
    return path.with_name(f".{path.name}.part")


def digest_path(path: Path) -> Path:
    """The neighbour that holds the digest of a file, where no manifest states one."""
    return path.with_name(path.name + DIGEST_SUFFIX)


def recorded_digest(path: Path) -> str | None:
    """The digest recorded beside a file, in the form of ``sha256sum``; None where there is none.

    Raises:
        ModelError: if the record is there and holds no digest.
    """
    record = digest_path(path)
    try:
        text = record.read_text(encoding="ascii", errors="replace")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ModelError(f"cannot be read: {error.strerror}", path=record) from error
    match = re.match(r"([0-9a-fA-F]{64})(\s|$)", text)
    if match is None:
        raise ModelError("holds no sha256", path=record, accepted="the form of sha256sum")
    return match.group(1).lower()


def remedy(name: str) -> str:
    """The command that puts a checkpoint right."""
    return f"gvr models fetch {name}"


def _best(candidates: Sequence[StoredFile]) -> StoredFile:
    order = (State.PRESENT, State.WRONG_SIZE, State.PARTIAL, State.MISSING)
    return min(candidates, key=lambda item: order.index(item.state))

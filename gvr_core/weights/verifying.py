"""Reading checkpoints that are in the models folder again, to see that they are still right."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gvr_core.atomic import file_digest
from gvr_core.errors import ModelError
from gvr_core.weights import open_clip_tags
from gvr_core.weights.folder import State, StoredFile, stored
from gvr_core.weights.manifest import Entry, find_entry, known
from gvr_core.weights.safety import check_harmless


@dataclass(frozen=True)
class Verdict:
    """What reading a file found."""

    stored: StoredFile
    right: bool
    text: str


def entries_of(folder: Path) -> dict[str, Entry]:
    """The checkpoints of the manifests, and models of ``open_clip`` that were fetched beside them.

    Args:
        folder: The models folder.

    Raises:
        ModelError: for a manifest that cannot be used.
    """
    entries = known(folder)
    for path in sorted((folder / "open_clip").glob("*/*/")):
        name = f"{open_clip_tags.PREFIX}{path.parent.name}/{path.name}"
        if name in entries:
            continue
        try:
            entry = find_entry(name, folder)
        except ModelError:
            continue  # a folder of somebody else's
        if any(item.state is not State.MISSING for item in stored(entry, folder)):
            entries[name] = entry
    return entries


def verify(entry: Entry, folder: Path) -> tuple[Verdict, ...]:
    """Read every file of a checkpoint that is there, and compare it with what it should be.

    Args:
        entry: The checkpoint.
        folder: The models folder.

    Returns:
        One for each file; one that is missing or cut short is not right.
    """
    return tuple(_verify(item) for item in stored(entry, folder))


def _verify(item: StoredFile) -> Verdict:
    if item.state is State.WRONG_SIZE:
        return Verdict(item, False, f"{item.bytes:,} bytes instead of {item.file.size:,}")
    if item.state is not State.PRESENT:
        return Verdict(item, False, str(item.state))
    try:
        found = file_digest(item.path)
        if item.sha256 is not None and found != item.sha256:
            return Verdict(item, False, f"sha256 is {found} instead of {item.sha256}")
        check_harmless(item.path, item.file.path)
    except ModelError as error:
        return Verdict(item, False, error.message)
    except OSError as error:
        return Verdict(item, False, f"cannot be read: {error.strerror}")
    if item.sha256 is None:
        return Verdict(item, True, f"sha256 {found}, which nobody has stated")
    return Verdict(item, True, "as at the first fetch" if item.recorded else "as the manifest says")

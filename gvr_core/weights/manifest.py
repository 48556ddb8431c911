"""The manifest: which checkpoints there are, what is in them, and where they come from.

``manifest.toml`` beside this module lists the checkpoints that the project knows. A
``manifest.toml`` in the models folder adds one's own, in the same form. Any model of
``open_clip`` is known on top, from that library's own table
(:mod:`gvr_core.weights.open_clip_tags`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Annotated

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PositiveInt,
    StringConstraints,
    ValidationError,
)

from gvr_core.errors import ModelError, did_you_mean
from gvr_core.untrusted import read_toml
from gvr_core.weights import open_clip_tags

MANIFEST = "manifest.toml"
"""Name of a manifest, in this package and in the models folder."""

DIGEST_SUFFIX = ".sha256"
"""What is added to a file's name for the record of its digest, where no manifest states one."""


def _inside(path: str) -> str:
    parts = path.split("/")
    if (
        "\\" in path
        or PurePosixPath(path).is_absolute()
        or any(part.startswith(".") or not part.strip() for part in parts)
    ):
        raise ValueError("must be a path inside the models folder, with no hidden part and no ..")
    if path == MANIFEST or path.endswith(DIGEST_SUFFIX):
        raise ValueError(f"is a name that the models folder uses itself: {path}")
    return path


Digest = Annotated[str, StringConstraints(to_lower=True, pattern=r"^[0-9A-Fa-f]{64}$")]
Url = Annotated[str, StringConstraints(pattern=r"^https?://[^\s/]+/\S*$")]
Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
Name = Annotated[str, StringConstraints(pattern=r"^\S+$")]


class WeightsFile(BaseModel):
    """One file of a checkpoint."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: Annotated[str, AfterValidator(_inside)]
    """Where it lies in the models folder, with ``/``."""
    url: Url
    """Where it is fetched from, by http or https."""
    size: PositiveInt | None = None
    """Bytes; None where it is not known before the server says it."""
    sha256: Digest | None = None
    """Digest of the content; None where nobody states one."""
    otherwise: WeightsFile | None = None
    """What stands in for it where the server has no such file."""

    def candidates(self) -> Iterator[WeightsFile]:
        """This file and those that stand in for it, in the order they are tried."""
        yield self
        if self.otherwise is not None:
            yield from self.otherwise.candidates()


class Entry(BaseModel):
    """A checkpoint: its files, and what may be done with them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Name
    """As suites say it, e.g. ``sam:vit_h``."""
    role: Text
    """What it does: segmenter, encoder, detector, tokenizer."""
    licence: Text
    """SPDX identifier, where there is one."""
    source: Url
    """The publisher's page."""
    files: Annotated[tuple[WeightsFile, ...], Field(min_length=1)]
    """In the order that :func:`gvr_core.weights.folder.located` gives them back."""
    needs: tuple[Name, ...] = ()
    """Entries that are fetched along with it."""

    @property
    def size(self) -> int | None:
        """Bytes of all files; None where one of them is not known."""
        sizes = [file.size for file in self.files]
        return None if None in sizes else sum(size for size in sizes if size is not None)


class _Manifest(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    checkpoints: tuple[Entry, ...] = ()


@lru_cache(maxsize=1)
def shipped() -> Mapping[str, Entry]:
    """The checkpoints that the project knows, by name."""
    return read_manifest(Path(__file__).with_name(MANIFEST))


def read_manifest(path: Path) -> dict[str, Entry]:
    """A manifest file, checked.

    Args:
        path: A TOML file with ``[[checkpoints]]``, each with ``[[checkpoints.files]]``.

    Returns:
        Entry by name, in the file's order.

    Raises:
        ModelError: naming the line that is no TOML, or the key that is unknown or wrong.
    """
    try:
        content = read_toml(path)
    except ValueError as error:
        raise ModelError(f"not TOML: {error}", path=path) from error
    except OSError as error:
        raise ModelError(f"cannot be read: {error.strerror}", path=path) from error
    try:
        entries = _Manifest.model_validate(content).checkpoints
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ModelError(first["msg"], path=path, place=place or None) from error
    named: dict[str, Entry] = {}
    for entry in entries:
        if entry.name in named:
            raise ModelError(f"{entry.name} stands there twice", path=path, accepted="one of them")
        named[entry.name] = entry
    return named


def known(folder: Path) -> dict[str, Entry]:
    """The project's checkpoints and one's own, by name.

    An entry of one's own with the name of a known one says where else the same files lie, a
    mirror: it has to state the paths and digests that the known one states.

    Args:
        folder: The models folder; its ``manifest.toml`` need not exist.

    Raises:
        ModelError: for a manifest that cannot be used, an own entry that gives a known name to
            other files, or two entries that put different files at one path.
    """
    entries = dict(shipped())
    path = folder / MANIFEST
    if path.exists():
        for name, entry in read_manifest(path).items():
            if name in entries:
                _check_mirror(entry, entries[name], path)
            entries[name] = entry
    _check_paths(entries, path)
    return entries


def find_entry(name: str, folder: Path) -> Entry:
    """The checkpoint of a name.

    Args:
        name: As suites say it; after ``open_clip:`` any model and tag of that library.
        folder: The models folder, whose manifest may add entries.

    Raises:
        ModelError: for a name that is not known, listing those that are.
    """
    entries = known(folder)
    if name in entries:
        return entries[name]
    if name.startswith(open_clip_tags.PREFIX):
        canonical = open_clip_tags.canonical(name)
        if canonical in entries:
            return entries[canonical]
        return Entry.model_validate(open_clip_tags.entry_fields(canonical))
    raise ModelError(
        f"no checkpoint is named {name!r}{did_you_mean(name, entries)}",
        accepted=f"{', '.join(entries)}, or {open_clip_tags.PREFIX}MODEL/TAG for any of "
        "open_clip's; one's own in manifest.toml of the models folder",
    )


def _check_mirror(own: Entry, known_entry: Entry, path: Path) -> None:
    same = [(file.path, file.sha256) for file in known_entry.files]
    if None in (digest for _, digest in same):
        raise ModelError(
            f"{own.name} is a known checkpoint without a digest, which cannot be replaced",
            path=path,
            accepted="another name",
        )
    if [(file.path, file.sha256) for file in own.files] != same:
        raise ModelError(
            f"{own.name} is a known checkpoint with other files",
            path=path,
            accepted="another name, or a mirror: the known one's paths and sha256 with another url",
        )


def _check_paths(entries: Mapping[str, Entry], path: Path) -> None:
    seen: dict[str, tuple[str, WeightsFile]] = {}
    for entry in entries.values():
        for file in (each for first in entry.files for each in first.candidates()):
            other, there = seen.setdefault(file.path, (entry.name, file))
            if there.sha256 != file.sha256 or (file.sha256 is None and there.url != file.url):
                raise ModelError(
                    f"{other} and {entry.name} put different files at {file.path}",
                    path=path,
                    accepted="a path of its own for each file",
                )

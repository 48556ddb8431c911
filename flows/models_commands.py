"""What ``gvr models`` does; each function is one command, usable without a shell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, DownloadColumn, TextColumn, TransferSpeedColumn
from rich.progress import Progress as RichProgress

from flows.exit_codes import EXIT_BAD_INPUT, EXIT_FAILED
from flows.output import complain, complaints, print_document, say, show_sheet
from gvr_core.errors import ConfigError, ModelError
from gvr_core.weights.fetching import Fetched, Trust, fetch_file, with_needs
from gvr_core.weights.folder import State, StoredFile, overall, stored
from gvr_core.weights.manifest import Entry, WeightsFile, find_entry, known
from gvr_core.weights.verifying import entries_of, verify
from reports.sheet import Sheet


@dataclass(frozen=True)
class StoredDocument:
    """A file of a checkpoint."""

    path: Path
    url: str | None
    size: int | None
    """As the manifest states it."""
    sha256: str | None
    recorded: bool
    """Whether the digest was recorded at the first fetch, since nobody states it."""
    state: str
    bytes: int
    """Of it that are here."""


@dataclass(frozen=True)
class ModelDocument:
    """A checkpoint."""

    name: str
    role: str
    licence: str
    source: str
    needs: tuple[str, ...]
    """Checkpoints that it does not work without."""
    state: str
    files: tuple[StoredDocument, ...]


@dataclass(frozen=True)
class ModelsDocument:
    """The checkpoints that are known."""

    folder: Path
    models: tuple[ModelDocument, ...]


@dataclass(frozen=True)
class FetchedDocument:
    """What became of the files that were asked for."""

    folder: Path
    fetched: tuple[Fetched, ...]
    failed: dict[str, str]
    """File -> why it could not be fetched."""


@dataclass(frozen=True)
class VerdictDocument:
    """What reading a file found."""

    name: str
    """The checkpoint's."""
    file: str
    right: bool
    text: str


@dataclass(frozen=True)
class VerifiedDocument:
    """What reading the files found."""

    folder: Path
    wrong: int
    files: tuple[VerdictDocument, ...]


def models_ls(folder: Path, as_json: bool) -> None:
    """``gvr models ls``.

    Args:
        folder: The models folder; need not exist.
        as_json: Print a document with everything that is known, in place of the table.
    """
    listing = {entry: stored(entry, folder) for entry in entries_of(folder).values()}
    if as_json:
        models = tuple(_document(entry, files) for entry, files in listing.items())
        print_document("models ls", ModelsDocument(folder, models))
        return
    rows = [
        (entry.name, entry.role, entry.licence, _state(files), _size_of(entry, files))
        for entry, files in listing.items()
    ]
    columns = ("name", "role", "licence", "state", "size")
    show_sheet(Sheet(f"checkpoints in {folder}", columns, tuple(rows), n_names=4))
    say("Next: gvr models fetch NAME")


def models_fetch(
    folder: Path, names: Sequence[str], every: bool, progress: bool, as_json: bool = False
) -> int:
    """``gvr models fetch``: bring checkpoints here, and what they need.

    One that cannot be fetched does not keep the others from being fetched.

    Args:
        folder: The models folder; made where it is missing.
        names: Names of checkpoints.
        every: All of the manifests, in place of names.
        progress: Draw bars, where standard error is a terminal.
        as_json: Print a document, in place of lines.

    Returns:
        Exit code: 0, or 2 where one could not be fetched.

    Raises:
        ConfigError: without names.
        ModelError: for an unknown name, before anything is fetched.
    """
    entries = list(known(folder).values()) if every else [find_entry(n, folder) for n in names]
    if not entries:
        raise ConfigError(
            "no checkpoint is named", accepted=f"--all, or some of {', '.join(known(folder))}"
        )
    wanted: dict[str, WeightsFile] = {}
    for entry in entries:
        for each in with_needs(entry, folder):
            wanted |= {file.path: file for file in each.files}
    done: list[Fetched] = []
    failed: dict[str, str] = {}
    for file in wanted.values():
        try:
            with _Bar(progress and complaints.is_terminal) as bar:
                fetched = fetch_file(file, folder, bar.show)
        except ModelError as error:
            complain(str(error))
            failed[file.path] = str(error)
        else:
            done.append(fetched)
            if not as_json:
                _say_fetched(fetched)
    if as_json:
        print_document("models fetch", FetchedDocument(folder, tuple(done), failed))
    return EXIT_BAD_INPUT if failed else 0


def models_verify(folder: Path, names: Sequence[str], as_json: bool = False) -> int:
    """``gvr models verify``: read what is here again.

    Args:
        folder: The models folder.
        names: Names of checkpoints, all files of which have to be here; without names, whatever
            is here.
        as_json: Print a document, in place of lines.

    Returns:
        Exit code: 0, or 1 where a file is wrong.

    Raises:
        ModelError: for an unknown name.
    """
    named = [find_entry(name, folder) for name in names]
    found: list[VerdictDocument] = []
    for entry in named or entries_of(folder).values():
        if not named and overall(stored(entry, folder)) is State.MISSING:
            continue
        for verdict in verify(entry, folder):
            file = verdict.stored.file.path
            found.append(VerdictDocument(entry.name, file, verdict.right, verdict.text))
            if not as_json:
                _say_verdict(found[-1])
    wrong = sum(not verdict.right for verdict in found)
    if as_json:
        print_document("models verify", VerifiedDocument(folder, wrong, tuple(found)))
    else:
        say(f"{len(found)} files read in {folder}, {wrong} wrong")
    return EXIT_FAILED if wrong else 0


def _say_verdict(verdict: VerdictDocument) -> None:
    word = "ok" if verdict.right else "WRONG"
    say(f"{word}  {verdict.name}  {verdict.file}: {verdict.text}")
    if not verdict.right:
        say(f"       gvr models fetch {verdict.name}")


class _Bar:
    """The bar of a file that is being fetched; gone when it is there."""

    def __init__(self, shown: bool) -> None:
        self._bars = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            DownloadColumn(),
            TransferSpeedColumn(),
            console=complaints,
            transient=True,
            disable=not shown,
        )
        self._bar: Any = None

    def __enter__(self) -> _Bar:
        self._bars.start()
        return self

    def __exit__(self, *error: Any) -> None:
        self._bars.stop()

    def show(self, file: WeightsFile, done: int, total: int | None) -> None:
        if self._bar is None:
            self._bar = self._bars.add_task(Path(file.path).name)
            # What an earlier call fetched says nothing of the speed.
            self._bars.reset(self._bar, completed=done, total=total)
        self._bars.update(self._bar, completed=done, total=total)


def _say_fetched(fetched: Fetched) -> None:
    done = "fetched" if fetched.new else "was there"
    say(f"{done}  {fetched.path}")
    if fetched.trust is not Trust.MANIFEST:
        said = {
            Trust.SERVER: "as the server states",
            Trust.RECORD: "as recorded at the first fetch",
            Trust.FIRST_USE: "which nobody states; recorded beside it, and held to from now on",
        }[fetched.trust]
        say(f"         sha256 {fetched.sha256}, {said}")


def _size_of(entry: Entry, files: Sequence[StoredFile]) -> str:
    if entry.size is not None:
        return _readable(entry.size)
    if all(item.state is State.PRESENT for item in files):
        return _readable(sum(item.bytes for item in files))
    return "?"


def _readable(count: int) -> str:
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return f"{count} B"


def _state(files: Sequence[StoredFile]) -> str:
    state = overall(files)
    expected = sum(item.file.size or 0 for item in files)
    if state is State.PARTIAL and expected:
        return f"{state} {100 * sum(item.bytes for item in files) // expected}%"
    return str(state)


def _document(entry: Entry, files: Sequence[StoredFile]) -> ModelDocument:
    return ModelDocument(
        name=entry.name,
        role=entry.role,
        licence=entry.licence,
        source=entry.source,
        needs=tuple(entry.needs),
        state=str(overall(files)),
        files=tuple(
            StoredDocument(
                path=item.path,
                url=item.file.url,
                size=item.file.size,
                sha256=item.sha256,
                recorded=item.recorded,
                state=str(item.state),
                bytes=item.bytes,
            )
            for item in files
        ),
    )

"""What ``gvr models`` does; each function is one command, usable without a shell."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, TextColumn, TransferSpeedColumn
from rich.progress import Progress as RichProgress
from rich.table import Table

from gvr_core.errors import ConfigError, ModelError
from gvr_core.weights.fetching import Fetched, Trust, fetch_file, with_needs
from gvr_core.weights.folder import State, StoredFile, overall, stored
from gvr_core.weights.manifest import Entry, WeightsFile, find_entry, known
from gvr_core.weights.verifying import entries_of, verify

EXIT_WRONG = 1
EXIT_BAD_INPUT = 2

console = Console(soft_wrap=True)
complaints = Console(stderr=True, soft_wrap=True)


def models_ls(folder: Path, as_json: bool) -> None:
    """``gvr models ls``.

    Args:
        folder: The models folder; need not exist.
        as_json: Print everything that is known, in place of the table.
    """
    listing = {entry: stored(entry, folder) for entry in entries_of(folder).values()}
    if as_json:
        print(json.dumps([_as_json(entry, files) for entry, files in listing.items()], indent=1))
        return
    table = Table("name", "role", "licence", "size", "state", box=None, pad_edge=False)
    for entry, files in listing.items():
        table.add_row(entry.name, entry.role, entry.licence, _size_of(entry, files), _state(files))
    Console().print(table)
    console.print(f"in {folder}", markup=False, highlight=False)


def models_fetch(folder: Path, names: Sequence[str], every: bool, progress: bool) -> int:
    """``gvr models fetch``: bring checkpoints here, and what they need.

    One that cannot be fetched does not keep the others from being fetched.

    Args:
        folder: The models folder; made where it is missing.
        names: Names of checkpoints.
        every: All of the manifests, in place of names.
        progress: Draw bars, where standard error is a terminal.

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
    code = 0
    for file in wanted.values():
        try:
            with _Bar(progress and complaints.is_terminal) as bar:
                fetched = fetch_file(file, folder, bar.show)
        except ModelError as error:
            complaints.print(f"gvr: {error}", style="red", markup=False, highlight=False)
            code = EXIT_BAD_INPUT
        else:
            _say_fetched(fetched)
    return code


def models_verify(folder: Path, names: Sequence[str]) -> int:
    """``gvr models verify``: read what is here again.

    Args:
        folder: The models folder.
        names: Names of checkpoints, all files of which have to be here; without names, whatever
            is here.

    Returns:
        Exit code: 0, or 1 where a file is wrong.

    Raises:
        ModelError: for an unknown name.
    """
    named = [find_entry(name, folder) for name in names]
    checked = wrong = 0
    for entry in named or entries_of(folder).values():
        if not named and overall(stored(entry, folder)) is State.MISSING:
            continue
        for verdict in verify(entry, folder):
            checked += 1
            wrong += not verdict.right
            word = "ok" if verdict.right else "WRONG"
            console.print(
                f"{word}  {entry.name}  {verdict.stored.file.path}: {verdict.text}",
                style=None if verdict.right else "red",
                markup=False,
                highlight=False,
            )
            if not verdict.right:
                console.print(f"       gvr models fetch {entry.name}", markup=False)
    console.print(f"{checked} files read in {folder}, {wrong} wrong", markup=False, highlight=False)
    return EXIT_WRONG if wrong else 0


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
    console.print(f"{done}  {fetched.path}", markup=False, highlight=False)
    if fetched.trust is not Trust.MANIFEST:
        said = {
            Trust.SERVER: "as the server states",
            Trust.RECORD: "as recorded at the first fetch",
            Trust.FIRST_USE: "which nobody states; recorded beside it, and held to from now on",
        }[fetched.trust]
        console.print(f"         sha256 {fetched.sha256}, {said}", markup=False, highlight=False)


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


def _as_json(entry: Entry, files: Sequence[StoredFile]) -> dict[str, Any]:
    return {
        "name": entry.name,
        "role": entry.role,
        "licence": entry.licence,
        "source": entry.source,
        "needs": list(entry.needs),
        "state": str(overall(files)),
        "files": [
            {
                "path": str(item.path),
                "url": item.file.url,
                "size": item.file.size,
                "sha256": item.sha256,
                "recorded": item.recorded,
                "state": str(item.state),
                "bytes": item.bytes,
            }
            for item in files
        ],
    }

"""Where results lie: a folder, or a shared one behind a URL with a local copy of each.

A result is written into a local folder first, as ever, and then copied: all its files, and
``result.json`` last, so that a result which is half there is not listed. Over there too nothing
is overwritten. Where the copy fails the result is safe here, and goes along with the next one.

A result that is read from the URL is copied here first, file by file as its own ``SHA256SUMS``
lists them, each checked against its sum, and appears whole or not at all.
"""

from __future__ import annotations

import logging
import os
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from gvr_core.atomic import file_digest
from gvr_core.errors import RemoteError
from gvr_core.remote_folder import RemoteFolder
from gvr_core.remote_url import is_url, url_id
from reports.record import Result, Row
from reports.result_check import PICTURE_NAME, ResultError
from reports.result_io import (
    RESULT_FILE,
    ROWS_FILE,
    SUMS_FILE,
    TABLE_FILE,
    list_results,
    read_sums,
    write_result,
)

RUN_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}")
SUMS_BYTES = 64 * 2**20
"""Longer sums are not read; a picture takes about 150 bytes of them."""

log = logging.getLogger(__name__)


class ResultsPlace:
    """A folder of results, here or shared.

    Args:
        location: The folder, or its URL.
        copies: Folder of the local copies of a URL's results; ``results-of/<id of the URL>``
            under the environment variable GVR_HOME, else under ``.gvr``, where None.

    Raises:
        ConfigError: A URL that cannot be opened.
    """

    def __init__(self, location: Path | str, copies: Path | None = None) -> None:
        self.remote = RemoteFolder(str(location)) if is_url(location) else None
        if self.remote is None:
            self.root = Path(location)
        else:
            home = Path(os.environ.get("GVR_HOME", ".gvr"))
            self.root = copies or home / "results-of" / url_id(self.remote.url)

    def __str__(self) -> str:
        return self.remote.url if self.remote else str(self.root)

    def write(
        self,
        result: Result,
        rows: Sequence[Row],
        pictures: Mapping[str, Path | bytes] | None = None,
    ) -> Path:
        """Write a result, and copy it and what was left behind before to the URL.

        Returns:
            Its folder here.

        Raises:
            ResultError: As `reports.result_io.write_result`. A copy that fails is no error: it
                is warned of.
        """
        folder = write_result(self.root / result.run_id, result, rows, pictures)
        try:
            self.push()
        except (RemoteError, ResultError) as error:
            log.warning("the result is safe in %s, and not shared yet: %s", folder, error)
        return folder

    def push(self) -> list[str]:
        """Copy every local result that is not at the URL.

        Returns:
            The run ids of those that were copied.

        Raises:
            RemoteError: The other side fails or refuses.
            ResultError: A result of that run id is there already, and is another one.
        """
        if self.remote is None:
            return []
        there = set(self._names_there(self.remote))
        missing = [folder for folder in list_results(self.root) if folder.name not in there]
        for folder in missing:
            self._push_one(self.remote, folder)
        return [folder.name for folder in missing]

    def names(self) -> list[str]:
        """Run ids of all results, here and at the URL, oldest name first.

        Raises:
            RemoteError: The other side fails or refuses.
        """
        here = {folder.name for folder in list_results(self.root)}
        return sorted(here | set(self._names_there(self.remote) if self.remote else ()))

    def folder(self, name: str) -> Path:
        """The folder of a result here; copied from the URL first where it is only there.

        Raises:
            RemoteError: The other side fails or refuses.
            ResultError: What is there is not a result, or is damaged.
        """
        folder = self.root / name
        if self.remote is not None and not (folder / RESULT_FILE).exists():
            self._fetch(self.remote, name)
        return folder

    def _names_there(self, remote: RemoteFolder) -> list[str]:
        parts = (name.split("/") for name in remote.names_of(RESULT_FILE))
        return [run_id for run_id, *_ in parts if RUN_ID.fullmatch(run_id)]

    def _push_one(self, remote: RemoteFolder, folder: Path) -> None:
        sums = read_sums(folder)
        for name in [*(n for n in sums if n != RESULT_FILE), SUMS_FILE]:
            remote.upload(folder / name, f"{folder.name}/{name}")
        content = (folder / RESULT_FILE).read_bytes()
        name = f"{folder.name}/{RESULT_FILE}"
        if not remote.create(name, content) and remote.read(name, len(content) + 1) != content:
            raise ResultError(
                "a result of this run id is there already, and results are never overwritten",
                path=f"{remote.url}/{folder.name}",
                accepted="another run id",
            )

    def _fetch(self, remote: RemoteFolder, name: str) -> None:
        place = f"{remote.url}/{name}"
        if not RUN_ID.fullmatch(name):
            raise ResultError(f"{name!r} is no run id", path=remote.url, accepted="a run id")
        building = self.root / f".{name}.{secrets.token_hex(4)}.tmp"
        building.mkdir(parents=True)
        try:
            text = remote.read(f"{name}/{SUMS_FILE}", SUMS_BYTES)
            (building / SUMS_FILE).write_bytes(text or b"")
            sums = read_sums(building)
            for file in (RESULT_FILE, ROWS_FILE):
                if file not in sums:
                    raise ResultError(f"{SUMS_FILE} does not list {file}", path=place)
            for file, digest in sums.items():
                if file not in (RESULT_FILE, ROWS_FILE, TABLE_FILE) and not PICTURE_NAME.fullmatch(
                    file
                ):
                    raise ResultError(f"a file named {file!r}", path=place)
                self._fetch_file(remote, f"{name}/{file}", building / file, digest)
            building.rename(self.root / name)
        except OSError as error:
            raise ResultError(f"cannot be copied: {error}", path=place) from error
        finally:
            shutil.rmtree(building, ignore_errors=True)

    def _fetch_file(self, remote: RemoteFolder, name: str, target: Path, digest: str) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        entry = remote.entry(name)
        finding = "is missing" if entry is None else remote.download(name, target, entry.size)
        if finding is None and file_digest(target) != digest:
            finding = "was changed after it was written: its sha256 is another"
        if finding is not None:
            raise ResultError(finding, path=f"{remote.url}/{name}", accepted=f"sha256 {digest}")

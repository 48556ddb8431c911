"""Kill this process at its n-th write point; production code knows nothing of it.

A write point is: before a file is opened for writing, renamed, deleted, made read-only, stamped,
locked or synced, and before a folder is made (seen through Python's audit events); half-way
through writing a file; and where a stage begins, has put its objects, and has its record.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_PATH_EVENTS = {
    "os.rename": "rename",
    "os.remove": "delete",
    "os.mkdir": "make folder",
    "os.rmdir": "remove folder",
    "os.chmod": "protect",
    "os.utime": "stamp",
}


class WritePoints:
    """Counts the write points under some folders, and kills this process at one of them.

    Args:
        roots: The folders that count.
        kill_at: Which point is the last, from 1; None counts only.
        note: Called with each point's name.
    """

    def __init__(
        self,
        roots: tuple[Path, ...],
        kill_at: int | None = None,
        note: Callable[[str], None] | None = None,
    ) -> None:
        self.roots = tuple(f"{root.resolve()}{os.sep}" for root in roots)
        self.kill_at = kill_at
        self.note = note
        self.count = 0
        self._lock = threading.Lock()

    def install(self) -> None:
        """Watch from now on, until this process ends."""
        sys.addaudithook(self._audit)
        self._watch_writers()
        self._watch_stages()

    def reach(self, name: str, tear: Callable[[], Any] | None = None) -> None:
        """Be at a point; does not return where this one is the last.

        Args:
            name: The point.
            tear: Leaves behind what a kill in the middle of it leaves.
        """
        with self._lock:
            self.count += 1
            last = self.count == self.kill_at
        if self.note is not None:
            self.note(name)
        if last:
            if tear is not None:
                tear()
            os.kill(os.getpid(), signal.SIGKILL)

    def _inside(self, path: Any) -> bool:
        # Not resolve(), which looks at the disk for every file that anybody opens.
        return isinstance(path, str | Path) and f"{Path(path).absolute()}{os.sep}".startswith(
            self.roots
        )

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            if isinstance(flags, int) and flags & _WRITING and self._inside(path):
                self.reach(f"open {Path(path).suffix}")
        elif event == "fcntl.flock":
            self.reach("lock")
        elif event == "os.mkdir" and Path(arguments[0]).is_dir():
            return  # changes nothing
        elif event in _PATH_EVENTS and self._inside(arguments[0]):
            self.reach(f"{_PATH_EVENTS[event]} {Path(arguments[0]).suffix}")

    def _watch_writers(self) -> None:
        import pyarrow.parquet

        import tasks.arrays

        real_bytes, real_text, real_sync = Path.write_bytes, Path.write_text, os.fsync
        real_save, real_table = tasks.arrays.save_file, pyarrow.parquet.write_table

        def write_bytes(path: Path, data: Any) -> int:
            if self._inside(path):
                self.reach(
                    f"half of {path.suffix}", lambda: real_bytes(path, data[: len(data) // 2])
                )
            return real_bytes(path, data)

        def write_text(path: Path, data: str, *rest: Any, **named: Any) -> int:
            if self._inside(path):
                half = data[: len(data) // 2]
                self.reach(f"half of {path.suffix}", lambda: real_text(path, half, *rest, **named))
            return real_text(path, data, *rest, **named)

        def save_file(arrays: Any, path: Any, **named: Any) -> None:
            def tear() -> None:
                real_save(arrays, path, **named)
                os.truncate(path, Path(path).stat().st_size // 2)

            if self._inside(path):
                self.reach("half of .safetensors", tear)
            real_save(arrays, path, **named)

        def write_table(table: Any, path: Any, **named: Any) -> None:
            def tear() -> None:
                real_table(table, path, **named)
                os.truncate(path, Path(path).stat().st_size // 2)

            if self._inside(path):
                self.reach("half of .parquet", tear)
            real_table(table, path, **named)

        def fsync(descriptor: int) -> None:
            self.reach("sync")
            real_sync(descriptor)

        Path.write_bytes = write_bytes  # type: ignore[method-assign]
        Path.write_text = write_text  # type: ignore[method-assign, assignment]
        tasks.arrays.save_file = save_file
        pyarrow.parquet.write_table = write_table
        os.fsync = fsync

    def _watch_stages(self) -> None:
        from tasks.record_store import RecordStore

        real = RecordStore.compute_once

        def compute_once(
            store: RecordStore, stage: str, version: int, key: str, function: Any, **named: Any
        ) -> Any:
            def watched() -> Any:
                output = function()
                self.reach(f"stage {stage} has put its objects")
                return output

            self.reach(f"stage {stage} begins")
            outcome = real(store, stage, version, key, watched, **named)
            self.reach(f"stage {stage} has its record")
            return outcome

        RecordStore.compute_once = compute_once  # type: ignore[method-assign]

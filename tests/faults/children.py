"""Children that may be killed: forked from a process that has everything imported.

Only a process without other threads may fork like this, so tests start one of their own.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gvr_core.errors import GVRError


class LineFailed(Exception):
    """A scene of a result has failed; its error."""


@dataclass(frozen=True)
class Ended:
    """How a child ended."""

    code: int | None
    """Exit code; None where a signal ended it."""
    signal: int | None
    output: str
    seconds: float

    @property
    def killed(self) -> bool:
        """Whether SIGKILL ended it."""
        return self.signal == signal.SIGKILL

    @property
    def last_line(self) -> str:
        """The last line it wrote: the error, where there was one."""
        lines = self.output.strip().splitlines()
        return lines[-1] if lines else ""


@dataclass
class Child:
    """A running child."""

    pid: int
    output: Path
    started: float = field(default_factory=time.monotonic)

    def kill_after(self, seconds: float) -> bool:
        """Send SIGKILL so long after its start; returns whether it was still running."""
        while (left := self.started + seconds - time.monotonic()) > 0:
            if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                return False
            time.sleep(min(left, 0.005))
        os.kill(self.pid, signal.SIGKILL)
        return True

    def wait(self, timeout: float = 120.0) -> Ended:
        """Wait for its end; one that takes too long is killed and counts as hung.

        Raises:
            TimeoutError: It did not end.
        """
        deadline = self.started + timeout
        while True:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() > deadline:
                os.kill(self.pid, signal.SIGKILL)
                os.waitpid(self.pid, 0)
                raise TimeoutError(f"a run did not end within {timeout:.0f} s")
            time.sleep(0.005)
        text = self.output.read_text(errors="replace")
        self.output.unlink()
        by_signal = os.WIFSIGNALED(status)
        return Ended(
            None if by_signal else os.WEXITSTATUS(status),
            os.WTERMSIG(status) if by_signal else None,
            text,
            time.monotonic() - self.started,
        )


def start(function: Callable[[], Any]) -> Child:
    """Run a function in a forked child.

    Raises:
        RuntimeError: This process has other threads, whose locks a child would find held.
    """
    if threading.active_count() > 1:
        raise RuntimeError(f"cannot fork beside {threading.active_count() - 1} other threads")
    handle, name = tempfile.mkstemp(suffix=".out")
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        os.close(handle)
        return Child(pid, Path(name))
    code = 1
    try:
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        function()
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
    except (GVRError, LineFailed) as error:
        print(f"gvr: {error}", file=sys.stderr)  # as the command line does
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def run(function: Callable[[], Any], timeout: float = 120.0) -> Ended:
    """Run a function in a forked child, to its end."""
    return start(function).wait(timeout)

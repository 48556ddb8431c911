"""How a command's process ends."""

from __future__ import annotations

import atexit
import os
import sys
import threading
from collections.abc import Callable
from typing import NoReturn


def run_and_leave(command: Callable[[], object]) -> NoReturn:
    """Run a command as the whole of a process, and end it.

    Threads are waited for, exit handlers run, and streams are flushed, as at any end of Python.
    Only memory is left to the system: freeing it object by object takes seconds after a run. This
    is how `multiprocessing` ends its children. Errors that are not exits end in Python's own way.

    Args:
        command: Ends by returning, or as `sys.exit` ends it.
    """
    try:
        command()
        code: object = None
    except SystemExit as end:
        code = end.code
    if not (code is None or isinstance(code, int)):
        print(code, file=sys.stderr)
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # whoever read it is gone; 120 is what Python then exits with
            code = code or 120
    os._exit(code or 0)

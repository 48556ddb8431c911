"""The process of the project's Prefect server: ``python -m tasks.prefect_serve HOME PORT``.

It serves on 127.0.0.1 and ends by itself when nobody holds the home's ``users.lock`` any more: a
command that is killed lets go of the lock, so no server stays behind.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from gvr_core.errors import StoreError
from gvr_core.locks import file_lock

HOST = "127.0.0.1"
LOOK_SECONDS = 1.0
END_SECONDS = 10.0


def main(home: Path, port: int) -> None:
    """Serve until the last user is gone, or SIGTERM."""
    import uvicorn

    threading.Thread(target=_end_without_users, args=(home,), daemon=True).start()
    uvicorn.run(
        "prefect.server.api.server:create_app",
        factory=True,
        host=HOST,
        port=port,
        log_level="error",
        lifespan="on",
    )


def _end_without_users(home: Path) -> None:
    while True:
        time.sleep(LOOK_SECONDS)
        with ExitStack() as held:
            try:
                held.enter_context(file_lock(home / "users.lock", timeout=0))
                # Whoever is about to join or to start a server holds this one, and waits for it
                # until this process is gone with all that it has written.
                held.enter_context(file_lock(home / "start.lock", timeout=0))
            except StoreError:
                continue
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(END_SECONDS)
            os._exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))

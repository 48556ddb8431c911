"""Leases: one machine computes, the others wait, although they share nothing but a remote folder.

A lease is a small file that is created only where it is not there, and rewritten every few
seconds by its holder. One that has stopped changing is taken over. Only the waiter's own clock
is used, so clocks may differ. Where two hold one lease for a moment (a folder without exclusive
creation, a holder that slept for a minute), both compute: a waste, and no harm, since what they
store is named by its content.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from gvr_core.errors import RemoteError
from gvr_core.remote_folder import RemoteFolder
from tasks.records import StageRecord

EXPIRY_SECONDS = 60.0
"""A lease that did not change for so long has lost its holder."""

POLL_SECONDS = 1.0

log = logging.getLogger(__name__)


@contextmanager
def lease(
    folder: RemoteFolder,
    name: str,
    ready: Callable[[], StageRecord | None],
    *,
    expiry: float = EXPIRY_SECONDS,
    poll: float = POLL_SECONDS,
) -> Iterator[StageRecord | None]:
    """Hold a lease for the length of a ``with`` block, or get what its holder made.

    Args:
        folder: Where the lease lies.
        name: Its name.
        ready: Looks for the result; asked again and again while another holds the lease, and
            once after this one got it.
        expiry: Seconds without change after which a lease is taken over.
        poll: Seconds between two looks.

    Yields:
        The result, where another machine made it meanwhile; None where it is to be computed now.
        That also where the folder cannot be reached: computing does not depend on it.
    """
    try:
        found = _wait(folder, name, ready, expiry, poll)
    except RemoteError as error:
        log.debug("no lease: %s", error)
        found = None
    if not isinstance(found, str):
        yield found
        return
    ended = threading.Event()
    keeper = threading.Thread(
        target=_renew, args=(folder, name, found, expiry / 4, ended), daemon=True
    )
    keeper.start()
    try:
        yield None
    finally:
        ended.set()
        keeper.join(timeout=expiry)
        _release(folder, name, found)


def _wait(
    folder: RemoteFolder,
    name: str,
    ready: Callable[[], StageRecord | None],
    expiry: float,
    poll: float,
) -> StageRecord | str:
    """The result, or the owner's name under which the lease was taken."""
    owner = uuid.uuid4().hex
    seen: bytes | None = None
    since = time.monotonic()
    while True:
        if folder.create(name, _text(owner, 0)):
            try:
                record = ready()
            except BaseException:
                _release(folder, name, owner)
                raise
            if record is None:
                return owner
            _release(folder, name, owner)
            return record
        record = ready()
        if record is not None:
            return record
        now = folder.read(name, 200)
        if now != seen:
            seen, since = now, time.monotonic()
        elif time.monotonic() - since > expiry:
            folder.remove(name)
            continue
        time.sleep(poll)


def _renew(
    folder: RemoteFolder, name: str, owner: str, pause: float, ended: threading.Event
) -> None:
    beat = 0
    while not ended.wait(pause):
        beat += 1
        try:
            folder.write(name, _text(owner, beat))
        except RemoteError as error:
            log.debug("lease not renewed: %s", error)


def _release(folder: RemoteFolder, name: str, owner: str) -> None:
    try:
        held = folder.read(name, 200)
        if held is not None and held.startswith(owner.encode()):
            folder.remove(name)
    except RemoteError as error:
        log.debug("lease not released: %s", error)  # it expires


def _text(owner: str, beat: int) -> bytes:
    return f"{owner} {beat}\n".encode()

"""One file over HTTP into a partial file, which later calls go on with.

Beside the partial file ``.NAME.part`` lies ``.NAME.part.json``, which says of what it is a part:
the URL, what the server calls this version of the file (ETag, Last-Modified), its size. A later
call asks for the bytes that are missing, on condition that the server still has that version
(RFC 9110, sections 13.1.5 and 14), and starts anew where it has not.
"""

from __future__ import annotations

import json
import logging
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import httpx
from pydantic import TypeAdapter, ValidationError

from gvr_core.atomic import atomic_write
from gvr_core.errors import ModelError
from gvr_core.weights.offers import AgainError, Offer, Wanted, check_offer, check_status, offer_of

log = logging.getLogger(__name__)

Progress = Callable[[int, int | None], None]
"""Told the bytes that are there, and how many there will be, where that is known."""

_TIMEOUT = httpx.Timeout(60, connect=20)
_HEADERS = {"User-Agent": "gvr-bench", "Accept-Encoding": "identity"}


@dataclass(frozen=True)
class Patience:
    """How often an attempt is repeated that brought nothing new."""

    tries: int = 5
    pause: float = 0.5
    """Seconds before the second attempt; doubled each time."""


PATIENCE = Patience()
"""What is usual."""


def transfer(
    wanted: Wanted,
    part: Path,
    check_room: Callable[[int], None],
    progress: Progress,
    patience: Patience = PATIENCE,
) -> Offer:
    """Fetch a file into a partial file, going on with what is there.

    Args:
        wanted: The file.
        part: The partial file; its folder exists.
        check_room: Told how many bytes will be written, before they are; may refuse.
        progress: Told about each piece.
        patience: How often a broken connection is taken up again without any progress.

    Returns:
        What the server said of the file. All of it is in ``part``, and on disk.

    Raises:
        NotThereError: if the server has no such file.
        ModelError: for another refusal of the server, a file of another size or digest than
            wanted, or a server that cannot be reached. A partial file stays where it may help.
    """
    failures, most = 0, _length(part)
    with httpx.Client(follow_redirects=True, timeout=_TIMEOUT, headers=_HEADERS) as client:
        while True:
            try:
                return _attempt(client, wanted, part, check_room, progress)
            except httpx.UnsupportedProtocol as error:
                raise ModelError(f"redirects elsewhere: {error}", path=wanted.url) from error
            except (httpx.TransportError, AgainError) as error:
                reached = _length(part)
                # A connection that was never made is no broken one, unless bytes came before it.
                hopeless = isinstance(error, httpx.ConnectError) and reached == most == 0
                failures = 0 if reached > most else failures + 1
                most = max(most, reached)
                reason = str(error) or type(error).__name__
                if hopeless or failures >= patience.tries:
                    raise _gave_up(wanted, reason, reached) from error
                log.info("%s: %s; trying again from byte %d", wanted.url, reason, reached)
                time.sleep(patience.pause * 2 ** (failures - 1))
            except httpx.HTTPError as error:
                raise _gave_up(wanted, str(error), _length(part)) from error
            except httpx.InvalidURL as error:
                raise ModelError(f"is no URL: {error}", path=wanted.url) from error


def forget(part: Path) -> None:
    """Delete a partial file, and what is known of it."""
    for path in (part, _record_path(part)):
        with suppress(FileNotFoundError):
            path.unlink()


def _attempt(
    client: httpx.Client,
    wanted: Wanted,
    part: Path,
    check_room: Callable[[int], None],
    progress: Progress,
) -> Offer:
    have, before = _resumable(part, wanted)
    if before is not None and have == before.size:
        return before
    with client.stream("GET", wanted.url, headers=_range(have, before)) as response:
        check_status(response, wanted)
        offer = offer_of(response, wanted)
        if not have and response.status_code != httpx.codes.OK:
            raise ModelError(f"HTTP {response.status_code}, unasked", path=wanted.url)
        if have and not _continues(response, offer, before, have):
            if response.status_code != httpx.codes.OK:
                forget(part)
                raise AgainError("the file has changed on the server")
            have = 0
        check_offer(offer, wanted)
        if offer.size is not None:
            check_room(offer.size - have)
        try:
            _receive(response, part, have, offer, progress)
        except OSError as error:
            raise ModelError(f"cannot be written: {error.strerror}", path=part) from error
    if offer.size is not None and _length(part) < offer.size:
        raise AgainError("the connection ended before the file")
    return offer


def _receive(
    response: httpx.Response, part: Path, have: int, offer: Offer, progress: Progress
) -> None:
    with part.open("ab" if have else "wb") as file:
        # Before any byte of it: a partial file whose record names another version is worthless.
        with atomic_write(_record_path(part)) as record:
            record.write(json.dumps(asdict(offer)).encode())
        done = have
        progress(done, offer.size)
        for piece in response.iter_raw():
            done += len(piece)
            if offer.size is not None and done > offer.size:
                raise ModelError(f"sends more than {offer.size:,} bytes", path=offer.url)
            file.write(piece)
            file.flush()
            progress(done, offer.size)


def _resumable(part: Path, wanted: Wanted) -> tuple[int, Offer | None]:
    """Bytes of a partial file that can be gone on with, and what it is a part of."""
    have = _length(part)
    try:
        offer = TypeAdapter(Offer).validate_json(_record_path(part).read_bytes())
    except (OSError, ValidationError):
        return 0, None
    if not have or offer.url != wanted.url or (offer.size is not None and have > offer.size):
        return 0, None
    # Without a name for its version, only a digest can tell whether the pieces fit together.
    if offer.validator is None and wanted.sha256 is None:
        return 0, None
    return have, offer


def _range(have: int, before: Offer | None) -> dict[str, str]:
    if not have or before is None:
        return {}
    headers = {"Range": f"bytes={have}-"}
    if before.validator is not None:
        headers["If-Range"] = before.validator
    return headers


def _continues(response: httpx.Response, offer: Offer, before: Offer | None, have: int) -> bool:
    """Whether a response goes on where a partial file ends."""
    start = re.match(r"bytes (\d+)-", response.headers.get("Content-Range", ""))
    return (
        response.status_code == httpx.codes.PARTIAL_CONTENT
        and start is not None
        and int(start.group(1)) == have
        and before is not None
        # Not every server that knows ranges minds If-Range.
        and offer.validator == before.validator
        and (before.size is None or offer.size == before.size)
    )


def _gave_up(wanted: Wanted, reason: str, reached: int) -> ModelError:
    kept = f"; {reached:,} bytes are kept, and the next call goes on there" if reached else ""
    return ModelError(
        f"cannot be fetched: {reason}{kept}",
        path=wanted.url,
        accepted=f"a server that can be reached, or the file put at {wanted.target} by hand",
    )


def _length(part: Path) -> int:
    return part.stat().st_size if part.is_file() else 0


def _record_path(part: Path) -> Path:
    return part.with_name(part.name + ".json")

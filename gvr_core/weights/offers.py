"""What is wanted of a server, and what its answer says of the file that it sends."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import httpx

from gvr_core.errors import ModelError

_RETRIED = {408, 425, 429, 500, 502, 503, 504}
_NOT_THERE = {404, 410}


class NotThereError(ModelError):
    """The server has no such file."""


class AgainError(Exception):
    """An attempt that failed in a way that may pass."""


@dataclass(frozen=True)
class Offer:
    """What the server says of the file it sends."""

    url: str
    """As it was asked for, before redirects."""
    etag: str | None = None
    """Its strong entity tag."""
    modified: str | None = None
    """Its Last-Modified."""
    size: int | None = None
    """Bytes of the whole file."""
    sha256: str | None = None
    """Its digest, where the server states one: Hugging Face does, as ``X-Linked-ETag``."""

    @property
    def validator(self) -> str | None:
        """What If-Range takes."""
        return self.etag or self.modified


@dataclass(frozen=True)
class Wanted:
    """What is known of a file before it is fetched."""

    url: str
    target: Path
    """Where it will lie, for errors: it may be put there by hand."""
    size: int | None = None
    sha256: str | None = None
    reason: str = ""
    """Why that digest is expected, for the error where the server states another."""


def offer_of(response: httpx.Response, wanted: Wanted) -> Offer:
    """What the headers of an answer say; of the digest also those of redirects on the way."""
    headers = response.headers
    if response.status_code == httpx.codes.PARTIAL_CONTENT:
        total = headers.get("Content-Range", "").rpartition("/")[2]
    else:
        total = headers.get("Content-Length", "")
    etag = headers.get("ETag", "")
    linked = [each.headers.get("X-Linked-ETag", "") for each in (*response.history, response)]
    digests = [re.fullmatch(r'(?:W/)?"?([0-9a-fA-F]{64})"?', each.strip()) for each in linked]
    return Offer(
        url=wanted.url,
        etag=etag if etag.startswith('"') else None,
        modified=headers.get("Last-Modified"),
        size=int(total) if total.isdecimal() else wanted.size,
        sha256=next((match.group(1).lower() for match in digests if match), None),
    )


def check_status(response: httpx.Response, wanted: Wanted) -> None:
    """Refuse an answer that brings no file, except 416: there the caller knows what it asked.

    Raises:
        NotThereError: if the server has no such file.
        AgainError: for a trouble that may pass.
        ModelError: for any other answer that is no file, or came by an unsafe way.
    """
    code = response.status_code
    said = f"HTTP {code} {response.reason_phrase}".strip()
    if wanted.url.startswith("https:") and any(
        each.url.scheme != "https" for each in (*response.history, response)
    ):
        raise ModelError("redirects from https to http", path=wanted.url)
    if code in _NOT_THERE:
        raise NotThereError(
            f"{said}: the server has no such file",
            path=wanted.url,
            accepted=f"a url that exists, or the file put at {wanted.target} by hand",
        )
    if code == httpx.codes.REQUESTED_RANGE_NOT_SATISFIABLE:
        return
    if code in _RETRIED:
        raise AgainError(said)
    if code not in (httpx.codes.OK, httpx.codes.PARTIAL_CONTENT):
        raise ModelError(
            f"{said}: the server does not give the file",
            path=wanted.url,
            accepted=f"a server that does, or the file put at {wanted.target} by hand",
        )
    if response.headers.get("Content-Encoding", "identity") != "identity":
        raise ModelError("the server sends it compressed, unasked", path=wanted.url)


def check_offer(offer: Offer, wanted: Wanted) -> None:
    """Refuse another file than the one wanted before its bytes come.

    Raises:
        ModelError: if size or digest are known on both sides and differ.
    """
    for what, offered, expected in (
        ("size", offer.size, wanted.size),
        ("sha256", offer.sha256, wanted.sha256),
    ):
        if offered is not None and expected is not None and offered != expected:
            raise ModelError(
                f"the server has a file of {what} {offered}",
                path=wanted.url,
                accepted=f"{what} {expected}{wanted.reason if what == 'sha256' else ''}",
            )

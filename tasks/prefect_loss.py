"""A Prefect server that is gone in the middle of a run: one clear error instead of a client's own.

Stages go on without the server, as their results are in the artifact store; it is the end of a
flow that needs it. Prefect's client has tried again for a minute or more by then.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from gvr_core.errors import GVRError


class PrefectLost(GVRError):
    """The Prefect server does not answer, or only that it cannot."""


@contextmanager
def prefect_loss() -> Iterator[None]:
    """Turn what Prefect's client raises where its server is gone into an error of ours.

    Raises:
        PrefectLost: The server could not be reached, or answered with an error of its own.
    """
    import httpx

    try:
        yield
    except httpx.TransportError as error:
        raise _lost(str(error)) from error
    except httpx.HTTPStatusError as error:
        if error.response.status_code < 500:
            raise
        raise _lost(f"it answered {error.response.status_code}") from error


def _lost(why: str) -> PrefectLost:
    return PrefectLost(
        f"the Prefect server is lost: {why}; what stages have computed is in the store,"
        " and the same command goes on from there"
    )

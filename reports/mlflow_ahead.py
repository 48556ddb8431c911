"""MLflow made ready while a run waits for something else.

Importing MLflow and creating an SQLite store with its tables takes seconds, which cost nothing
while the Prefect server starts in a process of its own.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

from reports.mlflow_store import mlflow_client

log = logging.getLogger(__name__)


@contextmanager
def mlflow_ready(tracking_uri: str | None) -> Iterator[None]:
    """Make MLflow ready beside the ``with`` block; at its end it is, or it cannot be.

    Args:
        tracking_uri: As MLflow takes it; None does nothing.
    """
    if tracking_uri is None:
        yield
        return
    # No daemon: a process that ends early must not leave half of a store's migrations.
    thread = Thread(target=make_ready, args=(tracking_uri,), name="mlflow-ready")
    thread.start()
    try:
        yield
    finally:
        thread.join()


def make_ready(tracking_uri: str) -> None:
    """Import MLflow, and create a local store where it is missing.

    What goes wrong is logged and no more: it will go wrong again where the store is used, and be
    reported there.
    """
    try:
        with mlflow_client(tracking_uri):
            pass
    except Exception as error:  # of MLflow, SQLAlchemy, the disk, or ours
        log.debug("MLflow at %s is not ready: %s", tracking_uri, error)

"""Where MLflow keeps its data, and how this program reaches it without waiting or being watched."""

from __future__ import annotations

import fcntl
import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from gvr_core.errors import GVRError
from reports.telemetry import telemetry_variables

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run

T = TypeVar("T")

EXPERIMENT = "gvr-bench"
"""The experiment that runs go to by default."""

_KIND_TAG, _KIND = "mlflow.experimentKind", "custom_model_development"
# Experiments with runs; MLflow's other kind has chats and prompts.

# One retry and five seconds: an outage costs seconds. MLflow's own defaults cost minutes, and a
# server that asks for a pause of an hour would get it.
_IMPATIENT = {
    "MLFLOW_HTTP_RESPECT_RETRY_AFTER_HEADER": "false",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "5",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "0",
    "MLFLOW_ARTIFACT_UPLOAD_DOWNLOAD_TIMEOUT": "5",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
}


class SyncError(GVRError):
    """MLflow could not be filled. The result itself is safe on disk, and can be synced later.

    Args:
        message: What went wrong.
        tracking_uri: The MLflow that was to be filled.
    """

    def __init__(self, message: str, *, tracking_uri: str) -> None:
        self.message = message
        self.tracking_uri = tracking_uri
        super().__init__(f"{tracking_uri}: {message}")


@dataclass(frozen=True)
class LocalStore:
    """A project's own MLflow store: an SQLite file, and artifacts beside it."""

    folder: Path

    @property
    def uri(self) -> str:
        """The tracking URI."""
        return f"sqlite:///{self.database}"

    @property
    def database(self) -> Path:
        """The SQLite file."""
        return self.folder.resolve() / "mlflow.db"

    @property
    def artifacts(self) -> Path:
        """The folder of the runs' artifacts."""
        return self.folder.resolve() / "artifacts"


def local_store(home: Path | None = None) -> LocalStore:
    """The store in a project's home; default: ``GVR_HOME``, else ``.gvr`` in the working folder."""
    folder = Path(os.environ.get("GVR_HOME") or ".gvr") if home is None else home
    return LocalStore(folder / "mlflow")


def default_tracking_uri(home: Path | None = None) -> str:
    """The user's own ``MLFLOW_TRACKING_URI``, else the project's local store."""
    return os.environ.get("MLFLOW_TRACKING_URI") or local_store(home).uri


def quiet_environment() -> dict[str, str]:
    """A copy of the environment, for a child process, with telemetry off unless allowed."""
    return {**os.environ, **telemetry_variables()}


@contextmanager
def mlflow_client(tracking_uri: str) -> Iterator[MlflowClient]:
    """A client that gives up after seconds; a local SQLite store is created where missing.

    The settings live in environment variables, so they hold for the whole process while the
    context is open. Limits that the user has set stay as they are. The registry of models is the
    same store: it is not used, but it would otherwise be looked for elsewhere.

    Args:
        tracking_uri: As MLflow takes it: ``sqlite:///...``, ``http://...``.

    Raises:
        SyncError: if the local store cannot be made or is of another version of MLflow.
    """
    # Before the import: MLflow reads it there, and starts a thread.
    os.environ.update(telemetry_variables())
    with _limits(), _no_database_log():
        from mlflow import MlflowClient

        database = sqlite_database(tracking_uri)
        if database is not None:
            create_store(database)
        yield MlflowClient(tracking_uri=tracking_uri, registry_uri=tracking_uri)


def sqlite_database(tracking_uri: str) -> Path | None:
    """The file behind a ``sqlite:`` URI; None for any other."""
    if not tracking_uri.startswith("sqlite:"):
        return None
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        name = make_url(tracking_uri).database
    except ArgumentError as error:
        raise SyncError(str(error), tracking_uri=tracking_uri) from error
    if not name or name == ":memory:":
        raise SyncError(
            "it names no file (accepted: sqlite:///<path>/mlflow.db)", tracking_uri=tracking_uri
        )
    return Path(name).resolve()


def create_store(database: Path) -> None:
    """Create an SQLite store with its tables, once.

    MLflow's own first use is not safe when two processes come at once: both run the migrations,
    and one of them fails. A lock on a file beside the database puts them in line; the system
    frees it when its holder dies.

    Raises:
        SyncError: if it cannot be written, or its tables are those of another version.
    """
    from mlflow.exceptions import MlflowException
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore
    from sqlalchemy.exc import SQLAlchemyError

    uri = f"sqlite:///{database}"
    try:
        database.parent.mkdir(parents=True, exist_ok=True)
        with locked(database.with_name(f".{database.name}.lock")), _no_database_log():
            SqlAlchemyStore(uri, artifact_root(database).as_uri())  # type: ignore[no-untyped-call]
    except (OSError, MlflowException, SQLAlchemyError) as error:
        raise SyncError(f"cannot be opened or created: {error}", tracking_uri=uri) from error


def begin_store(tracking_uri: str) -> None:
    """Do what filling MLflow takes seconds for and needs no result: its imports, and a new store.

    What goes wrong is said when MLflow is filled, which tries again.
    """
    with suppress(SyncError), mlflow_client(tracking_uri):
        pass


def batches_of(items: Iterable[T], size: int) -> Iterator[list[T]]:
    """Items in lists of a size that MLflow takes in one request."""
    rest = iter(items)
    while batch := list(islice(rest, size)):
        yield batch


def artifact_root(database: Path) -> Path:
    """Where the artifacts of an SQLite store lie; MLflow's own default is the working folder."""
    return database.parent / "artifacts"


def experiment_id(client: MlflowClient, uri: str, name: str) -> str | None:
    """MLflow's id of an experiment, made where missing; None where it is in MLflow's trash."""
    from mlflow.exceptions import MlflowException

    found = client.get_experiment_by_name(name)
    if found is None:
        database = sqlite_database(uri)
        # A server has an artifact store of its own; for a file it is the client who chooses.
        root = None if database is None else artifact_root(database).as_uri()
        try:
            return str(client.create_experiment(name, root, tags={_KIND_TAG: _KIND}))
        except MlflowException:
            found = client.get_experiment_by_name(name)  # another process was faster
            if found is None:
                raise
    return str(found.experiment_id) if found.lifecycle_stage == "active" else None


def search_all(client: MlflowClient, experiment: str, filter_string: str) -> Iterator[Run]:
    """All runs of an experiment that a filter lets through, page by page."""
    token = None
    while True:
        page = client.search_runs(
            [experiment], filter_string=filter_string, max_results=1000, page_token=token
        )
        yield from page
        token = page.token
        if not token:
            return


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold an exclusive lock on a file (made where missing) or on an existing folder."""
    flags = os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT
    handle = os.open(path, flags | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@contextmanager
def _limits() -> Iterator[None]:
    added = {name: value for name, value in _IMPATIENT.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


@contextmanager
def _no_database_log() -> Iterator[None]:
    # Dozens of lines about tables that nobody asked for; errors still come as exceptions, and
    # would be shown twice, the first time with a traceback.
    loggers = [logging.getLogger(name) for name in ("mlflow.store.db.utils", "alembic")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)

"""The Prefect that stages run under: a project-local one, unless the user has one already.

Whoever has set PREFECT_API_URL, PREFECT_PROFILE or PREFECT_HOME, or has a profiles file in
``~/.prefect``, keeps their own server and home; only settings they left alone are changed, and
only for the length of the context. All others get a home in ``.gvr/prefect`` and a server on
127.0.0.1 that lives as long as a command uses it.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reports.telemetry import telemetry_allowed, telemetry_variables
from tasks.prefect_drain import FLUSH_SECONDS
from tasks.prefect_server import START_TIMEOUT_SECONDS, joined_server, local_server
from tasks.store import Store

DEFAULT_HOME = Path(".gvr/prefect")

_USER_VARIABLES = (
    "PREFECT_API_URL",
    "PREFECT_PROFILE",
    "PREFECT_HOME",
    "PREFECT_PROFILES_PATH",
)


@dataclass(frozen=True)
class PrefectRuntime:
    """The Prefect in use."""

    api_url: str
    home: Path
    own_home: bool
    """Whether the home is the project's, not the user's."""
    own_server: bool
    """Whether it is the project's own server, which ends with the last command that uses it."""


def user_has_prefect() -> bool:
    """Whether the user chose a Prefect server, profile or home (environment or ~/.prefect)."""
    if any(os.environ.get(name) for name in _USER_VARIABLES):
        return True
    return (Path.home() / ".prefect" / "profiles.toml").exists()


@contextmanager
def prefect_runtime(
    store: Store,
    *,
    home: Path | str | None = None,
    isolated: bool = False,
    quiet: bool = True,
    meanwhile: Callable[[], object] | None = None,
) -> Iterator[PrefectRuntime]:
    """Settings, home and server for flows, for the length of a ``with`` block.

    Processes started inside it find the same server and home through the environment. Inside
    another such block the server and home are kept, and only the result storage changes.

    Args:
        store: Prefect's own results go to ``prefect-results`` in there.
        home: The project-local home; ``.gvr/prefect`` under the current folder where None.
        isolated: Use the project-local home even where the user has a Prefect of their own.
        quiet: Show warnings and errors of Prefect only, and no traceback of an error that
            reaches the caller anyway.
        meanwhile: Called while the project's own server starts, where it has to be started.

    Raises:
        StoreError: The server does not start.
    """
    nested = _active[-1] if _active else None
    local = nested.own_home if nested else isolated or not user_has_prefect()
    chosen = nested.home if nested else Path(home or DEFAULT_HOME).expanduser().resolve()
    with ExitStack() as stack:
        stack.enter_context(_environment(**telemetry_variables()))
        if quiet and "PREFECT_LOGGING_LEVEL" not in os.environ:
            stack.enter_context(_environment(PREFECT_LOGGING_LEVEL="WARNING"))
        if local:
            chosen.mkdir(parents=True, exist_ok=True)
            # Importing Prefect makes its home, so the choice has to be known by then.
            stack.enter_context(_environment(PREFECT_HOME=str(chosen)))
        import prefect.context
        import prefect.main  # sets up the loggers, which `_quiet_loggers` then changes
        from prefect.settings import get_current_settings, temporary_settings

        changes = _always(store)
        if local:
            changes |= _home(chosen)
        stack.enter_context(
            temporary_settings(
                updates=changes,
                set_defaults=_unless_set(quiet),
                restore_defaults=["api.url", "api.key"] if isolated and not nested else [],
            )
        )
        if quiet:
            stack.enter_context(_quiet_loggers())
        settings = get_current_settings()
        url = settings.api.url
        own_server = url is None
        if url is None:
            url = stack.enter_context(local_server(settings.home, meanwhile))
        elif nested is None:
            stack.enter_context(joined_server(settings.home, url))
        stack.enter_context(_environment(PREFECT_API_URL=url))
        # Also for threads that do not copy the context of the thread that starts them.
        stack.enter_context(
            prefect.context._temporary_global_settings_context(
                prefect.context.get_settings_context()
            )
        )
        runtime = PrefectRuntime(url, settings.home, local, own_server)
        _active.append(runtime)
        stack.callback(_active.remove, runtime)
        yield runtime


_active: list[PrefectRuntime] = []


def _always(store: Store) -> dict[Any, Any]:
    """Settings that stages rely on."""
    return {
        # With a heartbeat each flow and subflow ends with a second of waiting.
        "flows.heartbeat_frequency": None,
        "results.local_storage_path": store.root / "prefect-results",
        "results.default_serializer": "json",
        **({} if telemetry_allowed() else {"server.analytics_enabled": False}),
    }


def _home(home: Path) -> dict[Any, Any]:
    """Settings that Prefect derives from its home when it is imported."""
    return {
        "home": home,
        "profiles_path": home / "profiles.toml",
        "server.memo_store_path": home / "memo_store.toml",
        "server.database.connection_url": f"sqlite+aiosqlite:///{home / 'prefect.db'}",
    }


def _unless_set(quiet: bool) -> dict[Any, Any]:
    """Settings that give way to the user's own."""
    values: dict[Any, Any] = {
        "server.ephemeral.startup_timeout_seconds": START_TIMEOUT_SECONDS,
        # Task runs reach the server as events. One at a time, SQLite stalls for up to a minute
        # when many stages end together; nothing here reads the events themselves.
        "server.services.task_run_recorder.read_batch_size": 100,
        "server.services.task_run_recorder.batch_size": 100,
        "server.services.task_run_recorder.flush_interval": FLUSH_SECONDS,
        "server.services.event_persister.enabled": False,
    }
    if quiet:
        values["logging.level"] = "WARNING"
        values["server.logging_level"] = "ERROR"
    return values


@contextmanager
def _environment(**values: str) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _quiet_loggers() -> Iterator[None]:
    """Prefect sets its loggers up once; settings made later do not reach them."""
    logger = logging.getLogger("prefect")
    before = logger.level
    logger.setLevel(max(before, logging.WARNING))
    consoles = [
        handler
        for handler in logging.getLogger().handlers
        if type(handler).__name__ == "PrefectConsoleHandler"
    ]
    for handler in consoles:
        handler.addFilter(_reaches_nobody_else)
    try:
        yield
    finally:
        logger.setLevel(before)
        for handler in consoles:
            handler.removeFilter(_reaches_nobody_else)


def _reaches_nobody_else(record: logging.LogRecord) -> bool:
    """False for what a run logs about an error that its caller gets as an exception.

    Each is logged three times with its traceback: by the task, by its end, and by the flow. The
    warning is about the error itself, which is no JSON; it is not a result that was lost. All of
    them still reach the server's log.
    """
    if record.name not in ("prefect.task_runs", "prefect.flow_runs"):
        return True
    return not record.getMessage().startswith(_ABOUT_THE_ERROR)


_ABOUT_THE_ERROR = (
    "Task run failed with",
    "Encountered exception during execution",
    "Finished in state",
    "Failed to write result: Failed to serialize object of type",
)

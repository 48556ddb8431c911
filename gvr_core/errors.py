"""The errors of this project: one tree, and each says what was found, where, and what is accepted.

::

    GVRError
    ├── InputError            something a user gave; the command line ends with exit code 2
    │   ├── SplatFormatError      a .ply or .splat file
    │   ├── CameraFormatError     a camera file or a COLMAP model
    │   ├── DatasetError          a data set's folder, masks, labels or queries
    │   ├── ConfigError           a suite file, or an unknown name of a method, scene, ...
    │   ├── ModelError            a model's weights or its name
    │   ├── PluginError           what an installed package brings, and cannot be used
    │   └── ResultError           a result's folder (reports.result_check)
    ├── SceneLost             a scene's process died or was ended (flows.scene_process)
    ├── StoreError            the artifact store: a damaged object, a record that is not ours
    │   └── RemoteError           a folder behind a URL that does not answer, or refuses
    ├── ResultWriteError      a disk that does not take a result (reports.result_check)
    ├── PrefectLost           the Prefect server is gone (tasks.prefect_loss)
    ├── SyncError             MLflow could not be filled (reports.mlflow_store)
    └── ServerError           MLflow's pages could not be served (reports.mlflow_server)
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

NEAR = 0.7
"""How alike a known name must be, of 1, to be taken for the one that was meant."""

MOST_NAMES = 40
"""Of the names that exist, at most so many are listed."""


class GVRError(Exception):
    """Base of all errors raised on purpose by this project."""


class InputError(GVRError):
    """Something a user gave cannot be used.

    Args:
        message: What was found.
        path: The file or folder it was found in.
        place: Where in the file: a line, a column, a key, a vertex.
        accepted: What would have been accepted instead.
    """

    def __init__(
        self,
        message: str,
        *,
        path: Path | str | None = None,
        place: str | None = None,
        accepted: str | None = None,
    ) -> None:
        self.message = message
        self.path = None if path is None else str(path)
        self.place = place
        self.accepted = accepted
        where = ", ".join(part for part in (self.path, place) if part)
        text = f"{where}: {message}" if where else message
        super().__init__(f"{text} (accepted: {accepted})" if accepted else text)


class SplatFormatError(InputError):
    """A .ply or .splat file that does not hold a usable set of Gaussians."""


class CameraFormatError(InputError):
    """A camera file or COLMAP model that cannot be used."""


class DatasetError(InputError):
    """A data set whose folder, pictures, masks, labels or queries are not as its layout says."""


class ConfigError(InputError):
    """A suite file or command line with an unknown or impossible setting."""


class ModelError(InputError):
    """A model that is not known here, or whose weights are not what they should be."""


class PluginError(InputError):
    """Something that an installed package brings cannot be loaded, or is not what it should be."""


class StoreError(GVRError):
    """The artifact store holds something damaged, or something that is not ours."""


class RemoteError(StoreError):
    """A folder behind a URL did not do what it was asked.

    Args:
        message: What was asked for, of which URL, and what came back.
        refused: Whether it answered with a refusal (no such bucket, no permission), which asking
            again does not change; else it could not be reached or failed.
    """

    def __init__(self, message: str, *, refused: bool = False) -> None:
        super().__init__(message)
        self.refused = refused


def some_of(names: Iterable[str], most: int = 3) -> str:
    """The first few names, and how many more there are.

    Args:
        names: What an error is about.
        most: How many are named.
    """
    listed = list(names)
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return ", ".join(listed[:most]) + more


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ConfigError:
    """The error for a name that is not registered, listing those that are.

    A known name that differs in a few letters is asked for: most unknown names are misspelt.

    Args:
        kind: What the name should name, e.g. ``"method"``.
        name: The name that was given.
        known: The names that exist.
    """
    names = sorted(known)
    return ConfigError(
        f"unknown {kind} {name!r}{did_you_mean(name, names)}",
        accepted=some_of(names, MOST_NAMES) or "none",
    )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'sam:vit_h'?`` where a known name differs in a few letters, else nothing."""
    lower = {one.lower(): one for one in known}
    near = get_close_matches(name.lower(), lower, n=1, cutoff=NEAR)
    return f"; did you mean {lower[near[0]]!r}?" if near else ""

"""What the shell offers after a Tab: names that are known, and folders that are there.

Each function takes what was typed so far. Modules are imported when they are asked for, since a
shell waits for the answer; and what cannot be listed offers nothing, since it has no place for
errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import typer

from flows.bundled import DEFAULT_SUITE, bundled_suites
from flows.places import results_root
from gvr_core.errors import GVRError
from gvr_core.method_names import METHODS

Names = Callable[[], Iterable[str]]
Complete = Callable[[str], list[str]]


def _offers(names: Names) -> Complete:
    """A completion that offers those of some names that begin as what was typed."""

    def complete(incomplete: str) -> list[str]:
        with suppress(GVRError, OSError):
            return [name for name in names() if name.startswith(incomplete)]
        return []

    complete.__doc__ = names.__doc__
    return complete


@_offers
def methods() -> Iterable[str]:
    """Names of methods, plugins' included."""
    from gvr_core import plugins

    return [*METHODS, *plugins.offered(plugins.METHODS)]


@_offers
def model_sets() -> Iterable[str]:
    """Labels of the bundled sets of models."""
    from flows.lines import BUNDLED

    return BUNDLED


@_offers
def checkpoints() -> Iterable[str]:
    """Names of checkpoints, with those of the user's own manifest."""
    from gvr_core.weights.folder import models_folder
    from gvr_core.weights.manifest import known

    return known(models_folder())


@_offers
def datasets() -> Iterable[str]:
    """Names of data sets, plugins' included."""
    from datasets.captures import CAPTURES
    from datasets.registry import DATASETS, FOLDER
    from gvr_core import plugins

    return [*DATASETS, *plugins.offered(plugins.DATASETS), FOLDER, CAPTURES]


@_offers
def layouts() -> Iterable[str]:
    """Layouts of scenes."""
    from datasets.recognise import CAPTURE, EXPECTED, NATIVE

    return [*EXPECTED, NATIVE, CAPTURE]


@_offers
def protocols() -> Iterable[str]:
    """Ids of protocols."""
    from gvr_core.protocols import PROTOCOLS

    return PROTOCOLS


@_offers
def stages() -> Iterable[str]:
    """Names of stages."""
    from tasks.stages import STAGES

    return [planned.stage.name for planned in STAGES]


@_offers
def runners() -> Iterable[str]:
    """Names of runners."""
    return ("serial", "threads", "processes", "dask")


def suites(incomplete: str) -> list[str]:
    """Bundled suites, and .toml files."""
    bundled = [name for name in bundled_suites() if name.startswith(incomplete)]
    return [*bundled, *_paths(incomplete, lambda path: path.suffix == ".toml")]


def results(incomplete: str) -> list[str]:
    """Ids of the local results, the newest first, and folders of results."""
    root = results_root()
    if isinstance(root, str):
        return []  # a shell does not wait for a network
    ids = sorted((path.parent.name for path in root.glob("[!.]*/result.json")), reverse=True)
    matching = [name for name in ids if name.startswith(incomplete)]
    return [*matching, *_paths(incomplete, lambda path: (path / "result.json").exists())]


def scenes(ctx: typer.Context, incomplete: str) -> list[str]:
    """Scenes of the suite, or of the data sets, that the line names already."""
    from flows.suite import override, read_suite, resolve_scenes

    # An option that has no value yet keeps arguments from being parsed: they are left over.
    named = next(iter(ctx.args), None) or ctx.params.get("suite") or DEFAULT_SUITE
    with suppress(GVRError, OSError):
        suite = override(read_suite(named), datasets=tuple(ctx.params.get("dataset") or ()))
        names = dict.fromkeys(scene for _, scene in resolve_scenes(suite.datasets))
        return [name for name in names if name.startswith(incomplete)]
    return []


def dataset_scenes(ctx: typer.Context, incomplete: str) -> list[str]:
    """Scenes of the data set that the line names already."""
    from datasets.registry import get_dataset

    with suppress(GVRError, OSError):
        known = get_dataset(str(ctx.params.get("dataset")), {}).scenes()
        return [name for name in known if name.startswith(incomplete)]
    return []


def _paths(incomplete: str, wanted: Callable[[Path], bool]) -> Iterator[str]:
    """Paths that are wanted and the folders on the way to them; hidden ones only when asked for."""
    folder, slash, begun = incomplete.rpartition("/")
    with suppress(OSError):
        for path in sorted(Path(folder + slash or ".").iterdir()):
            if not path.name.startswith(begun) or path.name.startswith(".") > begun.startswith("."):
                continue
            if wanted(path):
                yield f"{folder}{slash}{path.name}"
            elif path.is_dir():
                yield f"{folder}{slash}{path.name}/"

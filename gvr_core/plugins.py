"""Parts that other installed packages bring: entry points, found by name and loaded when named.

A package registers what it brings in its ``pyproject.toml``::

    [project.entry-points."gvr_bench.methods"]
    nearest = "my_package.nearest:make"

Nothing is looked for while only names of the project's own are asked for. What is loaded keeps an
:attr:`Plugin.origin` (distribution, version, digest of the code), which goes into cache keys: what
another version of a plugin has computed is not taken for this one's.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from gvr_core.errors import ConfigError, GVRError, PluginError

DATASETS = "gvr_bench.datasets"
"""Entry points that make data sets: ``make(**settings)`` -> ``datasets.base.Dataset``."""
MODELS = "gvr_bench.models"
"""Entry points that make models: ``make(**options)`` -> a segmenter or an encoder, or
``make(segmenter, encoder, **options)`` -> a text segmenter."""
METHODS = "gvr_bench.methods"
"""Entry points that make methods: ``make(tools, name, **options)`` -> ``Method``."""
RENDERERS = "gvr_bench.renderers"
"""Entry points that make renderers: ``make()`` -> ``Renderer``."""

GROUPS = (DATASETS, MODELS, METHODS, RENDERERS)


@dataclass(frozen=True)
class Plugin:
    """An entry point that has been loaded."""

    name: str
    """What suites call it."""
    origin: str
    """Distribution, its version, and the digest of the code: part of cache keys."""
    distribution: str
    version: str
    place: str
    """The entry point as errors show it."""
    make: Callable[..., Any]
    """What the entry point refers to."""

    def made(self, needed: tuple[str, ...], *arguments: Any, **options: Any) -> Any:
        """What the plugin makes.

        Args:
            needed: Names of what it must have to play its role.
            arguments: What a plugin of its group is given.
            options: What the suite tells it.

        Raises:
            PluginError: if it fails, or makes something that lacks a part.
            GVRError: as the plugin itself raises it.
        """
        try:
            thing = self.make(*arguments, **options)
        except GVRError:
            raise
        except Exception as error:
            raise self.error(
                f"{type(error).__name__}: {error}", "options that the plugin knows"
            ) from error
        missing = [name for name in needed if not hasattr(thing, name)]
        if missing:
            raise self.error(
                f"{type(thing).__name__} has no {', '.join(missing)}",
                f"an object with {', '.join(needed)}",
            )
        return thing

    def error(self, message: str, accepted: str | None = None) -> PluginError:
        """An error that names the distribution and the entry point."""
        return PluginError(
            message,
            path=f"{self.distribution} {self.version}",
            place=self.place,
            accepted=accepted,
        )


class Known:
    """What a plugin made, under a name that says which version of which distribution made it.

    Args:
        thing: A model or a renderer; everything but its name is its own.
        origin: See :attr:`Plugin.origin`.
    """

    def __init__(self, thing: Any, origin: str) -> None:
        self._thing = thing
        self._origin = origin

    @property
    def name(self) -> str:
        """Its own name, and where it is from; part of every cache key below it."""
        return f"{self._thing.name} [{self._origin}]"

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("_"):  # copying and pickling ask before there is a _thing
            raise AttributeError(attribute)
        return getattr(self._thing, attribute)


def offered(group: str) -> tuple[str, ...]:
    """Names that installed packages offer in a group, in alphabetical order; nothing is loaded."""
    return tuple(sorted(_entry_points(group)))


def is_offered(group: str, name: str) -> bool:
    """Whether an installed package offers a name; nothing is loaded."""
    return name in _entry_points(group)


@lru_cache(maxsize=64)
def load(group: str, name: str) -> Plugin:
    """Load what an installed package offers under a name.

    Args:
        group: One of :data:`GROUPS`.
        name: One of :func:`offered`.

    Raises:
        ConfigError: if several packages offer it.
        PluginError: if it cannot be imported, naming distribution and entry point.
    """
    first, *others = _entry_points(group)[name]
    if others:
        sources = ", ".join(sorted(_source(point) for point in (first, *others)))
        raise ConfigError(
            f"{len(others) + 1} packages offer {name!r} in {group}: {sources}",
            accepted="one of them installed",
        )
    distribution, version = _distribution(first)
    place = f"[{group}] {first.name} = {first.value}"
    try:
        thing = first.load()
    except Exception as error:
        raise PluginError(
            f"{type(error).__name__}: {error}",
            path=f"{distribution} {version}",
            place=place,
            accepted="a plugin that can be imported",
        ) from error
    origin = f"{distribution} {version} {_code_digest(first.module)[:16]}"
    plugin = Plugin(name, origin, distribution, version, place, thing)
    if not callable(thing):
        raise plugin.error(f"a {type(thing).__name__}", "a class or a function")
    _LOADED[distribution] = version
    return plugin


_LOADED: dict[str, str] = {}


def loaded() -> Mapping[str, str]:
    """Distributions whose plugins this process has loaded, with their versions."""
    return dict(_LOADED)


@dataclass(frozen=True)
class Offer:
    """A name that a package offers, for people to read."""

    group: str
    name: str
    source: str
    """Distribution and version."""


def all_offers() -> tuple[Offer, ...]:
    """What all installed packages offer, in all groups; nothing is loaded."""
    return tuple(
        Offer(group, name, _source(point))
        for group in GROUPS
        for name, points in sorted(_entry_points(group).items())
        for point in points
    )


@lru_cache(maxsize=len(GROUPS))
def _entry_points(group: str) -> dict[str, list[metadata.EntryPoint]]:
    """The entry points of a group by name; what is installed is read once a process."""
    try:
        found = metadata.entry_points(group=group)
    except Exception as error:  # of any installed package: importlib reads all of them at once
        raise PluginError(
            f"an installed package's entry points cannot be read: {error}", place=group
        ) from error
    by_name: dict[str, list[metadata.EntryPoint]] = {}
    for point in found:
        by_name.setdefault(point.name, []).append(point)
    return by_name


def _distribution(point: metadata.EntryPoint) -> tuple[str, str]:
    if point.dist is None:
        return "unknown distribution", "0"
    return point.dist.name, point.dist.version


def _source(point: metadata.EntryPoint) -> str:
    return " ".join(_distribution(point))


def _code_digest(module: str) -> str:
    """sha256 of the code of the package that a loaded module is in: its files' names and contents.

    The package is the outermost that has an ``__init__.py``; of a module outside any, the module.
    """
    parts = module.split(".")
    for end in range(1, len(parts) + 1):
        file = getattr(sys.modules.get(".".join(parts[:end])), "__file__", None)
        if file:
            break
    else:
        return "no source"
    path = Path(file)
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    total = hashlib.sha256()
    for each in files:
        content = each.read_bytes()
        total.update(f"{each.relative_to(path.parent)}:{len(content)}:".encode())
        total.update(content)
    return total.hexdigest()

"""``gvr doctor``: does this machine have what a benchmark needs?"""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from rich.table import Column, Table
from rich.text import Text

from flows.exit_codes import EXIT_FAILED
from flows.output import console, print_document, say
from gvr_core.errors import GVRError

State = Literal["ok", "note", "bad"]

PACKAGES = ("prefect", "mlflow", "torch", "torchvision", "numpy", "numba", "open_clip_torch")
"""Packages whose versions are worth seeing at a glance."""

SPACE_NEEDED = 2e9
"""Free bytes below which a benchmark's store may not fit."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    what: str
    state: State
    text: str


@dataclass(frozen=True)
class DoctorDocument:
    """What was found."""

    sound: bool
    """Whether nothing is bad; what is worth a note is not."""
    findings: tuple[Finding, ...]


def doctor(store: Path | str, as_json: bool = False) -> int:
    """``gvr doctor``; exit code 1 where something needed does not work."""
    findings = tuple(examine(store))
    sound = all(finding.state != "bad" for finding in findings)
    if as_json:
        print_document("doctor", DoctorDocument(sound, findings))
        return 0 if sound else EXIT_FAILED
    table = Table("", "what", Column("finding", overflow="fold"), box=None)
    for finding in findings:
        mark = {"ok": "[green]ok[/]", "note": "[yellow]--[/]", "bad": "[red]!![/]"}[finding.state]
        table.add_row(mark, finding.what, Text(finding.text))
    console.print(table)
    say("Next: gvr run bench" if sound else "Next: mend what is marked !!, then: gvr doctor")
    return 0 if sound else EXIT_FAILED


def examine(store: Path | str) -> Iterator[Finding]:
    """Look at everything, one finding after the other; a failure becomes a finding.

    Args:
        store: Root of the artifact store, or its URL.
    """
    checks: dict[str, Callable[[], tuple[State, str]]] = {
        "python": _python,
        "packages": _packages,
        "pinned versions": _known_trouble,
        "processor": _processor,
        "store": lambda: _store(store),
        "renderer": _renderer,
        "onboard models": _models,
        "full-strength models": _checkpoints,
        "photographs": _photographs,
        "splats": _splats,
        "plugins": _plugins,
    }
    for what, check in checks.items():
        try:
            state, text = check()
        except GVRError as error:
            state, text = "bad", str(error)
        except Exception as error:
            state, text = "bad", f"{type(error).__name__}: {error}"
        yield Finding(what, state, text)


def _python() -> tuple[State, str]:
    version = ".".join(map(str, sys.version_info[:3]))
    return ("ok" if sys.version_info >= (3, 11) else "bad"), f"{version} (3.11 or newer)"


def _packages() -> tuple[State, str]:
    return "ok", ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)


def _known_trouble() -> tuple[State, str]:
    """Versions that break things without saying so."""
    limits = {"fastapi": (0, 151), "sqlalchemy": (2, 1), "transformers": (5, 0)}
    found, state = [], "ok"
    for name, limit in limits.items():
        version = importlib.metadata.version(name)
        parts = tuple(int(part) for part in version.split(".")[:2])
        good = parts < limit
        state = state if good else "bad"
        found.append(f"{name} {version}{'' if good else f' (needs < {limit[0]}.{limit[1]})'}")
    return ("bad" if state == "bad" else "ok"), ", ".join(found)


def _processor() -> tuple[State, str]:
    from reports.environment import describe_environment

    seen = describe_environment()
    gpu = seen.gpu or "no GPU (the CPU renderer and the onboard models need none)"
    return "ok", f"{seen.cpu_count} x {seen.processor}; {gpu}"


def _store(location: Path | str) -> tuple[State, str]:
    from tasks.store import Store

    store = Store(location)
    store.check()
    root = store.root
    existing = next(path for path in [root, *root.absolute().parents] if path.exists())
    free = shutil.disk_usage(existing).free
    if not os.access(existing, os.W_OK):
        return "bad", f"{existing} cannot be written to"
    text = f"{root}, {free / 1e9:.0f} GB free"
    if store.remote is not None:
        text += f"; shared: {store.url}"
        if store.remote.resting:
            return "note", f"{text}, which does not answer"
    return ("ok" if free > SPACE_NEEDED else "note"), text


def _renderer() -> tuple[State, str]:
    """Draw a few Gaussians with the CPU renderer and with its slow oracle."""
    from gvr_core.cameras import Camera, intrinsics, look_at
    from gvr_core.gaussians import Gaussians
    from gvr_core.rendering import get_renderer

    rng = np.random.default_rng(0)
    quats = rng.normal(size=(50, 4))
    gaussians = Gaussians(
        rng.normal(size=(50, 3)).astype(np.float32),
        rng.uniform(0.05, 0.3, (50, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0.3, 0.9, 50).astype(np.float32),
        rng.normal(size=(50, 1, 3)).astype(np.float32),
    )
    camera = Camera(intrinsics(60, 64, 48), look_at((0, -5, 1), (0, 0, 0), (0, 0, 1)), 64, 48)
    fast = get_renderer("numba").render(gaussians, camera)
    slow = get_renderer("torch-reference").render(gaussians, camera)
    off = float(np.percentile(np.abs(fast.rgb - slow.rgb), 99.9))
    return ("ok" if off < 1e-4 else "bad"), f"CPU renderer within {off:.1e} of its oracle"


def _models() -> tuple[State, str]:
    from gvr_core.models.registry import build_models

    models = build_models()
    vectors = models.encoder.encode_texts(["a cat", "a kitten", "a rocket"])
    near, far = float(vectors[0] @ vectors[1]), float(vectors[0] @ vectors[2])
    state: State = "ok" if near > far else "bad"
    return state, f"cat-kitten {near:.2f} > cat-rocket {far:.2f} ({models.encoder.dim} dimensions)"


def _checkpoints() -> tuple[State, str]:
    """What the models folder holds; a benchmark needs none of it to start with."""
    from gvr_core.models.devices import pick_device
    from gvr_core.weights.folder import State as FileState
    from gvr_core.weights.folder import models_folder, overall, stored
    from gvr_core.weights.manifest import known

    folder = models_folder()
    states = {name: overall(stored(entry, folder)) for name, entry in known(folder).items()}
    here = [name for name, state in states.items() if state is FileState.PRESENT]
    text = f"{len(here)} of {len(states)} in {folder}; networks compute on {pick_device()}"
    return "ok" if here else "note", text


def _photographs() -> tuple[State, str]:
    from datasets.registry import get_dataset

    return "ok", f"gallery scenes: {', '.join(get_dataset('gallery', {}).scenes())}"


def _splats() -> tuple[State, str]:
    from datasets.registry import get_dataset

    try:
        return "ok", f"composite scenes: {', '.join(get_dataset('composite', {}).scenes())}"
    except GVRError as error:
        return "note", f"the composite suite cannot run: {error}"


def _plugins() -> tuple[State, str]:
    """What installed packages bring, each loaded to see whether it can be."""
    from datasets.registry import DATASETS
    from gvr_core import plugins
    from gvr_core.methods import OWN
    from gvr_core.models.registry import is_own_name
    from gvr_core.rendering.base import BACKENDS

    own: dict[str, Callable[[str], bool]] = {
        plugins.DATASETS: DATASETS.__contains__,
        plugins.MODELS: is_own_name,
        plugins.METHODS: OWN.__contains__,
        plugins.RENDERERS: BACKENDS.__contains__,
    }
    offers = plugins.all_offers()
    if not offers:
        return "ok", "none installed"
    listed: list[str] = []
    state: State = "ok"
    for offer in offers:
        text = f"{offer.group.removeprefix('gvr_bench.')}: {offer.name} ({offer.source})"
        if own[offer.group](offer.name):
            text += ", never used: the project has its own of that name"
            state = "bad"
        else:
            try:
                plugins.load(offer.group, offer.name)
            except GVRError as error:
                text += f", which cannot be used: {error}"
                state = "bad"
        listed.append(text)
    return state, "; ".join(listed)

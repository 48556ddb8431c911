"""What ``gvr init`` does, usable without a shell."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.recognise import CAPTURE
from flows.output import print_document, say, warn
from flows.own_scenes import FoundData, look_at
from flows.own_suite import EXAMPLES, check_free, suite_name, suite_text, write_suite


@dataclass(frozen=True)
class InitDocument:
    """What was written, from what."""

    suite: Path
    found: tuple[FoundData, ...]
    next: str
    """The command that runs it."""


def init(
    folder: Path,
    out: Path | None,
    queries: Sequence[str],
    methods: Sequence[str],
    models: str,
    force: bool,
    as_json: bool = False,
) -> None:
    """``gvr init``: write a suite over a folder of scenes.

    Raises:
        ConfigError: for a file that is there or cannot be written, or a name that is not known.
        DatasetError: for a folder without a scene that can be run.
        ModelError: for weights that are missing.
    """
    path = Path(f"{suite_name(folder)}.toml") if out is None else out
    check_free(path, force)  # reading the scenes may take a while
    found = look_at(folder)
    write_suite(path, suite_text(folder, found, queries or EXAMPLES, methods, models))
    captures = any(data.layout == CAPTURE and data.scenes for data in found)
    if queries and not captures:
        warn("--query asks captures, and there are none: these scenes bring their own queries")
    document = InitDocument(path, found, f"gvr run {shlex.quote(str(path))}")
    if as_json:
        print_document("init", document)
        return
    for data in found:
        for scene in data.scenes:
            asked = f"{scene.n_queries} queries" if scene.n_queries else "no labels"
            say(
                f"{data.layout}  {scene.name}: {scene.n_gaussians:,} Gaussians, "
                f"{scene.n_views} views, {asked}"
            )
        for left in data.left_out:
            say(f"left out  {left.name}: {left.why}")
    say(f"Suite: {path}")
    if captures and not queries:
        say(f"Next: put your own queries into {path}, then: {document.next}")
    else:
        say(f"Next: {document.next}")

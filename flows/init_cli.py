"""``gvr init``: a suite for a folder of scenes of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from flows.output import JsonOption, print_document, say
from flows.own_scenes import FoundData, look_at
from flows.own_suite import EXAMPLES, check_free, suite_name, suite_text, write_suite
from gvr_core.methods import METHODS


@dataclass(frozen=True)
class InitDocument:
    """What was written, from what."""

    suite: Path
    found: tuple[FoundData, ...]
    next: str
    """The command that runs it."""


def init(
    folder: Annotated[Path, typer.Argument(help="A folder of scenes, or a single scene.")],
    out: Annotated[
        Path | None, typer.Option(help="The file; NAME.toml here, NAME being the folder's.")
    ] = None,
    query: Annotated[
        list[str] | None,
        typer.Option(help="What to find in scenes without labels; may be given more than once."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(help=f"Of {', '.join(METHODS)}; may be given more than once."),
    ] = None,
    models: Annotated[
        str, typer.Option(help="onboard, mobile-sam, paper, or oracle where all is labelled.")
    ] = "onboard",
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a suite for a folder of your own scenes, ready to edit and to run."""
    path = Path(f"{suite_name(folder)}.toml") if out is None else out
    check_free(path, force)  # reading the scenes may take a while
    found = look_at(folder)
    text = suite_text(folder, found, query or EXAMPLES, method or ["gvr-robust"], models)
    write_suite(path, text)
    document = InitDocument(path, found, f"gvr run {path}")
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
    if any(data.layout == "capture" and data.scenes for data in found) and not query:
        say(f"Next: put your own queries into {path}, then: {document.next}")
    else:
        say(f"Next: {document.next}")

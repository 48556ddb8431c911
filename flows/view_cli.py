"""``gvr view``: a scene in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from flows.lines import bundled_models
from flows.places import store_root
from gvr_core.methods import METHODS, check_method
from gvr_core.models.registry import require_weights

console = Console()


def view(
    scene: Annotated[
        str, typer.Argument(help="A .ply or .splat file, or DATASET/SCENE: gallery/gallery_0.")
    ],
    cameras: Annotated[
        Path | None,
        typer.Option(help="A splat file's cameras: a cameras.json, or a folder with COLMAP's."),
    ] = None,
    method: Annotated[
        str, typer.Option(help=f"One of {', '.join(METHODS)}, or a plugin's.")
    ] = "gvr-robust",
    models: Annotated[
        str, typer.Option(help="onboard, mobile-sam or paper: see `gvr models ls`.")
    ] = "onboard",
    max_views: Annotated[
        int | None, typer.Option(help="Use only so many cameras of a splat file, evenly spaced.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.")] = 8080,
    host: Annotated[str, typer.Option(help="Address to listen at.")] = "127.0.0.1",
    exposed: Annotated[
        bool,
        typer.Option("--exposed", help="Let --host be an address that other machines reach."),
    ] = False,
    store: Annotated[
        str | None,
        typer.Option(
            "--store", help="Artifact store, a folder or a shared URL; GVR_STORE, else .gvr/store."
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars.")] = False,
) -> None:
    """Look at a scene in the browser, and ask for things in it.

    The scene is prepared first (or found in the store). On the page, type what to find and press
    Enter: the target is dyed red, and can be hidden, shown alone, or saved as a PLY; cameras,
    votes and virtual cameras can be shown beside it.
    """
    from flows.view_session import open_scene, start_session
    from flows.viewer import Viewer

    check_method(method, asked=True)
    chosen = bundled_models(models)
    require_weights(chosen)
    data = open_scene(scene, cameras, max_views)
    session = start_session(data, method, chosen, store or store_root(), progress=not quiet)
    source = Path(scene) if cameras is not None else None
    viewer = Viewer(session, port, host, exposed, source)
    console.print(f"{viewer.url}  (Ctrl-C ends it)", highlight=False)
    try:
        viewer.wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.stop()

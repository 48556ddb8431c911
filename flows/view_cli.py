"""``gvr view``: a scene in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import completion
from flows.options import ExposedOption, HostOption, ModelsOption, QuietOption, StoreOption
from flows.places import store_root
from gvr_core.method_names import METHODS


def view(
    scene: Annotated[
        str, typer.Argument(help="A .ply or .splat file, or DATASET/SCENE: gallery/gallery_0.")
    ],
    cameras: Annotated[
        Path | None,
        typer.Option(help="A splat file's cameras: a cameras.json, or a folder with COLMAP's."),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            help=f"One of {', '.join(METHODS)}, or a plugin's.", autocompletion=completion.methods
        ),
    ] = "gvr-robust",
    models: ModelsOption = "onboard",
    max_views: Annotated[
        int | None, typer.Option(help="Use only so many cameras of a splat file, evenly spaced.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.")] = 8080,
    host: HostOption = "127.0.0.1",
    exposed: ExposedOption = False,
    store: StoreOption = None,
    quiet: QuietOption = False,
) -> None:
    """Look at a scene in the browser, and ask for things in it.

    The scene is prepared first (or found in the store). On the page, type what to find and press
    Enter: the target is dyed red, and can be hidden, shown alone, or saved as a PLY; cameras,
    votes and virtual cameras can be shown beside it.
    """
    from flows.lines import bundled_models
    from flows.output import say
    from flows.view_session import open_scene, start_session
    from flows.viewer import Viewer
    from gvr_core.methods import check_method
    from gvr_core.models.registry import require_weights

    check_method(method, asked=True)
    chosen = bundled_models(models)
    require_weights(chosen)
    data = open_scene(scene, cameras, max_views)
    session = start_session(data, method, chosen, store or store_root(), progress=not quiet)
    source = Path(scene) if cameras is not None else None
    viewer = Viewer(session, port, host, exposed, source)
    say(f"{viewer.url}  (Ctrl-C ends it)")
    try:
        viewer.wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.stop()

"""What the command line does; each function is one command, usable without a shell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from datasets.own import own_scene
from flows.job import fill_mlflow
from flows.lines import ONBOARD, bundled_models
from flows.places import home
from gvr_core.atomic import atomic_write
from gvr_core.errors import ConfigError, unknown_name
from gvr_core.exports import EXPORTS, RED, parse_colour
from gvr_core.methods import check_method
from gvr_core.models.registry import require_weights
from gvr_core.protocols import PROTOCOLS
from reports import tables
from reports.document import replace_block
from reports.mlflow_store import default_tracking_uri
from reports.record import Result, Row
from reports.result_io import read_result
from reports.results_place import ResultsPlace
from tasks.store import Store

SHEET_PICTURES = 12
"""At most so many pictures on a sheet."""

console = Console()


def tracking_uri(given: str | None) -> str:
    """The MLflow to fill: the one given, else the user's or the project's own."""
    return given or default_tracking_uri()


def print_tables(result: Result, rows: Sequence[Row]) -> None:
    """The tables of a result, for a terminal."""
    console.print(tables.overview(result, rows))


def ground(
    splat: Path,
    cameras: Path,
    texts: Sequence[str],
    method: str,
    exports: Sequence[str],
    dye: str | None,
    out: Path,
    max_views: int | None,
    store: Path | str,
    progress: bool,
    models: str = ONBOARD.label,
) -> None:
    """``gvr ground``: one scene of one's own.

    Raises:
        ConfigError: for a method, set of models, export, colour or folder that cannot be used;
            nothing is computed then.
        ModelError: for weights that are missing.
    """
    check_method(method, asked=True)
    chosen = bundled_models(models)
    require_weights(chosen)
    for kind in exports:
        if kind not in EXPORTS:
            raise unknown_name("export", kind, EXPORTS)
    if dye is not None and "dyed" not in exports:
        raise ConfigError("--dye colours nothing here", accepted="--dye with --export dyed")
    rgb = RED if dye is None else parse_colour(dye)
    data = own_scene(splat, cameras, texts, max_views)

    from flows.own import check_out, ground_own
    from tasks.prefect_runtime import prefect_runtime

    check_out(data, splat, out, exports)
    known = Store(store)
    known.check()
    with prefect_runtime(known, home=home() / "prefect"):
        answers = ground_own(data, splat, method, out, store, exports, rgb, progress, chosen)
    table = Table("query", "found", "Gaussians", "location", "files", box=None)
    for answer in answers:
        place = "-" if answer.location is None else " ".join(f"{x:.3g}" for x in answer.location)
        found = "yes" if answer.found else "no"
        files = "  ".join(answer.files.values())
        table.add_row(Text(answer.text), found, str(answer.count), place, files)
    console.print(table)
    for answer in answers:
        missing = [kind for kind in dict.fromkeys(exports) if kind not in answer.files]
        if missing:
            why = "it is the whole scene" if answer.found and answer.count else "nothing was found"
            line = f"{answer.text}: {why}, so there is no PLY for: {', '.join(missing)}"
            console.print(Text(line), soft_wrap=True)
    console.print(f"Files in {out}", soft_wrap=True, highlight=False, markup=False)


def find_result(name: str, root: Path | str) -> Path:
    """The folder of a result: a path, an id under the root, or the newest one.

    Raises:
        ConfigError: if there is none.
        RemoteError: if the root is a URL that does not answer.
    """
    if name and (Path(name) / "result.json").exists():
        return Path(name)
    place = ResultsPlace(root)
    known = place.names()
    matches = [run_id for run_id in known if run_id == name] if name else known[-1:]
    if not matches:
        raise unknown_name("result", name or "(newest)", known)
    return place.folder(matches[0])


def show(
    name: str,
    root: Path | str,
    markdown: bool,
    sheet: Path | None = None,
    into: Path | None = None,
) -> None:
    """``gvr show``: the tables of a result again, in a document too, and a sheet of pictures."""
    folder = find_result(name, root)
    result, rows = read_result(folder)
    if into is not None:
        replace_block(into, result.suite, tables.readme_block(result, rows))
        console.print(f"{into}: <!-- {result.suite} -->", markup=False, highlight=False)
    elif markdown:
        print(tables.readme_block(result, rows))
    else:
        print_tables(result, rows)
    if sheet is not None:
        from reports.pictures import contact_sheet  # imports matplotlib

        with atomic_write(sheet) as stream:
            stream.write(contact_sheet(_one_picture_per_object(folder, result)))


def score(name: str, protocols: Sequence[str], store: Path | str, root: Path | str) -> None:
    """``gvr score``: a result's saved predictions under other protocols."""
    from flows.score import score_again

    if not protocols:
        raise ConfigError("no protocol is named", accepted=", ".join(PROTOCOLS))
    folder = score_again(find_result(name, root), protocols, store, root)
    print_tables(*read_result(folder))
    console.print(f"\nResult: {folder}", soft_wrap=True, highlight=False)


def _one_picture_per_object(folder: Path, result: Result) -> list[bytes]:
    """The first method's picture of the first query for each object, thinned out evenly."""
    first = result.scenes[0].method if result.scenes else ""
    pictures: dict[tuple[str, str, str], Path] = {}
    for scene in result.scenes:
        for query in scene.queries if scene.method == first else ():
            # Wordings of one object share the part of the id before the number.
            thing = query.query.rpartition("-")[0] or query.query
            if query.picture is not None:
                pictures.setdefault((scene.dataset, scene.scene, thing), folder / query.picture)
    paths = list(pictures.values())
    step = -(-len(paths) // SHEET_PICTURES) or 1
    return [path.read_bytes() for path in paths[::step]]


def sync(names: Sequence[str], root: Path | str, mlflow: str) -> None:
    """``gvr sync``: fill MLflow from results; those not at their URL yet are copied there first.

    Raises:
        SyncError: if MLflow cannot be reached.
        RemoteError: if the root is a URL that does not answer.
    """
    place = ResultsPlace(root)
    place.push()
    folders = [find_result(name, root) for name in names or place.names()]
    if not folders:
        console.print(f"No results under {root}")
    _fill_mlflow(folders, mlflow)


def _fill_mlflow(folders: Sequence[Path], uri: str) -> None:
    for folder in folders:
        console.print(
            f"MLflow: {fill_mlflow(folder, uri, patient=True)}", soft_wrap=True, highlight=False
        )


def ui(port: int, host: str, exposed: bool) -> None:
    """``gvr ui``: MLflow's pages, on loopback unless told otherwise, until interrupted."""
    from reports.mlflow_server import serve_ui

    serve_ui(port, host, exposed=exposed)


def doctor(store: Path | str) -> int:
    """``gvr doctor``; exit code 1 where something needed does not work."""
    from flows.doctor import examine

    table = Table("", "what", "finding", box=None)
    worst = 0
    for finding in examine(store):
        mark = {"ok": "[green]ok[/]", "note": "[yellow]--[/]", "bad": "[red]!![/]"}[finding.state]
        table.add_row(mark, finding.what, finding.text)
        worst = max(worst, 1 if finding.state == "bad" else 0)
    console.print(table)
    return worst

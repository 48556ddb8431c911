"""What the command line does; each function is one command, usable without a shell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from datasets.own import own_scene
from flows.lines import ONBOARD, bundled_models
from flows.places import home
from flows.suite import override, read_suite, resolve_scenes
from gvr_core.atomic import atomic_write
from gvr_core.errors import ConfigError, unknown_name
from gvr_core.exports import EXPORTS, RED, parse_colour
from gvr_core.methods import METHODS
from gvr_core.models.registry import require_weights
from gvr_core.protocols import PROTOCOLS
from reports import tables
from reports.document import replace_block
from reports.mlflow_store import SyncError, default_tracking_uri
from reports.pictures import contact_sheet
from reports.record import Result, Row
from reports.result_io import list_results, read_result
from tasks.store import Store

SHEET_PICTURES = 12
"""At most so many pictures on a sheet."""

console = Console()
warnings = Console(stderr=True)


def tracking_uri(given: str | None) -> str:
    """The MLflow to fill: the one given, else the user's or the project's own."""
    return given or default_tracking_uri()


def run(
    suite_name: str,
    methods: Sequence[str],
    datasets: Sequence[str],
    scenes: Sequence[str],
    limit: int | None,
    store: Path,
    results: Path,
    mlflow: str | None,
    progress: bool,
    models: Sequence[str] = (),
    exclude_eval_views: bool = False,
) -> int:
    """``gvr run``: run a suite, print its tables, fill MLflow.

    Returns:
        Exit code: 0; 1 where a scene failed; 2 where it failed for something the user gave.
    """
    suite = override(
        read_suite(suite_name), methods, datasets, scenes, limit, models, exclude_eval_views
    )
    resolve_scenes(suite.datasets)
    needed = [line.models for line in suite.lines() if line.method.needs_books]
    for chosen in dict.fromkeys(needed):  # the lines of a set share its models
        require_weights(chosen)

    from flows.benchmark import run_benchmark
    from tasks.prefect_loss import prefect_loss
    from tasks.prefect_runtime import prefect_runtime

    with prefect_loss(), prefect_runtime(Store(store), home=home() / "prefect"):
        outcome = run_benchmark(suite, store, results, progress)
    print_tables(outcome.result, outcome.rows)
    console.print(f"\nResult: {outcome.folder}", soft_wrap=True, highlight=False)
    if mlflow is not None:
        _fill_mlflow([outcome.folder], mlflow)
    for failure in outcome.failed:
        warnings.print(f"failed: {failure}", style="red", markup=False, soft_wrap=True)
    if not outcome.failed:
        return 0
    return 2 if outcome.bad_input else 1


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
    store: Path,
    progress: bool,
    models: str = ONBOARD.label,
) -> None:
    """``gvr ground``: one scene of one's own.

    Raises:
        ConfigError: for a method, set of models, export, colour or folder that cannot be used;
            nothing is computed then.
        ModelError: for weights that are missing.
    """
    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
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
    with prefect_runtime(Store(store), home=home() / "prefect"):
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


def find_result(name: str, root: Path) -> Path:
    """The folder of a result: a path, an id under the root, or the newest one.

    Raises:
        ConfigError: if there is none.
    """
    known = list_results(root)
    if name and (Path(name) / "result.json").exists():
        return Path(name)
    matches = [path for path in known if path.name == name] if name else known[-1:]
    if not matches:
        raise unknown_name("result", name or "(newest)", [path.name for path in known])
    return matches[0]


def show(
    name: str, root: Path, markdown: bool, sheet: Path | None = None, into: Path | None = None
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
        with atomic_write(sheet) as stream:
            stream.write(contact_sheet(_one_picture_per_object(folder, result)))


def score(name: str, protocols: Sequence[str], store: Path, root: Path) -> None:
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


def sync(names: Sequence[str], root: Path, mlflow: str) -> None:
    """``gvr sync``: fill MLflow from results.

    Raises:
        SyncError: if MLflow cannot be reached.
    """
    folders = [find_result(name, root) for name in names] if names else list_results(root)
    if not folders:
        console.print(f"No results under {root}")
    _fill_mlflow(folders, mlflow, must=True)


def _fill_mlflow(folders: Sequence[Path], uri: str, must: bool = False) -> None:
    from reports.mlflow_sink import FILL_SECONDS
    from reports.mlflow_sink import sync as sync_result

    for folder in folders:
        result, _ = read_result(folder)
        experiment = str(result.config.get("experiment", "gvr-bench"))
        try:
            report = sync_result(folder, uri, experiment, None if must else FILL_SECONDS)
        except SyncError as error:
            if must:
                raise
            warnings.print(
                f"MLflow was not filled: {error}\nThe result is safe; `gvr sync` fills it later.",
                style="yellow",
                markup=False,
                soft_wrap=True,
            )
            return
        console.print(f"MLflow: {report}", soft_wrap=True, highlight=False)


def ui(port: int, host: str, exposed: bool) -> None:
    """``gvr ui``: MLflow's pages, on loopback unless told otherwise, until interrupted."""
    from reports.mlflow_server import serve_ui

    serve_ui(port, host, exposed=exposed)


def cache_ls(root: Path, stage: str | None) -> None:
    """``gvr cache ls``."""
    listing = Store(root).ls(stage)
    table = Table("stage", "results", "computed in", "size", box=None)
    for name, count in listing.stages.items():
        lines = [line for line in listing.records if line.stage == name]
        table.add_row(
            name,
            str(count),
            f"{sum(line.seconds for line in lines):.1f} s",
            _size(sum(line.bytes for line in lines)),
        )
    console.print(table)
    console.print(f"{listing.objects} objects, {_size(listing.object_bytes)}, in {root}")
    if listing.unreadable:
        console.print(f"{listing.unreadable} records cannot be read and will be computed again")


def cache_verify(root: Path) -> int:
    """``gvr cache verify``; exit code 1 where something is damaged."""
    report = Store(root).verify()
    for problem in report.problems:
        console.print(f"{problem.path}: {problem.finding}", markup=False, soft_wrap=True)
    console.print(
        f"{report.records} results, {report.artifacts} artifacts, "
        f"{_size(report.bytes_hashed)} read, {len(report.problems)} problems, "
        f"{report.orphans} objects that no result names"
    )
    return 0 if report.sound else 1


def cache_gc(root: Path, keep_days: float | None, dry_run: bool) -> None:
    """``gvr cache gc``."""
    report = Store(root).gc(keep_days=keep_days, dry_run=dry_run)
    verb = "would go" if report.dry_run else "removed"
    console.print(
        f"{verb}: {report.records} results, {report.objects} objects, "
        f"{report.temporary} unfinished files; {_size(report.bytes_freed)}. "
        f"{report.spared} young objects spared."
    )


def doctor(store: Path) -> int:
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


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count < 1e9 else f"{count / 1e9:.2f} GB"

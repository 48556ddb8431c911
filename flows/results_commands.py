"""``gvr ls``, ``show``, ``score`` and ``sync``: what is done with results that are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.job import fill_mlflow
from flows.output import console, print_document, say, show_sheet, warn
from flows.result_document import result_document
from gvr_core.atomic import atomic_write
from gvr_core.errors import ConfigError, InputError, did_you_mean, some_of
from gvr_core.protocols import PROTOCOLS
from reports import tables
from reports.document import replace_block
from reports.formats import NONE
from reports.record import Result, Row
from reports.result_io import RESULT_FILE, read_result
from reports.results_place import ResultsPlace
from reports.sheet import Sheet

SHEET_PICTURES = 12
"""At most so many pictures on a sheet."""


@dataclass(frozen=True)
class ListedResult:
    """One result in a listing."""

    run_id: str
    suite: str | None = None
    """Null, as all below, for one that is only behind a URL: listing fetches nothing."""
    created: str | None = None
    scenes: int | None = None
    """(scene, method) pairs."""
    failed: int | None = None
    wall_seconds: float | None = None


@dataclass(frozen=True)
class ResultsDocument:
    """Results, the newest last."""

    place: str
    results: tuple[ListedResult, ...]


@dataclass(frozen=True)
class SyncedResult:
    """A result that MLflow has now."""

    result: Path
    mlflow: str
    """What was written, in words."""


@dataclass(frozen=True)
class SyncDocument:
    """Results that MLflow has now."""

    results: tuple[SyncedResult, ...]


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
    if not known and not name:
        raise ConfigError("no results yet", path=str(place), accepted="`gvr run` makes one")
    if name and name not in known:
        newest = some_of(reversed(known)) or "none yet"
        raise ConfigError(
            f"unknown result {name!r}{did_you_mean(name, known)}",
            accepted=f"{newest}, which `gvr ls` lists, or a result's folder",
        )
    return place.folder(name or known[-1])


def print_tables(result: Result, rows: Sequence[Row]) -> None:
    """The tables of a result, for a terminal."""
    console.print(tables.overview(result, rows))


def list_results(root: Path | str, as_json: bool = False) -> None:
    """``gvr ls``: the results that are there, the newest last.

    Raises:
        RemoteError: if the root is a URL that does not answer.
    """
    place = ResultsPlace(root)
    listed = []
    for name in place.names():
        if not (place.root / name / RESULT_FILE).exists():
            listed.append(ListedResult(name))
            continue
        try:
            result, _ = read_result(place.root / name)
        except InputError as error:  # one that is damaged does not hide the others
            warn(f"{name}: {error}")
        else:
            listed.append(_listed(result))
    document = ResultsDocument(str(place), tuple(listed))
    if as_json:
        print_document("ls", document)
        return
    rows = [(r.run_id, *_details(r)) for r in listed]
    columns = ("result", "suite", "created", "scenes", "failed", "seconds")
    show_sheet(Sheet(f"results in {place}", columns, tuple(rows), n_names=3))
    say("Next: gvr show RESULT" if listed else "Next: gvr run bench")


def _listed(result: Result) -> ListedResult:
    failed = sum(scene.status == "failed" for scene in result.scenes)
    return ListedResult(
        result.run_id,
        result.suite,
        result.created,
        len(result.scenes),
        failed,
        result.wall_seconds,
    )


def _details(listed: ListedResult) -> tuple[str, ...]:
    if listed.created is None:
        return ("(not here)", *[NONE] * 4)
    return (
        str(listed.suite),
        listed.created[:16],
        str(listed.scenes),
        str(listed.failed),
        f"{listed.wall_seconds:,.0f}",
    )


def show(
    name: str,
    root: Path | str,
    markdown: bool,
    sheet: Path | None = None,
    into: Path | None = None,
    as_json: bool = False,
) -> None:
    """``gvr show``: the tables of a result again, in a document too, and a sheet of pictures.

    Raises:
        ConfigError: for a result that is not there, or two ways of printing it.
        ResultError: for one that is damaged, or a document that cannot take the tables.
    """
    if as_json and markdown:
        raise ConfigError("both --markdown and --json", accepted="one of the two")
    folder = find_result(name, root)
    result, rows = read_result(folder)
    if into is not None:
        replace_block(into, result.suite, tables.readme_block(result, rows))
    if as_json:
        print_document("show", result_document(folder, result, rows))
    elif into is not None:
        say(f"{into}: <!-- {result.suite} -->")
    elif markdown:
        print(tables.readme_block(result, rows))
    else:
        print_tables(result, rows)
    if sheet is not None:
        from reports.pictures import contact_sheet  # imports matplotlib

        with atomic_write(sheet) as stream:
            stream.write(contact_sheet(_one_picture_per_object(folder, result)))


def score(
    name: str,
    protocols: Sequence[str],
    store: Path | str,
    root: Path | str,
    as_json: bool = False,
) -> None:
    """``gvr score``: a result's saved predictions under other protocols.

    Raises:
        ConfigError: without protocols, and as :func:`flows.score.score_again`.
    """
    from flows.score import score_again

    if not protocols:
        raise ConfigError(
            "no protocol is named", accepted=f"--protocol, with one of {', '.join(PROTOCOLS)}"
        )
    folder = score_again(find_result(name, root), protocols, store, root)
    result, rows = read_result(folder)
    if as_json:
        print_document("score", result_document(folder, result, rows))
        return
    print_tables(result, rows)
    say(f"\nResult: {folder}")


def sync(names: Sequence[str], root: Path | str, mlflow: str, as_json: bool = False) -> None:
    """``gvr sync``: fill MLflow from results; those not at their URL yet are copied there first.

    Raises:
        SyncError: if MLflow cannot be reached.
        RemoteError: if the root is a URL that does not answer.
    """
    place = ResultsPlace(root)
    place.push()
    folders = [find_result(name, root) for name in names or place.names()]
    if not folders and not as_json:
        say(f"No results under {root}")
    synced = []
    for folder in folders:
        synced.append(SyncedResult(folder, fill_mlflow(folder, mlflow, patient=True)))
        if not as_json:
            say(f"MLflow: {synced[-1].mlflow}")
    if as_json:
        print_document("sync", SyncDocument(tuple(synced)))


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

"""``gvr ground``: one scene of one's own, usable without a shell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from datasets.own import own_scene
from flows.lines import ONBOARD, bundled_models
from flows.output import print_document, say, show_sheet
from flows.places import home
from gvr_core.errors import ConfigError, unknown_name
from gvr_core.exports import EXPORTS, RED, parse_colour
from gvr_core.methods import check_method
from gvr_core.models.registry import require_weights
from reports.formats import NONE
from reports.sheet import Sheet
from tasks.store import Store

if TYPE_CHECKING:
    from flows.own import OwnAnswer  # imports Prefect, whose home is then chosen


@dataclass(frozen=True)
class GroundDocument:
    """The answers, and the folder of their files."""

    out: Path
    answers: tuple[OwnAnswer, ...]


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
    as_json: bool = False,
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
    if as_json:
        print_document("ground", GroundDocument(out, tuple(answers)))
        return
    show_sheet(_sheet(answers))
    for answer in answers:
        missing = [kind for kind in dict.fromkeys(exports) if kind not in answer.files]
        if missing:
            why = "it is the whole scene" if answer.found and answer.count else "nothing was found"
            say(f"{answer.text}: {why}, so there is no PLY for: {', '.join(missing)}")
    say(f"Files in {out}")


def _sheet(answers: Sequence[OwnAnswer]) -> Sheet:
    rows = []
    for answer in answers:
        place = NONE if answer.location is None else " ".join(f"{x:.3g}" for x in answer.location)
        found = "yes" if answer.found else "no"
        rows.append((answer.text, " ".join(answer.files.values()), found, f"{answer.count}", place))
    columns = ("query", "files", "found", "Gaussians", "location")
    return Sheet("what was answered", columns, tuple(rows), n_names=2)

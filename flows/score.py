"""Scoring a result again under other protocols, without grounding again."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from datasets.base import SceneData
from flows.scene import result_rows
from flows.scene_setup import load_scene
from flows.suite import SuiteConfig
from gvr_core.errors import ConfigError
from gvr_core.protocols import protocol
from gvr_core.rendering import get_renderer
from reports.environment import describe_environment
from reports.record import Result, Row, SceneResult
from reports.result_io import new_run_id, read_result
from reports.results_place import ResultsPlace
from tasks.evaluation import score_scene
from tasks.groundings import unpack_answers
from tasks.store import Store

SCORED_FROM, PROTOCOLS = "scored_from", "scored_protocols"
"""Keys that a result scored again has in its configuration besides."""


def score_again(
    folder: Path, protocols: Sequence[str], store: Path | str, results: Path | str
) -> Path:
    """Evaluate the saved predictions of a result, and write another result.

    Args:
        folder: The result's folder.
        protocols: Ids of the protocols.
        store: The artifact store that the result was made in; predictions lie there.
        results: Folder of the results, or its URL.

    Returns:
        Folder of the new result. Its configuration says which result it was scored from.

    Raises:
        ConfigError: for a protocol that is not known, a scene that has changed since, or
            predictions that are no longer in the store.
        InputError: for a scene that cannot be read.
    """
    ids = list(dict.fromkeys(protocol(name).id for name in protocols))
    result, _ = read_result(folder)
    start, created = time.perf_counter(), datetime.now(UTC)
    suite = SuiteConfig.model_validate(_suite_part(result))
    known = Store(store)
    scenes: list[SceneResult] = []
    rows: list[Row] = []
    loaded: dict[tuple[str, str], SceneData] = {}
    for scene in result.scenes:
        if scene.status != "completed":
            scenes.append(scene)
            continue
        key = (scene.dataset, scene.scene)
        if key not in loaded:
            loaded.clear()  # scenes come one after the other, and one is enough in memory
            loaded[key] = _unchanged(suite, scene)
        rows += _rows(loaded[key], scene, suite, known, ids)
        # Pictures belong to the first result: nothing was grounded here.
        bare = tuple(query.model_copy(update={"picture": None}) for query in scene.queries)
        data = loaded[key]
        changes = {
            "queries": bare,
            "evidence": None,
            "digests": dict(data.digests),
            "original": data.original,
        }
        scenes.append(scene.model_copy(update=changes))
    again = Result(
        run_id=new_run_id(),
        suite=result.suite,
        created=created.isoformat(timespec="seconds"),
        wall_seconds=time.perf_counter() - start,
        config={**result.config, SCORED_FROM: result.run_id, PROTOCOLS: ids},
        environment=describe_environment(),
        scenes=tuple(scenes),
    )
    return ResultsPlace(results).write(again, tuple(rows))


def _suite_part(result: Result) -> dict[str, object]:
    return {k: v for k, v in result.config.items() if k not in (SCORED_FROM, PROTOCOLS)}


def _unchanged(suite: SuiteConfig, scene: SceneResult) -> SceneData:
    """The scene as it was when it was grounded in."""
    choice = next(choice for choice in suite.datasets if choice.name == scene.dataset)
    data = load_scene(choice, scene.scene, suite.exclude_eval_views)
    for part in ("gaussians", "queries"):
        if data.digests[part] != scene.digests.get(part):
            raise ConfigError(
                f"{scene.dataset}/{scene.scene}: the {part} are not those it was grounded in",
                accepted="the data of the result; else run the suite again",
            )
    return data


def _rows(
    data: SceneData, scene: SceneResult, suite: SuiteConfig, store: Store, ids: Sequence[str]
) -> list[Row]:
    key = next((timing.key for timing in scene.stages if timing.stage == "segment"), "")
    record = store.lookup("segment", key) if key else None
    if record is None:
        raise ConfigError(
            f"{scene.dataset}/{scene.scene} · {scene.method}: its predictions are not in the store",
            accepted="the store of that run (--store), before `gvr cache gc` removed them",
        )
    answers = unpack_answers(store.load_arrays(record.artifacts["groundings"]))
    queries = data.queries[: suite.limit]
    scores = score_scene(data, queries, answers, get_renderer(suite.renderer), ids)
    return result_rows(scene.dataset, scene.scene, scene.method, queries, scores.rows)

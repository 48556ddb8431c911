"""The scene flow: every stage of every method on one scene, one cached task after the other."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from prefect import flow
from prefect.states import Completed, Failed, State

from datasets.base import SceneData
from flows.lines import Line, file_name
from flows.progress import Progress
from flows.scene_outcome import Listener, Notes, SceneOutcome, failed_outcome, identity
from flows.scene_setup import line_job, load_scene
from flows.suite import SuiteConfig
from gvr_core.scene import Query
from reports.record import Damage, QueryOutcome, Row, SceneResult, StageTiming
from tasks.evaluation import Scored
from tasks.groundings import Answer, unpack_answers
from tasks.scene_job import SceneJob
from tasks.stage import StageRun
from tasks.stages import PREPARATION, run_stages
from tasks.store import Store

log = logging.getLogger(__name__)


@flow(name="scene", validate_parameters=False)
def scene_flow(
    suite: dict[str, Any],
    dataset: str,
    scene: str,
    store: str,
    lines: Sequence[str],
    listener: Listener,
    progress: bool = False,
) -> State[None]:
    """Lines of a suite on one scene, one after the other.

    A line that fails is reported as failed, and the others go on.

    Args:
        suite: The suite's configuration as JSON values.
        dataset: Name of the data set.
        scene: Name of the scene.
        store: Root of the artifact store, or its URL.
        lines: Names of the lines to run, in this order.
        listener: Is told of each line when it begins and when it ends.
        progress: Show progress bars.

    Returns:
        ``Failed`` where a line failed, naming it and its error.
    """
    config = SuiteConfig.model_validate(suite)
    choice = next(d for d in config.datasets if d.name == dataset)
    known = {line.name: line for line in config.lines()}
    notes = Notes()
    with Progress(shown=progress) as bars:
        try:
            data = load_scene(choice, scene, config.exclude_eval_views)
        except Exception as error:
            for name in lines:
                notes.ended(failed_outcome(dataset, scene, known[name], error))
                listener.ended(notes.outcomes[-1])
        else:
            for name in lines:
                listener.begun(name)
                notes.ended(run_line(data, config, known[name], Store(store), bars))
                listener.ended(notes.outcomes[-1])
    failures = [f"{o.result.method}: {o.result.error}" for o in notes.outcomes if o.failed]
    if failures:
        return Failed(message="; ".join(failures))
    return Completed(message=f"{len(lines)} lines")


def result_rows(
    dataset: str, scene: str, method: str, queries: Sequence[Query], scored: Sequence[Scored]
) -> list[Row]:
    """Rows of a scene's evaluation with all the names that a result has them under."""
    known = {query.id: query for query in queries}
    return [
        Row(
            dataset=dataset,
            scene=scene,
            method=method,
            text=known[row["query"]].text,
            target=known[row["query"]].target,
            absent=known[row["query"]].absent,
            **row,
        )
        for row in scored
    ]


def run_line(
    data: SceneData,
    suite: SuiteConfig,
    line: Line,
    store: Store,
    progress: Progress | None = None,
) -> SceneOutcome:
    """One line on one scene, from its stages to rows and timings.

    Args:
        data: The scene.
        suite: The benchmark's configuration.
        line: The method and its models.
        store: Where results of stages lie.
        progress: Shows progress bars; None shows none.

    Returns:
        The outcome; a failure is an outcome too, with the error's text.
    """
    try:
        job = line_job(data, suite, line, store, progress)
        runs = run_stages(job)
        return _outcome(line, job, runs)
    except Exception as error:
        return failed_outcome(data.scene.dataset, data.scene.name, line, error)


def _outcome(line: Line, job: SceneJob, runs: dict[str, StageRun]) -> SceneOutcome:
    scene = job.data.scene
    answers = unpack_answers(job.store.load_arrays(runs["segment"]["groundings"]))
    queries, pictures = [], {}
    names = (scene.dataset, scene.name, line.name)
    folder = "/".join(("pictures", *map(file_name, names)))
    for query, answer in zip(job.queries, answers, strict=True):
        path = None
        if not line.is_variant:  # dozens of nearly equal pictures of each query help nobody
            path = f"{folder}/{query.id}.png"
            pictures[path] = runs["evaluate"][f"picture.{query.id}"]
        queries.append(_query_outcome(query, answer, runs, path))
    evidence = None
    if "evidence" in runs["evaluate"].artifacts:
        evidence = f"{'/'.join(('evidence', *map(file_name, names)))}.json"
        pictures[evidence] = runs["evaluate"]["evidence"]
    scored = job.store.load_json(runs["evaluate"]["rows"])
    rows = tuple(result_rows(scene.dataset, scene.name, line.name, job.queries, scored))
    seconds = [sum(outcome.seconds.values()) for outcome in queries]
    camera = scene.views[0].camera
    result = SceneResult(
        **identity(scene.dataset, scene.name, line),
        status="completed",
        n_gaussians=len(scene.gaussians),
        n_views=len(scene.views),
        n_patches=int(runs["masks"].record.detail["n_patches"]) if "masks" in runs else 0,
        picture_size=(camera.width, camera.height),
        models=job.model_names(),
        digests=dict(job.data.digests),
        original=job.data.original,
        prepare_seconds=sum(runs[stage].record.seconds for stage in PREPARATION if stage in runs),
        query_seconds=sum(seconds) / len(seconds) if seconds else 0.0,
        stages=tuple(_timing(run) for run in runs.values()),
        queries=tuple(queries),
        evidence=evidence,
    )
    return SceneOutcome(result=result, rows=rows, pictures=pictures)


def _query_outcome(
    query: Query, answer: Answer, runs: dict[str, StageRun], picture: str | None
) -> QueryOutcome:
    locate: Any = runs["query"].record.detail["seconds"]
    segment: Any = runs["segment"].record.detail["seconds"]
    place = answer.location
    return QueryOutcome(
        query=query.id,
        found=answer.found,
        location=None if place is None else (float(place[0]), float(place[1]), float(place[2])),
        n_flagged=int(answer.flags.sum()),
        confidence=answer.confidence,
        seconds={"query": locate[query.id], "segment": segment[query.id]["segment"]},
        picture=picture,
        text=query.text,
    )


def _timing(run: StageRun) -> StageTiming:
    record = run.record
    return StageTiming(
        stage=record.stage,
        seconds=record.seconds,
        cpu_seconds=record.cpu_seconds,
        peak_bytes=record.peak_bytes,
        peak_of=record.peak_of,
        state="cached" if run.cached else "computed",
        key=record.key,
        damage=tuple(Damage(**asdict(found)) for found in run.notes.findings),
        fetched=run.notes.fetched,
        unshared=run.notes.unshared,
    )

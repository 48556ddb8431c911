"""The work that faults disturb: a small scene on disk, one method, a result record."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from native_scene import written

from faults import children
from faults.children import LineFailed
from flows.benchmark import stored_pictures
from flows.scene import run_line
from flows.scene_setup import load_scene
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.methods import MethodConfig
from gvr_core.models.registry import ModelConfig
from reports import same_record
from reports.environment import describe_environment
from reports.record import Environment, Result, SceneResult
from reports.result_check import ResultError
from reports.result_io import new_run_id, write_result
from tasks.store import Store

DATASET = "folder"
SCENE = "two-boxes"


@dataclass(frozen=True)
class Work:
    """One suite over a scene on disk."""

    suite: SuiteConfig
    environment: Environment

    @property
    def toml(self) -> str:
        """The suite as a file for the command line."""
        dataset = json.dumps(self.suite.datasets[0].name)
        return (
            f'name = "{self.suite.name}"\n\n[[datasets]]\nname = {dataset}\n\n'
            '[[methods]]\nmethod = "gvr-robust"\n\n'
            '[models]\nsegmenter = "oracle"\nencoder = "oracle"\ntext_segmenter = "oracle"\n'
        )

    def run(self, store: Path | Store, results: Path) -> Path:
        """Run the suite outside Prefect: same stages, store and record, but in half a second.

        Returns:
            The result's folder.

        Raises:
            LineFailed: A scene failed; the result is written all the same.
        """
        store = store if isinstance(store, Store) else Store(store)
        data = load_scene(self.suite.datasets[0], SCENE)
        outcomes = [run_line(data, self.suite, line, store) for line in self.suite.lines()]
        result = Result(
            run_id=new_run_id(),
            suite=self.suite.name,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            wall_seconds=0.0,
            config=self.suite.model_dump(mode="json"),
            environment=self.environment,
            scenes=tuple(outcome.result for outcome in outcomes),
        )
        rows = [row for outcome in outcomes for row in outcome.rows]
        pictures = stored_pictures(outcomes, store)
        folder = write_result(results / result.run_id, result, rows, pictures)
        failed = [scene for scene in result.scenes if scene.status == "failed"]
        if failed:
            raise LineFailed(_first_error(failed))
        return folder


def make_work(folder: Path) -> Work:
    """Write the scene into a folder, and the suite over it."""
    data = folder / "scenes"
    # In a child: drawing starts threads, and this process is to fork more children.
    made = children.run(lambda: written(data / SCENE))
    if made.code != 0:
        raise RuntimeError(f"the scene could not be made: {made.last_line}")
    suite = SuiteConfig(
        name="small",
        datasets=(DatasetChoice(name=f"folder:{data}"),),
        methods=(MethodConfig(method="gvr-robust"),),
        models=ModelConfig(segmenter="oracle", encoder="oracle", text_segmenter="oracle"),
    )
    return Work(suite, describe_environment())


def comparable(folder: Path) -> dict[str, Any]:
    """All that two undisturbed results of one suite share: rows and pictures bit for bit."""
    files = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in ("result.json", "SHA256SUMS")
    }
    try:
        record = same_record.comparable(folder)
    except ResultError as error:  # half of a result, which equals none
        record = {"not a result": str(error)}
    return {"files": files, "result": record}


def difference(one: dict[str, Any], other: dict[str, Any]) -> str | None:
    """The first difference of two `comparable` results; None where there is none."""
    if one == other:
        return None
    for name in sorted(one["files"].keys() | other["files"].keys()):
        if one["files"].get(name) != other["files"].get(name):
            return f"{name} differs"
    return "result.json differs"


def emptied(folder: Path) -> Path:
    """The folder, new and empty."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _first_error(failed: list[SceneResult]) -> str:
    return f"{failed[0].scene}: {failed[0].error}"

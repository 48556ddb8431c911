"""A small project on disk with a result and a store, and a call of every command that prints."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save
from small_scene import two_boxes

from datasets.inria_cameras import write_inria_cameras
from flows.cli import main
from gvr_core.splat_io import write_ply

SUITE = """
name = "small"
[[datasets]]
name = "folder:scenes"
[[methods]]
method = "gvr-paper"
[[methods]]
method = "gvr-robust"
[models]
segmenter = "oracle"
encoder = "oracle"
text_segmenter = "oracle"
"""

CALLS: dict[str, tuple[str, ...]] = {
    "init": ("init", "scenes", "--force", "--models", "oracle"),
    "doctor": ("doctor",),
    "run": ("run", "small.toml", "--no-mlflow", "--limit", "1"),
    "run --dry-run": ("run", "small.toml", "--dry-run"),
    "ground": (
        *("ground", "boxes.ply", "--cameras", "cameras.json", "--query", "a red box"),
        *("--max-views", "3", "--out", "answers"),
    ),
    "ls": ("ls",),
    "show": ("show",),
    "report": ("report", "--out", "report.html"),
    "compare": ("compare", "FIRST", "FIRST"),
    "score": ("score", "FIRST", "--protocol", "refusal"),
    "sync": ("sync", "FIRST", "--tracking-uri", "sqlite:///mlflow.db"),
    "cache ls": ("cache", "ls"),
    "cache verify": ("cache", "verify"),
    "cache push": ("cache", "push", "--store", "URL"),
    "cache gc": ("cache", "gc", "--dry-run"),
    "models ls": ("models", "ls"),
    "models fetch": ("models", "fetch", "mine"),
    "models verify": ("models", "verify"),
    "datasets ls": ("datasets", "ls"),
    "datasets where": ("datasets", "where"),
    "datasets check": ("datasets", "check", "scenes"),
    "datasets export": (
        *("datasets", "export", "folder:scenes", "two-boxes"),
        *("--layout", "lerf_mask", "--out", "NEW"),
    ),
}
"""Document -> a call that prints it. FIRST stands for the project's first result, URL for its
shared store, and NEW for a folder that is not there."""


@dataclass(frozen=True)
class Said:
    """What a command said."""

    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Project:
    """The folder that is worked in, and its first result."""

    folder: Path
    first: str

    def call(self, *arguments: str) -> Said:
        """Run the command line in the project."""
        known = {
            "FIRST": self.first,
            "URL": (self.folder / "shared").as_uri(),
            "NEW": f"new-{uuid.uuid4().hex[:8]}",
        }
        return _called(*(known.get(argument, argument) for argument in arguments))


@contextlib.contextmanager
def made_project(folder: Path, scenes: Path) -> Iterator[Project]:
    """A project with short relative paths, as a user's is, and one run of a small suite."""
    shutil.copytree(scenes, folder / "scenes")
    (folder / "small.toml").write_text(SUITE)
    scene, _ = two_boxes()
    write_ply(folder / "boxes.ply", scene.gaussians)
    write_inria_cameras(folder / "cameras.json", [(v.name, v.camera) for v in scene.views])
    _own_checkpoint(folder / ".gvr" / "models")
    with pytest.MonkeyPatch.context() as patch, contextlib.chdir(folder):
        for variable in [name for name in os.environ if name.startswith("GVR_")]:
            patch.delenv(variable)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        patch.setenv("COLUMNS", "80")
        said = _called("run", "small.toml", "--quiet", "--no-mlflow", "--json")
        assert said.code == 0, said.err
        yield Project(folder, str(json.loads(said.out)["run_id"]))


def _own_checkpoint(models: Path) -> None:
    """A checkpoint of one's own that is in place already, so that nothing is fetched."""
    content = save({"weight": np.zeros(3, np.float32)})
    (models / "mine").mkdir(parents=True)
    (models / "mine" / "mine.safetensors").write_bytes(content)
    (models / "manifest.toml").write_text(
        f"""
[[checkpoints]]
name = "mine"
role = "encoder"
licence = "MIT"
source = "https://example.org/mine"
[[checkpoints.files]]
path = "mine/mine.safetensors"
size = {len(content)}
sha256 = "{hashlib.sha256(content).hexdigest()}"
url = "http://127.0.0.1:9/mine.safetensors"
"""
    )


def _called(*arguments: str) -> Said:
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main([*arguments])
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
    return Said(code, out.getvalue(), err.getvalue())

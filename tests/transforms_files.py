"""Writers of ``transforms.json`` for tests, each as its program makes it from COLMAP's cameras.

Written from what nerfstudio's and instant-ngp's scripts do to a pose, step by step, and not from
the reader's formulas.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gvr_core.cameras import Camera

Named = Sequence[tuple[str, Camera]]


def opengl(camera: Camera) -> np.ndarray:
    """Camera to world (4, 4), the camera's y and z axes turned round."""
    pose = np.linalg.inv(camera.world_to_camera)
    pose[:3, 1] *= -1
    pose[:3, 2] *= -1
    return pose


def lens(camera: Camera) -> dict[str, float]:
    (fx, fy), (cx, cy) = camera.K[[0, 1], [0, 1]].tolist(), camera.K[:2, 2].tolist()
    return {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}


def nerfstudio(images: Named, *, shared_lens: bool = False, scale: float = 1.0) -> dict[str, Any]:
    """What ``ns-process-data`` writes: COLMAP's world with its second and third axis swapped and
    the new third turned round, and a word about it."""
    frames: list[dict[str, Any]] = []
    for number, (name, camera) in enumerate(images, start=1):
        pose = opengl(camera)
        pose = pose[[0, 2, 1, 3]]
        pose[2] *= -1
        pose[:3, 3] *= scale
        frames.append(
            {
                "file_path": f"./images/{name}",
                "transform_matrix": pose.tolist(),
                "colmap_im_id": number,
                **({} if shared_lens else lens(camera)),
            }
        )
    top: dict[str, Any] = {"camera_model": "OPENCV", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
    if shared_lens:
        top |= lens(images[0][1])
    if scale != 1:
        top["applied_scale"] = scale
    applied = [[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0]]
    return {**top, "frames": frames, "applied_transform": applied, "ply_file_path": "sparse_pc.ply"}


def instant_ngp(images: Named) -> dict[str, Any]:
    """What ``colmap2nerf.py --keep_colmap_coords`` writes: one lens, sizes as floats."""
    camera = images[0][1]
    top = {key: float(value) for key, value in lens(camera).items()}
    frames = [
        {"file_path": f"./images/{n}", "sharpness": 1.5, "transform_matrix": opengl(c).tolist()}
        for n, c in images
    ]
    angles = {
        "camera_angle_x": 2 * math.atan(camera.width / (2 * top["fl_x"])),
        "camera_angle_y": 2 * math.atan(camera.height / (2 * top["fl_y"])),
    }
    zero = {"k1": 0, "k2": 0, "p1": 0, "p2": 0}
    return {**angles, **top, **zero, "aabb_scale": 16, "scale": 0.33, "frames": frames}


def save(path: Path, content: dict[str, Any], **encoding: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1), **encoding)
    return path

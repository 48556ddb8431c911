"""Keeping the test views out of what a method may look at."""

from __future__ import annotations

import hashlib
from dataclasses import replace

from datasets.base import SceneData
from gvr_core.errors import DatasetError


def without_test_views(data: SceneData) -> SceneData:
    """The scene with its test views taken out of the knowledge views.

    In LERF-OVS and 3D-OVS labelled frames are training views, so prior art has seen them; this
    is the audit of what that is worth. A data set that holds its test views out stays as it is.

    Args:
        data: A scene.

    Raises:
        DatasetError: if no knowledge view is left.
    """
    tested = {view.name for view in data.truth.test_views}
    views = tuple(view for view in data.scene.views if view.name not in tested)
    taken = len(data.scene.views) - len(views)
    if not taken:
        return data
    if not views:
        raise DatasetError(
            f"{data.scene.dataset}/{data.scene.name}: all {taken} views are test views",
            accepted="a scene with other views, or a run without --exclude-eval-views",
        )
    digest = hashlib.sha256(data.digests["views"].encode())
    digest.update("".join(f"\nwithout {view}" for view in sorted(tested)).encode())
    return replace(
        data,
        scene=replace(data.scene, views=views),
        digests={**data.digests, "views": digest.hexdigest()},
        notes=(*data.notes, f"{taken} test views are kept out of the books"),
    )

"""Small scenes of boxes with models that know the truth, and the robust method over them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from small_scene import OBJECTS, box, flat_gaussians, two_boxes

from gvr_core.books import Books
from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.methods import Grounding, Method, MethodConfig, Toolbox, build_method
from gvr_core.models.base import Frame, Mask, TextSegmenter
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.rendering import get_renderer
from gvr_core.scene import Query, Scene
from gvr_core.transforms import transform_gaussians

RED = Query(id="red", text="a red box", target=OBJECTS[0])
BLUE = Query(id="blue", text="the blue cube", target=OBJECTS[1])
FLOOR = Query(id="floor", text="the floor", target="floor")
ABSENT = Query(id="absent", text="an elephant", absent=True)
MEANINGS = {str(query.text): str(query.target) for query in (RED, BLUE, FLOOR)}


@dataclass(frozen=True, eq=False)
class World:
    """A scene and its truth."""

    scene: Scene
    labels: NDArray[np.int16]
    objects: tuple[str, ...] = OBJECTS

    @property
    def oracle(self) -> OracleWorld:
        meanings = {text: name for text, name in MEANINGS.items() if name in self.objects}
        return OracleWorld(self.scene.gaussians, self.labels, self.objects, meanings)

    def truth(self, query: Query) -> NDArray[np.bool_]:
        assert query.target is not None
        return self.labels == self.objects.index(query.target)

    def method(
        self, name: str = "gvr-robust", text_segmenter: TextSegmenter | None = None, **parts: Any
    ) -> Method:
        """A method with oracle models; ``parts`` are the fields of its configuration."""
        models = oracle_models(self.oracle)
        if text_segmenter is not None:
            models = replace(models, text_segmenter=text_segmenter)
        config = MethodConfig.model_validate({"method": name, **parts})
        return build_method(config, Toolbox(get_renderer("numba"), models))

    def ground(self, books: Books, query: Query, **parts: Any) -> Grounding:
        """Ask the robust method, its index made anew."""
        method = self.method(**parts)
        fresh = replace(books, index=method.index(self.scene, books))
        return method.ground(self.scene, fresh, query)


def boxes() -> World:
    """A red and a blue box on a plane."""
    return World(*two_boxes())


def boxes_and_floor() -> World:
    """The same, with the plane labelled."""
    scene, labels = two_boxes()
    named = np.where(labels < 0, 2, labels).astype(np.int16)
    return World(scene, named, (*OBJECTS, "floor"))


def twins() -> World:
    """Two equal red boxes of one label, on the plane."""
    scene, labels = two_boxes()
    pair = [flat_gaussians(box((x, 0.0, 0.45), 0.8), (0.9, 0.1, 0.1), 0.05) for x in (-1.2, 1.2)]
    plane = scene.gaussians.subset(labels < 0)
    named = np.concatenate([np.zeros(len(pair[0]) + len(pair[1])), np.full(len(plane), -1)])
    gaussians = Gaussians.concatenate([*pair, plane])
    return World(replace(scene, gaussians=gaussians), named.astype(np.int16))


def moved(
    world: World,
    rotation: NDArray[np.float64] | None = None,
    scale: float = 1.0,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> World:
    """Everything, cameras and all, turned, scaled and shifted: x' = scale * R x + t."""
    turn, by = np.eye(3) if rotation is None else rotation, np.array(shift)
    views = []
    for view in world.scene.views:
        matrix = np.eye(4)
        matrix[:3, :3] = view.camera.world_to_camera[:3, :3] @ turn.T
        matrix[:3, 3] = scale * view.camera.world_to_camera[:3, 3] - matrix[:3, :3] @ by
        camera = Camera(view.camera.K, matrix, view.camera.width, view.camera.height)
        views.append(replace(view, camera=camera))
    gaussians = transform_gaussians(world.scene.gaussians, turn, by, scale)
    return replace(world, scene=replace(world.scene, gaussians=gaussians, views=tuple(views)))


@dataclass
class BlindOnce:
    """Test double: finds nothing in one of the pictures that it is asked about."""

    inner: TextSegmenter
    blind: int
    asked: int = 0

    @property
    def name(self) -> str:
        return f"blind-once({self.inner.name})"

    def segment(self, frame: Frame, text: str) -> Mask | None:
        self.asked += 1
        return None if self.asked == self.blind + 1 else self.inner.segment(frame, text)


@dataclass(frozen=True)
class Always:
    """Test double: finds the same in every picture."""

    mask: Mask | None
    name: str = "always"

    def segment(self, frame: Frame, text: str) -> Mask | None:
        return self.mask

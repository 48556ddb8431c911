"""What stands in the viewer's 3D scene: the splats, the cameras, and an answer's evidence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from flows.view_shapes import DisplayFrame, Splats, frustum_lines, splats_of
from gvr_core.cameras import Camera
from gvr_core.exports import RED
from gvr_core.methods import Grounding
from gvr_core.scene import Scene

if TYPE_CHECKING:
    from viser import ViserServer

Shown = Literal["dyed", "as it is", "hidden", "alone"]
SHOWN: tuple[Shown, ...] = ("dyed", "as it is", "hidden", "alone")
"""How the target is shown: in red, in its own colours, not at all, or without the rest."""

EVIDENCE = ("cameras", "location", "votes", "virtual cameras")
"""What can be shown beside the splats."""

BLUE, ORANGE, YELLOW, GREY = (0, 114, 178), (230, 159, 0), (240, 228, 66), (150, 150, 150)
"""Of Okabe and Ito's palette, which colour-blind people tell apart."""

_CAMERA_DEPTH = 0.3
"""Height of a camera's pyramid, viewer units."""


class Drawing:
    """The nodes of one scene on a viser server.

    Args:
        server: Where they are drawn.
        scene: What is drawn.
    """

    def __init__(self, server: ViserServer, scene: Scene) -> None:
        self._server = server
        self._frame = DisplayFrame.of(scene)
        self._splats = splats_of(scene.gaussians, self._frame)
        self._flags = np.zeros(len(scene.gaussians), dtype=np.bool_)
        self._parts: dict[str, Any] = {}
        self._evidence: dict[str, Any] = {}
        server.scene.set_up_direction(_triple(scene.up_direction))
        first = scene.views[0].camera
        server.initial_camera.position = _triple(self._frame.place(first.position))
        server.initial_camera.look_at = _triple(
            self._frame.place(first.position) + 4 * first.forward
        )
        server.on_client_connect(lambda client: _show_all_of(first, client.camera))
        self._draw_splats("dyed")
        cameras = [view.camera for view in scene.views]
        self._evidence["cameras"] = self._frustums("/cameras", cameras, BLUE, _CAMERA_DEPTH)

    def draw(self, grounding: Grounding, shown: Shown, evidence: set[str]) -> None:
        """Replace the last answer by this one.

        Args:
            grounding: The answer.
            shown: How its target is shown.
            evidence: Of :data:`EVIDENCE`, what is visible.
        """
        with self._server.atomic():
            self._flags = grounding.flags
            self._draw_splats(shown)
            for name in EVIDENCE[1:]:
                handle = self._evidence.pop(name, None)
                if handle is not None:
                    handle.remove()
            self._draw_evidence(grounding)
            self.show_evidence(evidence)

    def show_target(self, shown: Shown) -> None:
        """Show the last answer's target another way."""
        with self._server.atomic():
            self._draw_splats(shown)

    def show_evidence(self, names: set[str]) -> None:
        """Show these of :data:`EVIDENCE`, and hide the others."""
        for name, handle in self._evidence.items():
            handle.visible = name in names

    def _draw_splats(self, shown: Shown) -> None:
        """Rest and target are two nodes; the browser sorts them as one."""
        for handle in self._parts.values():
            handle.remove()
        self._parts = {}
        target = self._splats.part(self._flags)
        if shown == "dyed":
            target = target.dyed(RED)
        if shown != "alone" or not self._flags.any():
            self._add_splats("rest", self._splats.part(~self._flags))
        if shown != "hidden":
            self._add_splats("target", target)

    def _add_splats(self, name: str, splats: Splats) -> None:
        if len(splats.centers):
            self._parts[name] = self._server.scene.add_gaussian_splats(
                f"/splats/{name}",
                splats.centers,
                splats.covariances,
                splats.rgbs,
                splats.opacities,
            )

    def _draw_evidence(self, grounding: Grounding) -> None:
        scene = self._server.scene
        if grounding.location is not None:
            place = _triple(self._frame.place(grounding.location))
            self._evidence["location"] = scene.add_icosphere(
                "/location", 0.1, YELLOW, position=place
            )
        votes = grounding.localization
        if votes is not None and len(votes.retrieval.points):
            agreeing = (votes.labels >= 0)[:, None]
            self._evidence["votes"] = scene.add_point_cloud(
                "/votes",
                self._frame.place(votes.retrieval.points),
                np.where(agreeing, YELLOW, GREY).astype(np.uint8),
                point_size=0.07,
                point_shape="circle",
            )
        virtual = [view.frame.camera for view in (grounding.bev, *grounding.ring) if view]
        if virtual:
            self._evidence["virtual cameras"] = self._frustums(
                "/virtual", virtual, ORANGE, _CAMERA_DEPTH / 2
            )

    def _frustums(
        self, name: str, cameras: list[Any], colour: tuple[int, int, int], depth: float
    ) -> Any:
        lines = frustum_lines(cameras, depth / self._frame.factor, self._frame)
        return self._server.scene.add_line_segments(
            name, lines, colour, thickness=2.0, thickness_units="screen", visible=False
        )


def _show_all_of(view: Camera, page: Any) -> None:
    """Widen a page's field of view until all of a camera's picture fits, on upright screens too."""
    across, down = view.width / 2 / view.K[0, 0], view.height / 2 / view.K[1, 1]
    page.fov = 2 * math.atan(max(down, across / page.aspect))


def _triple(vector: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z

"""The viewer in a real browser: type a query, see what is dyed, save it."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from small_scene import OBJECTS, two_boxes

from datasets.base import GroundTruth, SceneData
from flows.view_drawing import _show_all_of
from flows.view_session import ViewSession
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.rendering import get_renderer
from gvr_core.splat_io import read_splat

pytest.importorskip("viser", reason="viser is not installed")
expect = pytest.importorskip("playwright.sync_api", reason="playwright is not installed").expect

pytestmark = pytest.mark.slow

WEBGL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Draws WebGL without a graphics card."""
VISERS_OWN = "THREE.BufferGeometry.computeBoundingSphere(): Computed radius is NaN."
"""viser 1.1 says this of any splats: the corners of their squares are made on the card."""

MEANINGS = {"a red box": OBJECTS[0], "a blue box": OBJECTS[1]}


@pytest.fixture(scope="module")
def session() -> ViewSession:
    """The small scene, with models that know its truth."""
    scene, labels = two_boxes()
    world = OracleWorld(scene.gaussians, labels, OBJECTS, MEANINGS)
    tools = Toolbox(get_renderer("numba"), oracle_models(world))
    method = build_method(MethodConfig(method="gvr-paper"), tools)
    data = SceneData(scene, (), GroundTruth((), ()), {})
    return ViewSession(data, method, method.prepare(scene))


class ViewerPage:
    """A page of the viewer, and all that went wrong on it."""

    def __init__(self, page, url: str) -> None:
        self.page = page
        self.wrong: list[str] = []
        self.outside: list[str] = []
        page.on("console", lambda message: self._judge(message.type, message.text))
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("request", lambda request: self._note(request.url, url))
        page.goto(url)
        page.wait_for_selector("#gvr-status", timeout=60_000)

    def _judge(self, kind: str, text: str) -> None:
        if kind == "error" and VISERS_OWN not in text:
            self.wrong.append(text)

    def _note(self, requested: str, url: str) -> None:
        if not requested.startswith((url, "data:", "blob:")):
            self.outside.append(requested)

    def ask(self, text: str) -> str:
        """Type a text, press Enter, and wait for what is said."""
        field = self.page.locator("form input.mantine-TextInput-input")
        field.fill(text)
        field.press("Enter")
        said = self.page.locator("#gvr-status")
        expect(said).not_to_contain_text("Type what", timeout=60_000)
        expect(said).not_to_contain_text("Looking", timeout=60_000)
        return said.inner_text()

    def count(self) -> int:
        """Of dyed Gaussians, as the page says it."""
        return int(self.page.locator("#gvr-count").inner_text().replace(",", ""))


@pytest.fixture
def viewer(session: ViewSession, chromium) -> Iterator[ViewerPage]:
    from flows.viewer import Viewer

    served = Viewer(session, port=0)
    launched = chromium(*WEBGL)
    try:
        yield ViewerPage(launched.new_page(viewport={"width": 1280, "height": 800}), served.url)
    finally:
        launched.close()
        served.stop()


def test_a_query_is_typed_and_its_target_dyed(viewer: ViewerPage, session: ViewSession) -> None:
    viewer.ask("a red box")
    red = viewer.count()
    assert red == int(session.ask("a red box").grounding.flags.sum()) > 0
    viewer.page.locator("form input.mantine-TextInput-input").fill("a blue box")
    viewer.page.get_by_role("button", name="Find").click()
    expect(viewer.page.locator("#gvr-count")).not_to_have_text(f"{red:,}", timeout=60_000)
    assert viewer.count() == int(session.ask("a blue box").grounding.flags.sum())
    for name in ("Cameras", "Votes", "Virtual cameras"):
        viewer.page.get_by_label(name, exact=True).check()
    assert viewer.wrong == []
    assert viewer.outside == []


def test_what_is_found_can_be_saved(viewer: ViewerPage, session: ViewSession, tmp_path) -> None:
    viewer.ask("a red box")
    with viewer.page.expect_download(timeout=60_000) as download:
        viewer.page.get_by_role("button", name="Save", exact=True).click()
    assert download.value.suggested_filename == "target.ply"
    path = tmp_path / "target.ply"
    download.value.save_as(path)
    flags = session.ask("a red box").grounding.flags
    saved = read_splat(path)
    np.testing.assert_array_equal(saved.means, session.data.scene.gaussians.means[flags])


def test_what_cannot_be_asked_is_said(viewer: ViewerPage) -> None:
    said = viewer.ask("x" * 401)
    assert "401 characters" in said
    assert "1 to 400" in said
    assert viewer.page.locator("#gvr-count").count() == 0


def test_words_are_shown_as_words(viewer: ViewerPage) -> None:
    viewer.ask("<img src=x onerror=console.error(1)>")
    assert viewer.wrong == []


def test_upright_screens_see_all_of_the_first_camera() -> None:
    camera = two_boxes()[0].views[0].camera
    for aspect in (0.4, 1.0, 3.0):
        page = SimpleNamespace(aspect=aspect, fov=None)  # stands for a browser's camera
        _show_all_of(camera, page)
        down = np.tan(page.fov / 2)
        sides = camera.width / camera.K[0, 0] / 2, camera.height / camera.K[1, 1] / 2
        assert min(down * aspect - sides[0], down - sides[1]) == pytest.approx(0, abs=1e-9)

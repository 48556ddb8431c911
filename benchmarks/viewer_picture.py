"""The viewer's picture in the docs: ``python benchmarks/viewer_picture.py``.

Opens a scene in the viewer, types a query in a headless Chromium (``chromium`` on the path, or
``GVR_CHROMIUM``), and takes a picture of the page.
"""

from __future__ import annotations

import io
from pathlib import Path

import typer
from PIL import Image
from playwright.sync_api import expect, sync_playwright
from screenshots import find_chromium

from flows.lines import ONBOARD, bundled_models
from flows.places import store_root
from flows.view_session import open_scene, start_session
from flows.viewer import Viewer

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
DESKTOP, PHONE = (1280, 720), (390, 844)
ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def main(
    scene: str = "gallery/gallery_0",
    text: str = "a tabby cat",
    method: str = "gvr-robust",
    phone: bool = False,
    out: Path | None = None,
) -> None:
    """Take the picture, as a desktop shows the page or as a phone does."""
    out = out or PICTURES / ("viewer_phone.png" if phone else "viewer.png")
    width, height = PHONE if phone else DESKTOP
    chromium = find_chromium()
    models = bundled_models(ONBOARD.label)
    session = start_session(open_scene(scene, None, None), method, models, store_root())
    viewer = Viewer(session, port=0)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=chromium, args=[*ARGUMENTS, "--disable-background-networking"]
            )
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(viewer.url)
            field = page.locator("form input.mantine-TextInput-input")
            field.fill(text)
            field.press("Enter")
            expect(page.locator("#gvr-status")).to_contain_text("Gaussians ·", timeout=120_000)
            page.get_by_label("Cameras", exact=True).check()
            notice = page.locator(".mantine-Notification-closeButton")
            for button in notice.all():
                button.click()
            page.wait_for_timeout(8_000)  # splats fade in, and are sorted again
            shot = page.screenshot()
            browser.close()
    finally:
        viewer.stop()
    Image.open(io.BytesIO(shot)).convert("RGB").quantize(192).save(out, optimize=True)
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    typer.run(main)

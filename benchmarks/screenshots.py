"""Pictures of the report and the comparison, taken by a headless Chromium, for the documents.

python benchmarks/screenshots.py RESULT [OTHER] [--out docs/pictures]
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image

from reports.html_compare import compare_page
from reports.html_report import report_page
from reports.result_io import read_result
from reports.run_comparison import compare_runs

ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
DESKTOP, PHONE = (1280, 900), (390, 844)
MOST_BYTES = 400_000


def find_chromium() -> str:
    """The browser: ``GVR_CHROMIUM``, else the one on the path; ends the process without one."""
    named = os.environ.get("GVR_CHROMIUM")
    found = named or shutil.which("chromium") or shutil.which("chromium-browser")
    return found or sys.exit("no chromium on the path (set GVR_CHROMIUM)")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", type=Path, help="folder of a result")
    parser.add_argument("other", type=Path, nargs="?", help="folder of a later one, to compare")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"))
    arguments = parser.parse_args()
    chromium = find_chromium()
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        report = folder / "report.html"
        report.write_text(report_page(arguments.result), encoding="utf-8")
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        for name_, size, scheme, where in (
            ("report_top", DESKTOP, "light", "top"),
            ("report_evidence", DESKTOP, "light", "evidence"),
            ("report_dark", DESKTOP, "dark", "evidence"),
            ("report_phone", PHONE, "light", "top"),
            ("report_phone_evidence", PHONE, "dark", "evidence"),
        ):
            page = opened(browser, report, size, scheme)
            if where == "evidence":
                show_evidence(page, wide=size == DESKTOP)
            save(page, arguments.out / f"{name_}.png", tall=where == "evidence")
            page.context.close()
        if arguments.other is not None:
            folders = arguments.result, arguments.other
            found = compare_runs(*(read_result(each) for each in folders), common=True)
            path = folder / "compare.html"
            path.write_text(compare_page(found, folders, 1.0), encoding="utf-8")
            page = opened(browser, path, DESKTOP, "light")
            save(page, arguments.out / "report_compare.png", tall=True)
        browser.close()
    return 0


def opened(browser, path: Path, size: tuple[int, int], scheme: str):
    """A page of its own, nothing carried over from another."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, offline=True
    )
    page = context.new_page()
    page.goto(path.as_uri())
    return page


def show_evidence(page, wide: bool) -> None:
    """Open the query of the first line with the highest overlap, and bring it to the top."""
    page.locator("#q-method").select_option(index=1)
    page.locator("#q-table th button", has_text="mIoU").click()
    page.locator("#q-table .open").first.click()
    page.locator(".evidence img").last.scroll_into_view_if_needed()
    target = page.locator("#queries" if wide else ".evidence")
    target.evaluate("node => node.scrollIntoView()")


def save(page, path: Path, tall: bool, most_bytes: int = MOST_BYTES) -> None:
    """The screen, or two of them, as a PNG of few colours that is not too large for a document."""
    size = page.viewport_size
    if tall:
        place = page.evaluate("scrollY")
        page.set_viewport_size({"width": size["width"], "height": 2 * size["height"]})
        page.evaluate(f"scrollTo(0, {place})")
    page.screenshot(path=path)
    for colours in (256, 128, 64):
        image = Image.open(path).convert("RGB")
        image.quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)
        if path.stat().st_size <= most_bytes:
            break
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    raise SystemExit(main())

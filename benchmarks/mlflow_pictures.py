"""Pictures of MLflow's pages for docs/mlflow.md, taken by a headless Chromium.

python benchmarks/mlflow_pictures.py RESULT... [--out docs/pictures]

Fills a store of its own from the results, serves it on 127.0.0.1, and takes its pages.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

from screenshots import ARGUMENTS, DESKTOP, PHONE, find_chromium, save

from reports.mlflow_history import history_experiment
from reports.mlflow_server import start_server
from reports.mlflow_sink import sync
from reports.mlflow_store import EXPERIMENT, LocalStore, mlflow_client

MOST_BYTES = 300_000
SETTLED = 4000
"""Milliseconds after which MLflow has drawn a page."""
QUIET = """
localStorage.setItem('mlflow.assistant.panelOpen_v1', 'false');
localStorage.setItem('mlflow.assistant.fab.autoOpenedOnFirstLoad_v1', 'true');
"""
"""The panel for chats covers a quarter of every page."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="+", help="folders of results")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"))
    arguments = parser.parse_args()
    chromium = find_chromium()
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as name:
        store = LocalStore(Path(name))
        benchmarks = [sync(folder, store.uri).parent_run for folder in arguments.results]
        places = pages(store, benchmarks[0])
        with start_server(0, store=store) as server, sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
            for size, ending, shown in ((DESKTOP, "", places), (PHONE, "_phone", ("run",))):
                for what in shown:
                    # Choices of columns and charts are kept by the browser: each page has its own.
                    context = browser.new_context(viewport={"width": size[0], "height": size[1]})
                    context.add_init_script(QUIET)
                    page = context.new_page()
                    opened(page, f"{server.url}/#/{places[what]}", narrow=size == PHONE)
                    prepare = PREPARED.get(what)
                    if prepare is not None:
                        prepare(page)
                        page.mouse.move(0, 0)  # what it points at shows tools
                        page.wait_for_timeout(SETTLED)
                    path = arguments.out / f"mlflow_{what}{ending}.png"
                    save(page, path, tall=False, most_bytes=MOST_BYTES)
                    context.close()
            browser.close()
    return 0


def pages(store: LocalStore, benchmark: str) -> dict[str, str]:
    """Picture -> the page's place.

    Args:
        store: Where the runs are.
        benchmark: MLflow's id of the benchmark whose runs are shown.
    """
    with mlflow_client(store.uri) as client:
        ids = {found.name: found.experiment_id for found in client.search_experiments()}
        below = f"tags.`mlflow.parentRunId` = '{benchmark}' and tags.label != 'random-patch'"
        scene = client.search_runs([ids[EXPERIMENT]], below)[0].info.run_id
    runs = f"experiments/{ids[EXPERIMENT]}/runs"
    over_time = f"experiments/{ids[history_experiment(EXPERIMENT)]}/runs"
    return {
        "runs": runs,
        "run": f"{runs}/{scene}",
        "queries": f"{runs}/{scene}/model-metrics",
        "system": f"{runs}/{benchmark}/system-metrics",
        "by_scene": f"{runs}?compareRunsMode=CHART&searchFilter=tags.kind%20%3D%20'scene'",
        "over_time": f"{over_time}?compareRunsMode=CHART",
    }


def opened(page, address: str, narrow: bool) -> None:
    """Open a page of MLflow's, and wait until it has been drawn."""
    page.goto(address)
    page.wait_for_timeout(SETTLED)
    page.get_by_text("Model training", exact=True).first.click()
    page.goto(address)
    page.wait_for_timeout(SETTLED)
    if narrow:
        page.get_by_label("Toggle sidebar").click()
        page.wait_for_timeout(SETTLED)


def with_columns(page) -> None:
    """The newest benchmark's scenes, with their numbers in place of what is the same for all."""
    page.locator("[data-component-id$='runnamecellrenderer.tsx_46']").first.click()
    page.get_by_role("button", name="Columns", exact=True).click()
    for column in ("Dataset", "Source", "Models", "scene", "label", "miou", "iou_3d", "revision"):
        page.get_by_placeholder("Search columns").fill(column)
        page.wait_for_timeout(SETTLED // 4)
        row = page.locator(".du-bois-light-tree-treenode").filter(
            has_text=re.compile(f"^{column}$")
        )
        row.locator(".du-bois-light-tree-checkbox").first.click()
    page.keyboard.press("Escape")


def grouped(page) -> None:
    """Runs by scene and method, and the charts of one number."""
    for tag in ("scene", "label"):
        page.get_by_role("button", name=re.compile("^Group")).click()
        # The first is the tag, the second the parameter of that name.
        page.get_by_role("menuitemcheckbox", name=tag, exact=True).first.click()
        page.wait_for_timeout(SETTLED // 4)
        page.keyboard.press("Escape")
    searched(page, "^(miou|iou_3d|query_seconds)$")


def searched(page, pattern: str) -> None:
    """The charts whose name fits a pattern."""
    page.get_by_placeholder("Search metric charts").fill(pattern)


PREPARED = {
    "runs": with_columns,
    "queries": lambda page: searched(page, "^query/"),
    "by_scene": grouped,
}


if __name__ == "__main__":
    raise SystemExit(main())

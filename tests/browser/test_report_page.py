"""The report in a real browser: sorted, filtered, opened, by hand and keyboard, on any screen."""

from __future__ import annotations

from pathlib import Path

import pytest
from report_samples import EVIL_METHOD, EVIL_TEXT, evil, written

from reports.html_compare import compare_page
from reports.html_report import report_page
from reports.result_io import read_result
from reports.run_comparison import compare_runs


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    path = folder / "report.html"
    path.write_text(report_page(written(folder, n_queries=6)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def evil_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evil")
    path = folder / "report.html"
    path.write_text(report_page(evil(folder)), encoding="utf-8")
    return path


def column(page, table: str, number: int) -> list[str]:
    cells = page.locator(f"{table} tbody tr:not([hidden]) td:nth-child({number})")
    return cells.all_inner_texts()


def numbers(texts: list[str]) -> list[float]:
    return [float(text) for text in texts if text != "–"]


def test_queries_are_sorted_and_what_has_no_number_comes_last(report, open_page) -> None:
    page = open_page(report).page
    assert page.locator("#q-table tbody tr").count() == 24
    head = page.locator("#q-table th", has_text="mIoU")
    place = 1 + page.locator("#q-table th").all_inner_texts().index("mIoU")
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "descending"
    shown = column(page, "#q-table", place)
    assert numbers(shown) == sorted(numbers(shown), reverse=True) and len(set(shown)) > 5
    assert shown[-4:] == ["–"] * 4, "absent objects have no overlap"
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    shown = column(page, "#q-table", place)
    assert numbers(shown) == sorted(numbers(shown)) and shown[-4:] == ["–"] * 4
    assert page.locator('#q-table th[aria-sort="ascending"]').count() == 1


def test_tables_in_the_page_are_sorted_and_filtered(report, open_page) -> None:
    page = open_page(report).page
    box = page.locator(".table", has=page.locator("h3", has_text="Each method on each scene"))
    head = box.locator("th", has_text="3D IoU")
    head.get_by_role("button").click()
    place = 1 + box.locator("thead tr:last-child th").all_inner_texts().index("3D IoU")
    shown = [float(t) for t in box.locator(f"tbody td:nth-child({place})").all_inner_texts()]
    assert shown == sorted(shown, reverse=True) and shown[0] > shown[-1]
    box.get_by_role("searchbox").fill("garden RFL")
    assert box.locator("tbody tr:visible").count() == 1
    assert box.get_by_role("status").inner_text() == "1 of 4 rows"


def test_queries_are_filtered(report, open_page) -> None:
    page = open_page(report).page
    page.locator("#q-scene").select_option("garden")
    page.locator("#q-method").select_option("w/o RFL")
    assert page.locator("#q-count").inner_text() == "6 of 24 answers"
    page.locator("#q-text").fill("thing-4")
    assert column(page, "#q-table", 1) == ["the thing-4"]
    page.locator("#q-text").fill("")
    page.locator("#q-kind").select_option("absent")
    assert column(page, "#q-table", 1) == ["the thing-5"]


def test_evidence_comes_in_order_and_pictures_only_when_opened(report, open_page) -> None:
    page = open_page(report).page
    assert page.locator("img").count() == 0
    button = page.get_by_role("button", name="the thing-0").first
    button.click()
    assert button.get_attribute("aria-expanded") == "true"
    detail = page.locator("tr.detail")
    assert detail.locator("h4").all_inner_texts() == [
        "1. Retrieved views, the most relevant first",
        "2. Votes in 3D",
        "3. Bird’s-eye view and its mask",
        "4. Surrounding views and their masks",
        "5. The answer in the test views",
    ]
    captions = detail.locator("figcaption").all_inner_texts()
    assert captions[0].startswith("0.900 view_00 · ✓ place 1")
    assert any("✗ no place" in text for text in captions)
    assert "ring camera 2 · nothing found in it" in captions
    assert "v1 · Acc 0.0 · mIoU 10.0" in captions
    loaded = "images => images.every(image => image.complete && image.naturalWidth === 120)"
    assert detail.locator("img").evaluate_all(loaded)
    before = detail.locator("img").count()
    detail.get_by_role("button", name="Show the other 2 views").click()
    assert detail.locator("img").count() == before + 2
    # the votes are drawn: in the colours of supporters and of the place
    drawn = """canvas => {
        const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        const seen = new Set();
        for (let i = 0; i < all.length; i += 4) seen.add([all[i], all[i + 1], all[i + 2]].join());
        return [seen.has("230,159,0"), seen.has("255,90,90")];
    }"""
    assert detail.locator("canvas").evaluate(drawn) == [True, True]
    detail.get_by_label("show outlines").uncheck()
    assert not detail.locator(".shot svg").first.is_visible()
    button.click()
    assert page.locator("tr.detail").count() == 0


def test_everything_works_with_the_keyboard_alone(report, open_page) -> None:
    page = open_page(report).page
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "To the content"
    page.locator("#q-text").focus()
    page.keyboard.type("thing-3")
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.closest('#q-table th') !== null"):
            break
    outline = "getComputedStyle(document.activeElement).outlineStyle"
    assert page.evaluate(outline) == "solid", "the focus can be seen"
    page.keyboard.press("Enter")
    assert page.locator('#q-table th[aria-sort="ascending"]').inner_text().startswith("query")
    while not page.evaluate("document.activeElement.classList.contains('open')"):
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement !== document.body")
    page.keyboard.press("Enter")
    assert page.locator("tr.detail h4").count() == 5
    canvas = page.locator("canvas")
    before = canvas.evaluate("canvas => canvas.toDataURL()")
    canvas.focus()
    page.keyboard.press("ArrowLeft")
    turned = canvas.evaluate("canvas => canvas.toDataURL()")
    page.keyboard.press("+")
    assert len({before, turned, canvas.evaluate("canvas => canvas.toDataURL()")}) == 3


@pytest.mark.parametrize("width", [360, 390, 1280])
def test_the_page_never_scrolls_sideways(report, evil_report, open_page, width) -> None:
    for path in (report, evil_report):
        page = open_page(path, width=width).page
        page.locator("#q-table .open").first.click()
        for details in page.locator("summary").all():
            details.click()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        edge = page.locator(".evidence").evaluate("box => box.getBoundingClientRect().right")
        assert edge <= width, "evidence fits the screen though its table is wider"


def test_light_and_dark_can_both_be_read(report, open_page) -> None:
    contrast = """() => {
        const luminance = (text) => {
            const [r, g, b] = text.match(/[0-9.]+/g).slice(0, 3).map((v) => {
                const c = v / 255;
                return c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
            });
            return 0.2126 * r + 0.7152 * g + 0.0722 * b;
        };
        const backdrop = (node) => {
            for (let n = node; n; n = n.parentElement) {
                const colour = getComputedStyle(n).backgroundColor;
                if (!/, 0\\)$/.test(colour)) return colour;
            }
            return "rgb(255, 255, 255)";
        };
        const ratios = [];
        for (const node of document.querySelectorAll("p, td, th, h2, summary, li, .open, b, a")) {
            if (!node.textContent.trim() || !node.offsetParent) continue;
            const [a, b] = [getComputedStyle(node).color, backdrop(node)].map(luminance);
            ratios.push((Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05));
        }
        return Math.min(...ratios);
    }"""
    backgrounds = []
    for scheme in ("light", "dark"):
        page = open_page(report, scheme=scheme).page
        page.locator("#q-table .open").first.click()
        assert page.evaluate(contrast) >= 4.5
        backgrounds.append(page.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert backgrounds[0] != backgrounds[1]


def test_names_that_try_to_run_are_shown_as_text(evil_report, open_page) -> None:
    page = open_page(evil_report).page
    assert page.locator("#q-table .open").first.inner_text() == EVIL_TEXT
    page.locator("#q-table .open").first.click()
    assert EVIL_TEXT in page.locator(".evidence").inner_text()
    assert EVIL_METHOD in page.locator("#q-method").inner_text()
    assert page.evaluate("window.owned") is None
    assert page.locator("svg[onload], img[onerror]").count() == 0


def test_a_script_that_got_in_would_not_run(report, tmp_path, browser) -> None:
    """The policy of the page holds where escaping would have failed."""
    path = tmp_path / "broken.html"
    own = report.read_text(encoding="utf-8")
    broken = own.replace("<main", "<script>window.owned = 1</script><main", 1)
    broken = broken.replace("</main>", '<img src="https://example.invalid/x.png"></main>', 1)
    path.write_text(broken, encoding="utf-8")
    page = browser.new_page()
    blocked: list[str] = []
    page.on("console", lambda message: blocked.append(message.text))
    page.goto(path.as_uri())
    assert page.evaluate("window.owned") is None
    assert page.locator("#q-table tbody tr").count() == 24, "our own script does"
    assert sum("Content Security Policy" in text for text in blocked) == 2
    page.close()


def test_hundreds_of_queries_stay_quick(tmp_path, open_page) -> None:
    path = tmp_path / "many.html"
    folder = written(tmp_path, n_queries=300, with_evidence=False)
    path.write_text(report_page(folder), encoding="utf-8")
    page = open_page(path).page
    assert page.locator("#q-count").inner_text() == "1200 of 1200 answers"
    assert page.locator("#q-table tbody tr").count() == 100
    milliseconds = page.evaluate("""() => {
        const start = performance.now();
        document.querySelector("#q-table th:nth-child(5) button").click();
        document.body.getBoundingClientRect();
        return performance.now() - start;
    }""")
    assert milliseconds < 1000
    page.locator("#q-more").click()
    assert page.locator("#q-table tbody tr").count() == 200


def test_a_comparison_opens_too(tmp_path, open_page) -> None:
    folders = written(tmp_path / "a", n_queries=5), written(tmp_path / "b", n_queries=5, shift=-0.1)
    found = compare_runs(read_result(folders[0]), read_result(folders[1]))
    path = tmp_path / "compare.html"
    path.write_text(compare_page(found, folders, 1.0), encoding="utf-8")
    for width in (1280, 360):
        page = open_page(path, width=width).page
        assert "dropped by more than 1.0 points" in page.locator(".note.bad").inner_text()
        pair = page.locator("section.pair").first
        pair.scroll_into_view_if_needed()
        image = pair.locator("img").first
        page.wait_for_function("image => image.complete", arg=image.element_handle())
        assert image.evaluate("image => image.naturalWidth") == 120
        assert page.evaluate("document.documentElement.scrollWidth") <= width

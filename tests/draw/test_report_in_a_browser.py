"""Reports in real Chromium, from the disk: what is seen, pressed, printed and never asked for."""

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from tests.draw.rerun.rrds import make_foreign_run

pytestmark = pytest.mark.browser
RECORDINGS = Path(__file__).parents[2] / "recordings" / "paper"
SCRIPT = "<script>alert(1)</script>"
CHROMIUM = shutil.which("chromium")

Open = Callable[..., Any]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no chromium is installed")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def open_report(browser: Any) -> Iterator[Open]:
    """Open a file, and hold it to no error, no warning and no other request."""
    told: list[str] = []
    asked: list[str] = []
    contexts = []

    def open_(path: Path, *, width: int = 1200, **options: Any) -> Any:
        context = browser.new_context(viewport={"width": width, "height": 900}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda line: told.append(f"{line.type}: {line.text}"))
        page.on("pageerror", lambda err: told.append(f"error: {err}"))
        page.on("dialog", lambda dialog: told.append(f"error: {dialog.message}"))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-whole]", timeout=20_000)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert [line for line in told if line.startswith(("error", "warning"))] == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "two.html"
    runs = [tl.read_run(RECORDINGS / f"{name}.mcap") for name in ("kp4", "kp10")]
    tl.draw.write_report([replace(runs[0], name=SCRIPT), runs[1]], path)
    return path


def press(page: Any, selector: str, *keys: str) -> None:
    page.focus(selector)
    for key in keys:
        page.keyboard.press(key)


def read_pixels(page: Any, place: str) -> bytes:
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    pixels: bytes = page.locator(place).screenshot()
    return pixels


@pytest.mark.thorough
def test_the_slider_drives_turtles_and_values_by_keyboard(
    two_runs: Path, open_report: Open
) -> None:
    """Chromium starts with the first of these tests."""
    page = open_report(two_runs)
    before = read_pixels(page, "#plane")
    assert "12.608 s" in page.inner_text("#values caption")
    press(page, "#time", "Home", "PageUp")
    assert "1.261 s" in page.inner_text("#values caption")
    assert read_pixels(page, "#plane") != before


@pytest.mark.thorough
def test_runs_and_play_answer_the_space_bar_in_the_order_of_tab(
    two_runs: Path, open_report: Open
) -> None:
    page = open_report(two_runs)
    before = read_pixels(page, "#plot-speed")
    press(page, "[data-run='1']", "Space")
    assert page.locator("#values tbody tr").count() == 1
    assert read_pixels(page, "#plot-speed") != before
    press(page, "#play", "Space")
    assert page.get_attribute("#play", "aria-pressed") == "true"
    page.keyboard.press("Space")
    assert page.inner_text("#play") == "Play"
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "time"
    press(page, "#closer", "Enter")
    start, end = page.evaluate(
        "(r => [r.start, r.end])(Bokeh.documents[0].get_model_by_id("
        "JSON.parse(document.getElementById('config').textContent).x_range))"
    )
    assert end - start == pytest.approx(1.024 * 12.608 / 2.0, rel=1e-3)


def test_names_are_text_and_a_narrow_window_has_one_column(
    two_runs: Path, open_report: Open
) -> None:
    page = open_report(two_runs, width=390)
    assert SCRIPT in page.inner_text("h1")
    assert SCRIPT in page.inner_text("#runs")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    lefts = [page.locator(f"#{place}").bounding_box()["x"] for place in ("plane", "goal")]
    assert lefts[0] == lefts[1]


@pytest.mark.thorough
def test_paper_shows_light_copies_of_the_plots_without_controls(
    two_runs: Path, open_report: Open
) -> None:
    page = open_report(two_runs, color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 26)"
    pdf = page.pdf(format="A4")
    copies = page.evaluate(
        "[...document.querySelectorAll('.plot > canvas')].map(c => ["
        "...c.getContext('2d').getImageData(3, 3, 1, 1).data])"
    )
    assert copies == [[255, 255, 255, 255]] * page.locator(".plot").count()
    assert pdf.count(b"/Subtype /Image") >= len(copies)
    page.emulate_media(media="print")
    assert not page.is_visible("#time")


@pytest.mark.thorough
def test_a_robot_s_bag_six_samples_and_a_long_name_are_shown(
    tmp_path: Path, open_report: Open
) -> None:
    """Chromium draws a report of its own."""
    bag, run = make_foreign_run(50), tl.read_run(RECORDINGS / "kp4.mcap")
    short = replace(run.slice(0.0, 0.08), name="six_" * 60)
    tl.draw.write_report([bag], tmp_path / "bag.html")
    tl.draw.write_report([short], tmp_path / "short.html")
    for name in ("bag", "short"):
        page = open_report(tmp_path / f"{name}.html", width=390)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.locator("#plane .bk-Figure").count() == 1


TIPS = """() => {
  const found = [], walk = (root) => root.querySelectorAll("*").forEach((one) => {
    if (one.shadowRoot === null) return;
    if (one.classList.contains("bk-Tooltip")) found.push(one.shadowRoot.textContent);
    walk(one.shadowRoot);
  });
  walk(document);
  return found.join(" ");
}"""


@pytest.mark.thorough
def test_the_mouse_reads_all_runs_at_a_time_that_every_plot_shows(
    two_runs: Path, open_report: Open
) -> None:
    page = open_report(two_runs)
    page.locator("#plot-speed").scroll_into_view_if_needed()
    before, box = read_pixels(page, "#plot-turn_rate"), page.locator("#plot-speed").bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.6 * box["height"])
    page.wait_for_function(f"({TIPS})().includes('kp10')")
    told = page.evaluate(TIPS)
    assert SCRIPT in told
    values = re.findall(r"speed: *([-0-9.]+) m/s", told)
    assert len(values) == 2
    assert set(values) == {"1.0000"}  # both drive at their limit there
    assert read_pixels(page, "#plot-turn_rate") != before


def test_what_comes_into_a_report_from_outside_does_nothing(
    two_runs: Path, browser: Any, tmp_path: Path
) -> None:
    """As if a name were written without being escaped."""
    strange = (
        f"{SCRIPT}<img src='https://elsewhere.example/x.png' onerror='alert(2)'>"
        "<script src='https://elsewhere.example/x.js'></script>"
        "<style>body{background:url(https://elsewhere.example/y.png)}</style>"
        "<link rel=stylesheet href='https://elsewhere.example/x.css'>"
    )
    page, told, asked = browser.new_page(), [], []
    page.on("dialog", lambda dialog: told.append(dialog.dismiss() or dialog.message))
    page.on("requestfinished", lambda request: asked.append(request.url))
    page.on("requestfailed", lambda request: asked.append(f"{request.url} {request.failure}"))
    path = tmp_path / "strange.html"
    path.write_text(two_runs.read_text("utf-8").replace("<main>", f"<main>{strange}"), "utf-8")
    page.goto(path.as_uri())
    page.wait_for_selector("html[data-whole]", timeout=20_000)
    left = [url for url in asked if "elsewhere" in url and not url.endswith(" csp")]
    assert (told, left) == ([], [])
    page.close()

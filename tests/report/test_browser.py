"""The report in a real browser: nothing is fetched, nothing complains, charts do what hands ask of them."""

import numpy as np
import pandas as pd
import pytest

from skdgp.report import FlightResult, ReportContent, write_report

N, RATE = 4000, 40.0
TIME = np.arange(N) / RATE
MEAN = 0.1 * np.sin(TIME[:, None] * np.arange(1, 7)) + 0.01
MEASURED = MEAN + 0.02 * np.random.default_rng(0).normal(size=(N, 6))
VIEW = "(d => [+d.begin, +d.end])(document.querySelector('.live').dataset)"
PLOT = "(b => [b.x, b.y, b.width, b.height])(document.querySelector('.plot').getBoundingClientRect())"
LEFT, RIGHT = 46, 6  # margins of a plot [px]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    table = pd.DataFrame({"time": TIME, "elevator": 0.05 * np.sin(TIME), "rudder": 0.1 * np.cos(TIME)})
    table = table.assign(north=10.0 * TIME, east=200.0 * np.sin(TIME / 20))
    flight = FlightResult(
        name="a flight", time=TIME, measured=MEASURED, mean=MEAN, std=np.full((N, 6), 0.02), table=table
    )
    content = ReportContent(title="Report", train={"b": table.copy()}, test=[flight])
    return write_report(tmp_path_factory.mktemp("report") / "report.html", content)


@pytest.fixture
def chart(browser, page):
    """Return the browser with the first chart in sight, and where its first plot is."""
    browser.open(page)
    browser.value("document.querySelector('.live').scrollIntoView()")
    yield browser, browser.value(PLOT)
    assert browser.complaints() == []


def whole(browser):
    browser.click(".spans button")
    browser.value("document.querySelector('.live').scrollIntoView()")
    assert browser.value(VIEW) == pytest.approx([0, TIME[-1]])


def clock(browser):
    """Return the time that is read."""
    return float(browser.value("document.querySelector('.clock').textContent").split()[1])


def numbers(browser, panel=0):
    """Return the values read at the cursor, by name."""
    shown = browser.value(
        f"[...document.querySelectorAll('.panel')[{panel}].querySelectorAll('.value span')].map(e => e.textContent)"
    )
    words = [text.replace("−", "-").split() for text in shown]
    return {name: float(value) for name, value, *_ in words}


def test_pointing_reads_the_nearest_sample_in_every_panel(chart):
    browser, (x, y, width, _) = chart
    begin, end = browser.value(VIEW)
    browser.mouse("mouseMoved", x + LEFT + 0.3 * (width - LEFT - RIGHT), y + 50)
    nearest = round((begin + 0.3 * (end - begin)) * RATE)
    assert clock(browser) == pytest.approx(TIME[nearest], abs=0.006)
    for k in range(6):
        read = numbers(browser, k)
        assert read == pytest.approx({"estimated": MEAN[nearest, k], "measured": MEASURED[nearest, k]}, abs=1e-3)
    cursors = browser.value("[...document.querySelectorAll('.cursor')].filter(e => !e.hidden).length")
    assert cursors == 6 + 2  # the flight's inputs follow, those of the other flight do not


def test_dragging_and_the_wheel_zoom_in_time(chart):
    browser, (x, y, width, _) = chart
    whole(browser)
    span, length = width - LEFT - RIGHT, TIME[-1]
    browser.drag((x + LEFT + 0.25 * span, y + 50), (x + LEFT + 0.5 * span, y + 50))
    begin, end = browser.value(VIEW)
    assert (begin, end) == pytest.approx((0.25 * length, 0.5 * length), abs=0.01 * length)
    every = browser.value("[...document.querySelectorAll('.live')].map(e => +e.dataset.begin)")
    assert every == [begin, 0.0, begin]  # the coefficients, the inputs of the other flight, those of this one
    # Zooming keeps the time under the pointer where it is; Ctrl lets the page stand still.
    at = x + LEFT + 0.5 * span
    browser.mouse("mouseWheel", at, y + 50, deltaX=0, deltaY=-120, modifiers=2)
    browser.settle()
    closer = browser.value(VIEW)
    assert np.ptp(closer) < 0.8 * (end - begin)
    assert np.mean(closer) == pytest.approx((begin + end) / 2, abs=0.02 * (end - begin))
    browser.mouse("mousePressed", at, y + 50, button="left", clickCount=2)
    browser.mouse("mouseReleased", at, y + 50, button="left", clickCount=2)
    browser.settle()
    assert browser.value(VIEW) == pytest.approx([0, length])


def test_keys_do_what_the_mouse_does(chart):
    browser, _ = chart
    whole(browser)
    browser.value("document.querySelector('.grid').focus()")
    browser.key("+")
    begin, end = browser.value(VIEW)
    assert end - begin == pytest.approx(TIME[-1] / 2)
    browser.key("End")
    assert browser.value(VIEW) == pytest.approx([TIME[-1] / 2, TIME[-1]])
    assert clock(browser) == pytest.approx(TIME[-1], abs=0.006)
    spoken = browser.value("document.querySelector('.unseen').textContent")
    assert "CX: estimated" in spoken
    assert "Cn: estimated" in spoken
    browser.key("0")
    assert browser.value(VIEW) == pytest.approx([0, TIME[-1]])


def test_lines_are_drawn_hidden_and_shown_relative_to_the_estimate(chart):
    browser, _ = chart
    drawn = "document.querySelector('.plot canvas').toDataURL()"
    before = browser.value(drawn)
    browser.click(".toggles button:nth-child(3)")
    browser.mouse("mouseMoved", *np.add(browser.value(PLOT)[:2], (200, 50)).tolist())
    assert set(numbers(browser)) == {"estimated"}
    without = browser.value(drawn)
    browser.click(".toggles .way")
    assert len({before, without, browser.value(drawn)}) == 3
    browser.mouse("mouseMoved", *np.add(browser.value(PLOT)[:2], (200, 50)).tolist())
    assert numbers(browser) == {"estimated": 0.0}


def test_each_pixel_column_keeps_its_extremes(chart):
    browser, _ = chart
    whole(browser)
    cells = browser.value(
        "(c => c.condense(c.panels[4], c.panels[4].series.at(-1), 400).strokes)(links.get('a flight').charts[0])"
    )
    assert len(cells) == 1
    column = np.floor(400 * TIME / TIME[-1])
    of_column = [MEASURED[column == k, 4] for k in np.unique(column)]
    for edge, extreme in (("low", np.min), ("high", np.max)):
        np.testing.assert_allclose([cell[edge] for cell in cells[0]], list(map(extreme, of_column)), atol=1e-5)


def test_lines_break_at_gaps_and_new_windows(chart):
    browser, _ = chart
    assert browser.value("[...cuts(new Float64Array([0, 1, 2, 50, 51]), null)]") == [1, 0, 0, 1, 0]
    assert browser.value("[...cuts(new Float64Array([0, 1, 2, 3]), [7, 7, 8, 8])]") == [1, 0, 1, 0]


def test_the_cursor_stands_on_the_map(chart):
    browser, (x, y, width, _) = chart
    begin, end = browser.value(VIEW)
    shown = "[...document.querySelectorAll('.place')].filter(e => e.getAttribute('visibility') === 'visible')"
    assert browser.value(f"{shown}.length") == 0
    places, times = [], []
    for part in (0.1, 0.6):
        browser.mouse("mouseMoved", x + LEFT + part * (width - LEFT - RIGHT), y + 50)
        times.append(begin + part * (end - begin))
        places += browser.value(f"{shown}.map(e => [+e.getAttribute('cx'), +e.getAttribute('cy')])")
    # Both axes have one scale, and north is up.
    flown = np.column_stack([200 * np.sin(np.divide(times, 20)), np.multiply(times, -10.0)])
    scale = np.diff(places, axis=0) / np.diff(flown, axis=0)
    assert scale[0, 0] == pytest.approx(scale[0, 1], rel=0.02)
    assert scale[0, 0] > 0
    browser.mouse("mouseMoved", 5, 5)
    assert browser.value(f"{shown}.length") == 0


def test_everything_to_press_has_the_name_that_is_seen(chart):
    browser, _ = chart
    nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
    names = [node["name"]["value"] for node in nodes if node.get("role", {}).get("value") == "button"]
    assert {"Whole flight", "Zoom in", "Zoom out", "Earlier", "Later", "measured", "less estimate"} <= set(names)
    assert all(names)


def test_a_phone_scrolls_one_way_and_pinches(browser, page):
    browser.open(page, width=390, height=844, phone=True)
    assert browser.value("document.documentElement.scrollWidth") <= 390
    browser.value("document.querySelector('.live').scrollIntoView()")
    x, y, *_ = browser.value(PLOT)
    begin, end = browser.value(VIEW)
    browser.touch("touchStart", (x + 150, y + 50), (x + 200, y + 50))
    browser.touch("touchMove", (x + 125, y + 50), (x + 225, y + 50))
    browser.touch("touchEnd")
    browser.settle()
    assert np.ptp(browser.value(VIEW)) == pytest.approx((end - begin) / 2, rel=0.01)
    small = browser.value("[...document.querySelectorAll('.live button')].filter(e => e.offsetHeight < 24).length")
    assert small == 0  # WCAG 2.2, target size
    assert browser.complaints() == []


def test_pictures_stand_where_there_is_no_script_and_on_paper(browser, page):
    shown = "[...document.querySelectorAll('.static svg')].filter(e => e.checkVisibility()).length"
    browser.open(page)
    assert browser.value(shown) == 0
    browser.call("Emulation.setEmulatedMedia", media="print")
    on_paper = browser.value(shown)
    browser.call("Emulation.setEmulatedMedia", media="")
    browser.open(page, scripts=False)
    assert browser.value(shown) == on_paper == 6
    assert browser.complaints() == []

"""The report's pictures as SVG."""

import re
from xml.etree import ElementTree

import numpy as np

from skdgp._display.page import picture, strip
from skdgp.report._figures import busiest_span

SQUARE = {"size": (3, 3), "margins": (0.2, 0.9, 0.2, 0.9)}


def paths(svg):
    return re.findall(r' d="([^"]*)"', svg)


def test_is_well_formed_and_says_what_it_shows():
    svg = picture(lambda ax: ax.plot([0, 1], [0, 1]), label='<a> & "b"', **SQUARE)
    assert ElementTree.fromstring(svg).get("aria-label") == '<a> & "b"'


def test_colours_are_the_pages():
    svg = picture(lambda ax: ax.plot([0, 1], [0, 1], color="#0072B2"), label="", **SQUARE)
    assert "var(--blue)" in svg
    assert "var(--ink)" in svg
    assert "#0072b2" not in svg
    assert "#000000" not in svg


def test_written_numbers_are_not_rounded():
    def draw(ax):
        ax.set_yticks([0.12345678], ["0.12345678"])
        ax.text(0.5, 0.5, "x=0.98765432")

    svg = picture(draw, label="", **SQUARE)
    assert "0.12345678" in svg
    assert "x=0.98765432" in svg


def test_coordinates_keep_their_shape():
    x = np.linspace(0, 1, 400)

    def draw(ax):
        ax.plot(x, np.sin(20 * x), color="#123456")
        ax.set(xlim=(0, 1), ylim=(-1, 1))

    svg = picture(draw, label="", **SQUARE)
    longest = max(paths(svg), key=len)
    points = np.array(longest.replace("M", "").split(), dtype=float).reshape(-1, 2)
    left, right, low, high = 0.2 * 216, 0.9 * 216, 0.8 * 216, 0.1 * 216
    drawn = np.interp(
        points[:, 0], left + (right - left) * x, low + (np.sin(20 * x) + 1) / 2 * (high - low)
    )
    assert np.abs(points[:, 1] - drawn).max() < 1.5


def test_strips_of_a_column_have_axes_of_one_size():
    def plot(ax):
        ax.plot([0, 1], [0, 1])
        ax.set_xlabel("time [s]")

    heights = []
    for bottom in (False, True):
        svg = strip(plot, label="", bottom=bottom)
        clip = re.search(r'<rect[^>]*width="([\d.]+)"[^>]*height="([\d.]+)"', svg) or re.search(
            r"<rect[^>]*>", svg
        )
        heights.append(re.search(r'height="([\d.]+)"', clip[0])[1])
        assert ("time [s]" in svg) is bottom
    assert abs(float(heights[0]) - float(heights[1])) < 0.01


def test_busiest_span_finds_the_manoeuvre():
    time = np.arange(4000) / 20.0
    values = np.zeros((4000, 2))
    values[2000:2400, 1] = 1e-6 * np.sin(np.arange(400))
    begin, end = busiest_span(time, values, length=30.0)
    assert end - begin == 30.0
    assert begin <= 100.0
    assert end >= 120.0


def test_no_span_of_a_short_record_or_one_that_goes_back():
    assert busiest_span(np.arange(40.0), np.zeros((40, 1)), length=30.0) is None
    assert busiest_span(np.tile(np.arange(100.0), 2), np.zeros((200, 1)), length=30.0) is None

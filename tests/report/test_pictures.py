"""The pictures of pages: SVG files of their own, small and true."""

import re
from html import unescape
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np

from skdgp._display.page import MARGINS, picture
from skdgp.report._page import liveliest_rows

SIZE = 3.0, 3.0


def svg_of(html):
    return unquote(re.search(r'src="data:image/svg\+xml,([^"]*)"', html)[1])


def drawn(draw, label=""):
    return picture(lambda figure: draw(figure.subplots()), label=label, size=SIZE)


def test_is_a_file_of_its_own_and_says_what_it_shows():
    html = drawn(lambda ax: ax.plot([0, 1], [0, 1]), '<a> & "b"')
    assert ElementTree.fromstring(svg_of(html)).get("viewBox") == "0 0 216 216"
    assert unescape(re.search(r'alt="([^"]*)"', html)[1]) == '<a> & "b"'


def test_coordinates_keep_their_shape_and_written_numbers_are_not_rounded():
    x = np.linspace(0, 1, 400)

    def draw(ax):
        ax.plot(x, np.sin(20 * x), color="#123456")
        ax.set(xlim=(0, 1), ylim=(-1, 1), yticks=[0.12345678], yticklabels=["0.12345678"])
        ax.text(0.5, 0.5, "x=0.98765432")

    svg = svg_of(drawn(draw))
    assert "0.12345678" in svg
    assert "x=0.98765432" in svg
    longest = max(re.findall(r' d="([^"]*)"', svg), key=len)
    points = np.array(longest.replace("M", "").split(), dtype=float).reshape(-1, 2)
    left, right, below, above = MARGINS
    width, height = 3 - left - right, 3 - below - above
    line = np.interp(points[:, 0] / 72, left + width * x, 0.5 - 0.5 * np.sin(20 * x))
    assert np.abs(points[:, 1] / 72 - (above + height * line)).max() < 0.02


def test_the_liveliest_rows_hold_the_manoeuvre():
    time = np.arange(4000) / 20.0
    values = np.zeros((4000, 2))
    values[2000:2400, 1] = 1e-6 * np.sin(np.arange(400))
    shown = time[liveliest_rows(time, values, length=30.0)]
    assert shown[-1] - shown[0] == 30.0
    assert shown[0] <= 100.0
    assert shown[-1] >= 120.0


def test_all_of_a_short_record_or_one_that_goes_back():
    assert liveliest_rows(np.arange(40.0), np.zeros((40, 1)), length=30.0) == slice(None)
    assert liveliest_rows(np.tile(np.arange(100.0), 2), np.zeros((200, 1)), length=30.0) == slice(
        None
    )

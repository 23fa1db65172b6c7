"""Colours that every reader can tell apart, and words that every reader can make out."""

import re
from itertools import combinations

import numpy as np
import pytest

from skdgp._display.page import STYLE
from skdgp._display.style import CYCLE, MARKERS, QUIET, ROLES, dashes

# Linear RGB as dichromats see it: Machado, Oliveira & Fernandes (2009), severity 1.
VISION = {
    "trichromat": np.eye(3),
    "protanope": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranope": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanope": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
# IEC 61966-2-1 (sRGB), white D65.
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
LIGHT, DARK = (
    dict(re.findall(r"--(\w+): (#\w{6})", rules))
    for rules in re.findall(r":root \{(.*?)\}", STYLE, re.S)
)


def linear(colour):
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(colour, vision):
    """Return CIELAB coordinates (CIE 15) of a colour as it is seen."""
    xyz = TO_XYZ @ np.clip(VISION[vision] @ linear(colour), 0, 1) / TO_XYZ.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one, other):
    """Return the contrast ratio of WCAG 2.1."""
    light, dark = sorted((TO_XYZ[1] @ linear(colour) for colour in (one, other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def distances(colours, vision):
    return {
        pair: np.linalg.norm(lab(pair[0], vision) - lab(pair[1], vision))
        for pair in combinations(colours, 2)
    }


def test_the_measure_knows_black_white_and_what_a_protanope_confuses():
    assert np.linalg.norm(
        lab("#ffffff", "trichromat") - lab("#000000", "trichromat")
    ) == pytest.approx(100, abs=0.01)
    red_and_olive = [
        np.linalg.norm(lab("#a00000", v) - lab("#4d4d00", v)) for v in ("trichromat", "protanope")
    ]
    assert red_and_olive[1] < 0.5 * red_and_olive[0]
    assert contrast("#000000", "#ffffff") == pytest.approx(21)


@pytest.mark.parametrize("vision", VISION)
def test_measured_estimated_and_truth_are_far_apart(vision):
    """A difference of 2.3 is just noticed (Mahy et al. 1994)."""
    lines = [ROLES["measured"], ROLES["mean"], ROLES["truth"]]
    assert min(distances(lines, vision).values()) > 20


@pytest.mark.parametrize("vision", VISION)
def test_colours_in_turn_are_apart(vision):
    assert min(distances(CYCLE, vision).values()) > 15


def test_no_colour_stands_alone():
    """Outputs of one dash have markers of their own."""
    assert len(set(MARKERS)) == len(MARKERS) == len(CYCLE)
    assert dashes("CX") != dashes("CY")


@pytest.mark.parametrize("page", [LIGHT, DARK], ids=["light", "dark"])
def test_words_have_contrast(page):
    for words in ("ink", "quiet", "alert", "yes", "partly"):
        assert contrast(page[words], page["paper"]) >= 4.5  # WCAG 2.1, AA
    for words in ("ink", "alert"):
        assert contrast(page[words], page["tint"]) >= 4.5
    for line in ("measured", "mean", "edge", "truth"):
        assert contrast(ROLES[line], "#ffffff") >= 3
    assert contrast(QUIET, "#ffffff") >= 4.5

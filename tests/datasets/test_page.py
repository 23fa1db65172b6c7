"""The page on the example flights states what is so."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "example_flights.md"


@pytest.mark.parametrize("name", ["alpha", "p", "ax", "v_north", "north", "airspeed"])
def test_page_states_the_noise_that_is_added(name):
    from skdgp.datasets._example_flights import DEGREE, SENSOR_NOISE

    row = next(
        line
        for line in PAGE.read_text(encoding="utf-8").splitlines()
        if re.match(rf"\|.*`{name}`.*\|", line)
    )
    unit = DEGREE if "degrees" in row else 1.0
    assert float(row.split("|")[2].split()[0]) * unit == pytest.approx(SENSOR_NOISE[name])

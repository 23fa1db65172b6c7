"""The page on the example flights runs as it stands."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "example_flights.md"


def test_code_of_the_page_runs_in_order(capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 4
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert "lateral" in capsys.readouterr().out
    assert names["CZ"] < 0
    assert (names["scores"] > 0.5).all()


@pytest.mark.parametrize("name", ["alpha", "p", "ax", "v_north", "north", "airspeed"])
def test_page_states_the_noise_that_is_added(name):
    from skdgp.datasets._sensors import DEGREE, SENSOR_NOISE

    row = next(line for line in PAGE.read_text(encoding="utf-8").splitlines() if re.match(rf"\|.*`{name}`.*\|", line))
    unit = DEGREE if "degrees" in row else 1.0
    assert float(row.split("|")[2].split()[0]) * unit == pytest.approx(SENSOR_NOISE[name])

"""The aircraft file that the concept page shows is one."""

import re
from pathlib import Path

import pytest

from skdgp.dynamics import Aircraft

PAGE = Path(__file__).resolve().parents[2] / "docs" / "dynamics.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_the_aircraft_file_is_one(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "delta.toml").write_text(text)
    aircraft = Aircraft.from_toml(tmp_path / "delta.toml")
    assert aircraft.propeller.thrust(600.0, 0.0) > 0
    assert aircraft.mass == pytest.approx(12.0)

"""The aircraft's door: what comes back, and what is refused with which words."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.dynamics import Aircraft, Propeller, ThrustLine

GOOD = {
    "name": "delta",
    "mass": 75.0,
    "inertia": [[10.9, 0.0, 1.8], [0.0, 39.9, 0.0], [1.8, 0.0, 42.5]],
    "wing_area": 3.6,
    "span": 2.8,
    "chord": 2.1,
    "thrust_line": {"position": [-1.2, 0.0, -0.1], "direction": [2.0, 0.0, 0.0]},
    "propeller": {"diameter": 0.7, "thrust_coefficients": [0.1, -0.05]},
    "full_deflections": {"elevator": 0.42, "rudder": 0.35},
    "sensor_position": [0.35, 0.0, -0.12],
}


def without(*keys, **changes):
    return {key: value for key, value in {**GOOD, **changes}.items() if key not in keys}


def test_json_round_trip(tmp_path):
    aircraft = Aircraft.from_dict(GOOD)
    (tmp_path / "a.json").write_text(aircraft.to_json())
    again = Aircraft.from_file(tmp_path / "a.json")
    assert again == aircraft
    assert hash(again) == hash(aircraft)
    assert isinstance(again.thrust_line, ThrustLine)
    assert isinstance(again.propeller, Propeller)
    assert_allclose(again.thrust_line.direction, [1, 0, 0])
    assert again.full_deflections == {"elevator": 0.42, "rudder": 0.35}
    assert_allclose(again.sensor_position, [0.35, 0.0, -0.12])


def test_the_aircraft_file_of_the_page_is_one(tmp_path, blocks_of):
    (text,) = blocks_of("dynamics.md", "toml")
    (tmp_path / "delta.toml").write_text(text)
    aircraft = Aircraft.from_file(tmp_path / "delta.toml")
    assert aircraft.propeller.thrust(600.0, 0.0) > 0
    assert_allclose(aircraft.mass, 12.0)


def test_moments_of_inertia_that_no_body_has_are_warned_of():
    """A flat one has the sum."""
    assert Aircraft.from_dict(without(inertia=np.diag([10.0, 20.0, 30.0]))).inertia[2, 2] == 30.0
    with pytest.warns(UserWarning, match="exceeds the sum of the others"):
        Aircraft.from_dict(without(inertia=np.diag([10.0, 20.0, 30.2])))


@pytest.mark.filterwarnings("ignore:No aeroplane has these sizes")
@pytest.mark.parametrize("largest", [1e-5, 7e7])
def test_an_inertia_is_symmetric_but_for_rounding(largest):
    """Of a micro air vehicle and of an airliner."""
    inertia = largest * np.diag([0.4, 0.7, 1.0])
    inertia[0, 2] = 1e-7 * largest
    Aircraft.from_dict(without(inertia=inertia))
    inertia[0, 2] = 1e-4 * largest
    with pytest.raises(ValueError, match="not symmetric"):
        Aircraft.from_dict(without(inertia=inertia))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass", 0.0),
        ("wing_area", np.nan),
        ("chord", 10**400),
        ("mass", "heavy"),
        ("span", None),
    ],
)
def test_sizes_must_be_positive_numbers(name, value):
    with pytest.raises(ValueError, match=f"Got {name}=.* expected a .*number > 0"):
        Aircraft.from_dict(without(**{name: value}))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (without(inertia=[1.0, 2.0, 3.0]), "3 x 3"),
        (without(inertia=[[1, 0, 2.0], [0, 2, 0], [2.0, 0, 2.5]]), "not positive definite"),
        (without("wing_area", wingarea=3.6), "unknown key 'wingarea'.*did you mean 'wing_area'"),
        (without("chord"), r"lacks \['chord'\]"),
        (None, "the aircraft lacks"),
        (without(thrust_line=[1, 0, 0]), "Got list for thrust_line, but expected ThrustLine"),
        (
            without(full_deflections={"elevatr": 0.4}),
            "deflection of 'elevatr' .nearest: 'elevator'",
        ),
    ],
)
def test_what_is_no_aircraft(values, words):
    with pytest.raises((ValueError, TypeError), match=words):
        Aircraft.from_dict(values)

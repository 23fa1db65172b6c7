"""The usual propeller of a size: what it is, and what its deviation makes of a model."""

import numpy as np
import pandas as pd
import pytest

from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    Propeller,
    aerodynamic_coefficients,
    stability_derivatives,
)
from skdgp.identification._assumed import assumptions, lacks_thrust, with_thrust_errors

SIZE = {"diameter": 0.254, "pitch": 0.127}
MOTOR = {"motor_constant": 94.2, "voltage": 11.1}
REGRESSORS = ("alpha", "beta", "elevator", "throttle")


def test_thrust_vanishes_beyond_the_pitch_and_power_is_more_than_thrust_times_airspeed():
    for pitch in (0.1, 0.15, 0.2, 0.25):
        propeller = Propeller.from_size(0.254, pitch)
        J = np.linspace(0, 1.6 * pitch / 0.254, 200)
        thrust, torque = (
            propeller.thrust(2 * np.pi, J * 0.254),
            -propeller.torque(2 * np.pi, J * 0.254),
        )
        zero = J[np.argmax(thrust < 0)] * 0.254 / pitch
        assert 1.0 < zero < 1.5  # cambered blades pull beyond the geometric pitch
        assert (np.diff(thrust) < 0).all()
        efficiency = (thrust * J * 0.254 / (2 * np.pi * torque))[thrust > 0]
        assert 0.4 < efficiency.max() < 0.85


@pytest.mark.parametrize(
    ("pitch", "ratio", "thrust"),
    [
        (5, 0.0, 0.0975),
        (5, 0.43, 0.0453),
        (7, 0.353, 0.0913),
        (7, 0.576, 0.0486),
        (4.7, 0.0, 0.1278),
    ],
)
def test_propellers_of_the_wind_tunnel(pitch, ratio, thrust):
    """C_T of APC 10x5 and 10x7 Thin Electric and 10x4.7 Slow Flyer (UIUC, volume 1), which are among the 178."""
    propeller = Propeller.from_size(0.254, pitch * 0.0254)
    usual = propeller.thrust(2 * np.pi, ratio * 0.254, density=1 / 0.254**4)
    assert thrust == pytest.approx(usual, rel=2 * propeller.load_std)


def test_a_motor_gives_the_speed_and_more_deviation():
    propeller = Propeller.from_size(**SIZE, **MOTOR)
    assert propeller.speed_at(1.0) == pytest.approx(0.75 * 94.2 * 11.1)
    assert propeller.load_std > 1.5 * Propeller.from_size(**SIZE).load_std


@pytest.mark.parametrize(
    "bad",
    [
        {"pitch": 0.0},
        {"motor_constant": 94.0},
        {"voltage": 11.0},
        {"diameter": "ten"},
        {"pitch": np.inf},
    ],
)
def test_sizes_that_are_none(bad):
    with pytest.raises(ValueError, match="expected a number > 0"):
        Propeller.from_size(**SIZE | bad)


def test_sizes_beyond_the_tunnel_are_said():
    with pytest.warns(UserWarning, match="diameter 1.5, but its thrust is estimated from others"):
        Propeller.from_size(1.5, 0.9)


def test_an_aircraft_file_has_diameter_and_pitch():
    aircraft = Aircraft.from_dict(
        {"kind": "conventional", "mass": 2.0, "span": 1.5, "propeller": SIZE | MOTOR}
    )
    assert aircraft.propeller == Propeller.from_size(**SIZE, **MOTOR)
    assert Aircraft.from_dict(aircraft.to_dict()).propeller == aircraft.propeller
    with pytest.raises(ValueError, match="unknown key 'pich'"):
        Aircraft.from_dict(
            {
                "kind": "conventional",
                "mass": 2.0,
                "span": 1.5,
                "propeller": {"diameter": 1, "pich": 1},
            }
        )


@pytest.fixture(scope="module")
def flown():
    """A flight with a throttle alone, and its regressors."""
    rng, n = np.random.default_rng(0), 400
    regressors = pd.DataFrame(rng.uniform(0, 0.1, (n, len(REGRESSORS))), columns=list(REGRESSORS))
    regressors["throttle"] = rng.uniform(0.4, 0.9, n)
    still = dict.fromkeys(("ax", "ay", "p", "q", "r"), 0.0)
    table = pd.DataFrame(
        {"time": 0.05 * np.arange(n), "airspeed": 14 + 50 * regressors["alpha"], "density": 1.2}
    )
    return table.assign(**still, az=-9.8, throttle=regressors["throttle"]), regressors


def test_the_throttle_gives_the_thrust_where_the_motor_is_known(flown):
    table, _ = flown
    told = Aircraft.estimate(2.0, 1.5, propeller=SIZE | MOTOR)
    assert not lacks_thrust("auto", [table], told)
    assert lacks_thrust("auto", [table], Aircraft.estimate(2.0, 1.5, propeller=SIZE))
    thrust = told.propeller.thrust(
        told.propeller.speed_at(table["throttle"]), table["airspeed"], 1.2
    )
    drag = aerodynamic_coefficients(table, told, cutoff=None)["CX"]
    assert np.allclose(drag, -thrust / (0.6 * table["airspeed"] ** 2 * told.wing_area))


def test_its_deviation_is_what_another_thrust_makes_of_a_linear_model(flown):
    """Identify with the thrust of a propeller that pulls 1 % more: the derivatives change by what ``added`` says."""
    table, X = flown

    def learned(factor):
        propeller = Propeller.from_size(**SIZE, **MOTOR)
        coefficients = tuple(factor * c for c in propeller.thrust_coefficients)
        torques = tuple(factor * c for c in propeller.torque_coefficients)
        engine = {
            **propeller.__dict__,
            "thrust_coefficients": coefficients,
            "torque_coefficients": torques,
        }
        aircraft = Aircraft.estimate(
            2.0, 1.5, propeller=Propeller(**engine), thrust_line={"position": [0, 0, -0.1]}
        )
        Y = aerodynamic_coefficients(table, aircraft, cutoff=None).to_numpy()
        return aircraft, np.linalg.lstsq(np.column_stack([np.ones(len(X)), X]), Y, rcond=None)[0]

    (aircraft, weights), (_, others) = learned(1.0), learned(1.01)
    aircraft = with_thrust_errors(aircraft, table, X, "auto")
    model = Aerodynamics(lambda rows: weights[0] + rows @ weights[1:], REGRESSORS)
    state = np.array([0, 0, -100, 15, 0, 0.7, 1, 0, 0, 0, 0, 0, 0])
    only = {**aircraft.to_dict(), "deviations": {"thrust": aircraft.deviations["thrust"]}}
    controls = {"elevator": 0.05, "throttle": 0.6}
    derivatives = stability_derivatives(
        model, Aircraft.from_dict(only), state, controls, thrust=None
    )
    for name, k in (("CX_alpha", 1), ("CX_throttle", 4)):
        change = 100 * aircraft.propeller.load_std * abs(others[k, 0] - weights[k, 0])
        assert derivatives.loc[name, "std_aircraft"] == pytest.approx(change, rel=1e-6)
    change = 100 * aircraft.propeller.load_std * abs(others[4, 4] - weights[4, 4])
    assert derivatives.loc["Cm_throttle", "std_aircraft"] == pytest.approx(change, rel=1e-6)
    assert derivatives.loc["CZ_alpha", "std_aircraft"] == 0
    lines = assumptions(aircraft, servos=None, thrust_unknown=False)
    assert any("thrust (size of the propeller)" in line for line in lines)

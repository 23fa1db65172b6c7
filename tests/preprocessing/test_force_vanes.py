"""Alpha of a flight in gusts without a vane: the lift shows it, attitude and velocity do not."""

import numpy as np
import pandas as pd
import pytest

from skdgp.preprocessing import FlightPathReconstruction
from skdgp.preprocessing._force_vanes import with_force_vanes

GRAVITY, DENSITY, SPEED, SLOPE = 9.80665, 1.2, 25.0, -0.08
"""The last one is of az / (rho V^2) by alpha [m^2/kg]: the aircraft follows gusts at 2.4 rad/s."""


@pytest.fixture(scope="module")
def flight():
    """Return a flight through vertical gusts, pitched by a commanded attitude, lifted by alpha, level in flat turns."""
    rng, step, n = np.random.default_rng(0), 0.05, 1600
    time = step * np.arange(n)
    theta, gust, down = 0.05 + np.zeros(n), np.zeros(n), np.zeros(n)
    for rate, size in ((2.2, 0.03), (5.1, 0.03), (7.4, 0.02)):
        theta += size * np.sin(rate * time)
    alpha, az = np.zeros(n), np.zeros(n)
    for k in range(n):
        through = down[k] - gust[k]
        u, w = (
            SPEED * np.cos(theta[k]) - through * np.sin(theta[k]),
            SPEED * np.sin(theta[k]) + through * np.cos(theta[k]),
        )
        alpha[k], square = np.arctan2(w, u), u**2 + w**2
        az[k] = -GRAVITY + SLOPE * DENSITY * square * (alpha[k] - 0.05)
        if k < n - 1:
            down[k + 1] = down[k] + step * (az[k] / np.cos(theta[k]) + GRAVITY)
            gust[k + 1] = gust[k] * (1 - step / 5) + 1.2 * np.sqrt(step) * rng.standard_normal()
    psi, turn = 0.9 * np.sin(0.15 * time), 0.135 * np.cos(0.15 * time)
    columns = {
        "p": -turn * np.sin(theta), "q": np.gradient(theta, step), "r": turn * np.cos(theta),
        "ax": -az * np.tan(theta), "ay": SPEED * turn, "az": az, "phi": 0.0, "theta": theta, "psi": psi,
        "v_north": SPEED * np.cos(psi), "v_east": SPEED * np.sin(psi), "v_down": down,
        "airspeed": np.hypot(SPEED, down - gust), "elevator": np.roll(theta, 7) - 0.05,
    }  # fmt: skip
    noise = {"p": 0.002, "q": 0.002, "r": 0.002, "ax": 0.05, "ay": 0.05, "az": 0.05} | {
        "airspeed": 0.3
    }
    noise |= dict.fromkeys(("phi", "theta", "psi"), 0.005) | dict.fromkeys(
        ("v_north", "v_east", "v_down"), 0.1
    )
    seen = {
        name: values + noise.get(name, 0.0) * rng.standard_normal(n)
        for name, values in columns.items()
    }
    return pd.DataFrame({"time": time, "density": DENSITY, "alpha_true": alpha, **seen})


@pytest.fixture(scope="module")
def by_forces(flight):
    return FlightPathReconstruction(vanes="forces").fit(flight)


def slope_of_truth(flight, alpha):
    return np.polyfit(alpha, flight["alpha_true"], 1)[0]


def test_the_path_alone_lacks_gusts_that_the_force_shows(flight, by_forces):
    blind = FlightPathReconstruction().fit_transform(flight)["alpha"]
    alpha = by_forces.transform(flight)["alpha"]
    assert slope_of_truth(flight, blind) < 0.8  # as if the lift slope were weaker
    assert slope_of_truth(flight, alpha) == pytest.approx(1.0, abs=0.05)
    errors = [np.std(each - flight["alpha_true"]) for each in (alpha, blind)]
    assert errors[0] < 0.2 * errors[1]


def test_the_slope_lies_within_its_deviation(by_forces):
    vane = by_forces.vanes_["alpha"]
    assert abs(vane.slope / SLOPE - 1) < 2 * vane.std < 0.4
    assert vane.cutoff == pytest.approx(2.0 * -SLOPE * DENSITY * SPEED / (2 * np.pi), rel=0.1)


def test_a_force_that_tells_nothing_is_no_vane(flight, by_forces):
    assert "beta" not in by_forces.vanes_
    still = flight.assign(
        az=-GRAVITY + 0.05 * np.random.default_rng(1).standard_normal(len(flight))
    )
    assert FlightPathReconstruction(vanes="forces").fit(still[:400]).vanes_ == {}


def test_a_vane_that_is_there_stays(flight, by_forces):
    table = flight.assign(alpha=0.1)
    assert (with_force_vanes(table, by_forces.vanes_)["alpha"] == 0.1).all()

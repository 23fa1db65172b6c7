"""Numbers that are no SI units: the limits, just inside and just outside, and surfaces that are commands."""

import warnings

import numpy as np
import pandas as pd
import pytest

from skdgp.dynamics import Aircraft, aerodynamic_coefficients

GLIDER = Aircraft.estimate(3.0, 1.8)
ROWS = np.arange(1000)
LEVEL = {"airspeed": 20.0, "density": 1.2, "az": -9.8}
LEVEL |= dict.fromkeys(("p", "q", "r", "ax", "ay"), 0.0)


def coefficients(**channels):
    """Return the coefficients of a level flight with further channels."""
    table = pd.DataFrame({"time": 0.01 * ROWS, **LEVEL, **channels})
    return aerodynamic_coefficients(table, GLIDER, thrust=None, cutoff=None)


def said_of(**channels):
    """Return the refusal of a level flight with further channels, else all warnings."""
    with warnings.catch_warnings(action="always", record=True) as caught:
        try:
            coefficients(**channels)
        except ValueError as refusal:
            return str(refusal)
    return "\n".join(str(warning.message) for warning in caught)


@pytest.mark.parametrize(("elevator", "rows"), [(0.9, 900), (1.0, 5), (-1.0, 5)])
def test_commands_from_minus_one_to_one_are_warned_of(elevator, rows):
    """Beyond what servos move, or at the end of a command's range though rarely."""
    words = r"surfaces .* up to elevator [^,]*, more than .* commands from -1 to 1, multiply"
    with pytest.warns(UserWarning, match=words):
        coefficients(elevator=np.where(rows > ROWS, elevator, 0.1), rudder=0.2)


# No surface turns by more than 90 degrees, no aircraft by three turns a second; angles may have noise
ANGLES = {"alpha": 1.7, "phi": np.pi + 0.05, "psi": 2 * np.pi + 0.05, "flap": 1.6, "q": 20.0}
# Medians count
MOST = ROWS < 520
# A pitching that alternates, whose angle is that of milliseconds in place of seconds
NOD = np.resize([0.1, -0.1], 1000)


def nodding(step, scale):
    return {"time": step * ROWS, "q": NOD, "theta": scale * np.cumsum(NOD)}


@pytest.mark.parametrize(
    ("channels", "limit", "outside", "words"),
    [
        *[
            (lambda x, name=name: {name: x}, most, 1.001, "degrees")
            for name, most in ANGLES.items()
        ],
        (lambda x: {"alpha": np.where(ROWS < 50, -x, 0.1)}, 90.0, 1.01, "mark of missing values"),
        (lambda x: {"elevator": x}, 0.7, 1.01, "commands from -1 to 1"),
        (lambda x: {"elevator": x}, 90.0, 1.01, "counts or pulses of servos"),
        (lambda x: {"throttle": x}, 2.1, 1.01, "expected 0 to 1"),  # an afterburner has more than 1
        (lambda x: {"density": np.where(MOST, x, 1.2)}, 0.05, 0.99, "kg/m^3"),
        (lambda x: {"density": x}, 2.5, 1.01, "kg/m^3"),
        (lambda x: {"density": 1.225 * x, "altitude": 0.0}, 0.8, 0.99, "standard atmosphere"),
        (lambda x: {"density": 1.225 * x, "altitude": 0.0}, 1.25, 1.01, "standard atmosphere"),
        (lambda x: {"az": -np.where(MOST, x, 9.8)}, 2.0, 0.99, "looks like g"),
        (lambda x: {"az": -x}, 0.5, 1.01, "looks like g"),  # below, gravity was removed
        (lambda x: {"az": -x}, 3.0, 0.99, "level flight gives 9.8"),
        (lambda x: {"az": -x}, 300.0, 1.01, "level flight gives 9.8"),
        (lambda x: {"az": x}, 3.0, 1.01, "z points down"),
        (lambda x: {"time": x * ROWS}, 5.0, 1.01, "milliseconds"),
        (lambda x: {"time": x * ROWS}, 9e-4, 0.99, "minutes"),
        (lambda x: nodding(0.5, 0.5 * x), 0.1, 0.99, "milliseconds"),
        (lambda x: nodding(x, 0.01), 0.5, 1.01, "milliseconds"),
    ],
)
def test_numbers_of_another_unit_are_told(channels, limit, outside, words):
    assert words in said_of(**channels(outside * limit))
    assert words not in said_of(**channels(limit / outside))

"""Surfaces that make controls together by weights."""

import numpy as np
import pytest

from skdgp.design import Wavetrain, ardupilot_script, doublet
from skdgp.io import FlightReadError, read_flight, read_servos


def servo(n, low=-0.4, high=0.4, trim=1500, **more):
    return {
        "channel": f"RCOU.C{n}",
        "min": 1100,
        "trim": trim,
        "max": 1900,
        "deflection": [low, high],
        **more,
    }


FILES = {
    "vtail": {
        "left": servo(2, -0.3, 0.5), "right": servo(4, reversed=True),
        "mixing": {"elevator": {"left": 0.5, "right": 0.5}, "rudder": {"left": 0.5, "right": -0.5}},
    },
    "weights": {
        "fin": servo(4), "tail": servo(2), "wing": servo(1),
        "mixing": {"rudder": {"fin": 0.8, "tail": 0.3}, "elevator": {"tail": 1.0}, "aileron": {"wing": -1, "fin": 0.1}},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_control_is_the_weighted_sum_of_angles(name, tmp_path, dataflash):
    """Pulses to angles by straight lines through min, trim, max of each servo, written by hand."""
    servos, time = FILES[name], 0.02 * np.arange(1, 300)
    pulses = {n: 1500 + 350 * np.sin(2 * np.pi * 0.3 * time + n) for n in (1, 2, 4)}
    log = dataflash("ArduPlane V4.5.1")
    log.topic("RCOU", time, **{f"C{n}": ("f", values) for n, values in pulses.items()})
    (tmp_path / "log.bin").write_bytes(bytes(log))
    flight = read_flight(tmp_path / "log.bin", servos=servos, airborne=False)
    for control, weights in servos["mixing"].items():
        expected = 0.0
        for surface, weight in weights.items():
            entry = servos[surface]
            low, high = entry["deflection"]
            angles = np.interp(
                pulses[int(entry["channel"][-1])], [1100, 1500, 1900], [low, 0, high]
            )
            expected = expected + weight * angles * (-1 if entry.get("reversed") else 1)
        expected = np.interp(flight["time"], time, expected)
        np.testing.assert_allclose(flight[control], expected, atol=2e-4)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (
            {"fin": servo(1), "mixing": {"tail": {"fin": 1.0}}},
            r"expected weights of surfaces for some of",
        ),
        (
            {"fin": servo(1), "mixing": {"rudder": {"fin": "all"}}},
            r"expected weights of surfaces for some of",
        ),
        ({"mixing": {"rudder": {"fin": 1.0}}}, "expected a channel of each of these"),
        (
            {"fin": "20 deg", "mixing": {"rudder": {"fin": 1.0}}},
            "expected a channel of each of these",
        ),
        (
            {"fin": servo(1), "rudder": servo(2), "mixing": {"rudder": {"fin": 1.0}}},
            "and none of the rudder itself",
        ),
        (
            {
                "left": servo(1),
                "right": servo(2) | {"channel": "AUX.C2"},
                "mixing": {"aileron": {"left": 0.5, "right": -0.5}},
            },
            "channels of several topics",
        ),
    ],
)
def test_mixtures_that_make_no_sense(entries, words):
    with pytest.raises(FlightReadError, match=words):
        read_servos(entries)


def test_a_plan_for_a_v_tail():
    """The script moves both halves: elevator alike, rudder against each other, against ArduPilot's outputs, up."""
    train = Wavetrain({"elevator": {0.0: doublet(0.5, 0.1)}, "rudder": {2.0: doublet(0.5, 0.1)}})
    text = ardupilot_script(train, 50.0, {"vtail_left": 0.4, "vtail_right": 0.4})
    assert "servo = 79, full = -0.4" in text
    assert "parts = {1.0, 1.0}" in text
    assert "parts = {1.0, -1.0}" in text

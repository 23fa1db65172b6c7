"""Surfaces that make controls together: by name, by weights, by the parameters of an autopilot, and back to servos."""

import numpy as np
import pandas as pd
import pytest

from skdgp.design import Wavetrain, ardupilot_script, doublet
from skdgp.io import FlightReadError, read_flight, servo_outputs
from skdgp.io._servos import Mixture, read_servos


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
    "vtail and flaperon": {
        "vtail_left": servo(2, -0.3, 0.5), "vtail_right": servo(4, reversed=True),
        "flaperon_left": servo(1), "flaperon_right": servo(5, -0.2, 0.35, trim=1450),
    },
    "two servos of other throw": {"elevator_left": servo(2), "elevator_right": servo(3, -0.2, 0.3), "rudder": servo(4)},
    "weights": {
        "fin": servo(4), "tail": servo(2), "wing": servo(1),
        "mixing": {"rudder": {"fin": 0.8, "tail": 0.3}, "elevator": {"tail": 1.0}, "aileron": {"wing": -1, "fin": 0.1}},
    },
    "elevons": {"elevon_left": servo(1), "elevon_right": servo(2, reversed=True), "rudder": servo(4)},
}  # fmt: skip


def logged(outputs, tmp_path, writer, **parameters):
    """Return the path of a DataFlash log of the outputs of servos, with all decimals that its format has."""
    log = writer("ArduPlane V4.5.1", **parameters)
    time = outputs["time"].to_numpy()
    channels = {
        name.removeprefix("RCOU."): outputs[name].to_numpy() for name in outputs if name != "time"
    }
    log.topic("RCOU", time, **{name: ("f", values) for name, values in channels.items()})
    log.topic("ARSP", time, Airspeed=("f", np.full(len(time), 20.0)), H=("B", np.ones(len(time))))
    (tmp_path / "log.bin").write_bytes(bytes(log))
    return tmp_path / "log.bin"


@pytest.mark.parametrize("name", FILES)
def test_table_to_servos_to_table(name, tmp_path, dataflash):
    servos, rng = FILES[name], np.random.default_rng(0)
    controls = read_servos(servos)
    if name == "elevons":
        controls = {"elevator": 0, "aileron": 0, "rudder": 0}
    time = 0.02 * np.arange(1, 300)
    waves = {c: 0.1 * np.sin(2 * np.pi * (0.3 * time + rng.uniform())) for c in controls}
    table = pd.DataFrame({"time": time, **waves})
    outputs = servo_outputs(table, servos)
    found = {}
    for control, each in read_servos(servos).items():
        parts = each.parts if isinstance(each, Mixture) else ((1.0, each),)
        found[control] = sum(
            weight * part.deflection(outputs[part.channel].to_numpy()) for weight, part in parts
        )
    if name == "elevons":
        left, right = found.pop("elevon_left"), found.pop("elevon_right")
        found |= {"elevator": (left + right) / 2, "aileron": (left - right) / 2}
    np.testing.assert_allclose(
        pd.DataFrame(found)[list(waves)], table[list(waves)], rtol=0, atol=1e-13
    )
    path = logged(outputs, tmp_path, dataflash)
    flight = read_flight(path, servos=servos, airborne=False)  # floats of 32 bits, on another clock
    if name == "elevons":
        flight["elevator"] = (flight["elevon_left"] + flight["elevon_right"]) / 2
        flight["aileron"] = (flight["elevon_left"] - flight["elevon_right"]) / 2
    for control, wave in waves.items():
        expected = np.interp(flight["time"], time, wave)
        np.testing.assert_allclose(flight[control], expected, atol=2e-4)


def test_the_signs_of_pairs():
    """Left down and right up rolls right; both halves of a V-tail down pitch down; left down, right up yaws left."""
    entries = {
        name: servo(n)
        for n, name in enumerate(("vtail_left", "vtail_right", "flaperon_left", "flaperon_right"))
    }
    up, down = np.array([1100.0]), np.array([1900.0])

    def control(name, left, right):
        (w, one), (v, other) = read_servos(entries)[name].parts
        return (w * one.deflection(left) + v * other.deflection(right)).item()

    assert control("elevator", down, down) == pytest.approx(0.4)
    assert control("rudder", down, up) == pytest.approx(0.4)
    assert control("aileron", down, up) == pytest.approx(0.4)
    assert (
        control("aileron", down, down)
        == control("elevator", down, up)
        == control("rudder", up, up)
        == 0
    )


@pytest.mark.parametrize("left", [1.0, -1.0])
def test_flaperons_of_ardupilot(left, tmp_path, dataflash):
    """Versions differ in the sign of the left output: it moves with the right one or against it.

    No flap in it.
    """
    time = np.arange(0.0, 10, 0.02)
    aileron, flap = 0.5 * np.sin(2 * np.pi * 0.5 * time), 0.3 * time / 10
    outputs = pd.DataFrame({"time": time, "RCOU.C1": 1500 + 400 * left * (aileron + flap)})
    outputs["RCOU.C2"] = 1500 - 400 * (aileron - flap)  # reversed
    functions = {"SERVO1_FUNCTION": 24.0, "SERVO2_FUNCTION": 25.0, "SERVO2_REVERSED": 1.0}
    table = read_flight(
        logged(outputs, tmp_path, dataflash, **functions), servos="full throw", airborne=False
    )
    assert np.allclose(table["aileron"], np.interp(table["time"], time, aileron), atol=2e-2)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (
            {"vtail_left": servo(1)},
            "Got 'vtail_left' in the servo file, but expected one of .* both of vtail_left and",
        ),
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
            {"aileron_left": servo(1), "aileron_right": servo(2) | {"channel": "AUX.C2"}},
            "channels of several topics",
        ),
    ],
)
def test_mixtures_that_make_no_sense(entries, words):
    with pytest.raises(FlightReadError, match=words):
        read_servos(entries)


def test_what_servos_cannot_do():
    table = pd.DataFrame({"time": [0.0], "elevator": [0.1], "rudder": [0.1]})
    one = {"fin": servo(1), "mixing": {"elevator": {"fin": 1.0}, "rudder": {"fin": 1.0}}}
    with pytest.raises(FlightReadError, match="expected some that move each of these by itself"):
        servo_outputs(table, one)
    with pytest.raises(FlightReadError, match="write its servo in full"):
        servo_outputs(table, {"rudder": "20 deg"})
    folded = {"rudder": {"channel": "RCOU.C4", "points": [[1100, 0.1], [1500, 0.3], [1900, 0.2]]}}
    with pytest.raises(FlightReadError, match="expected them to rise or fall throughout"):
        servo_outputs(table, folded)
    with pytest.raises(ValueError, match=r"lacks the columns .*aileron"):
        servo_outputs(table, {"aileron": servo(1)})


def test_a_plan_for_a_v_tail():
    """The script moves both halves: elevator alike, rudder against each other, against ArduPilot's outputs, up."""
    train = Wavetrain({"elevator": {0.0: doublet(0.5, 0.1)}, "rudder": {2.0: doublet(0.5, 0.1)}})
    text = ardupilot_script(train, 50.0, {"vtail_left": 0.4, "vtail_right": 0.4})
    assert "servo = 79, full = -0.4" in text
    assert "parts = {1.0, 1.0}" in text
    assert "parts = {1.0, -1.0}" in text

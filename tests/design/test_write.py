"""The script, run by Lua beside a stub of ArduPilot's calls, flies what was planned."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp.design import (
    Wavetrain,
    ardupilot_script,
    doublet,
    orthogonal_multisines,
    three_two_one_one,
    wavetrain,
)

LIMITS = {"elevator": 0.05, "aileron": 0.1, "rudder": 0.15, "throttle": 0.2}
FULL = {"elevator": 0.4, "aileron": 0.35, "rudder": 0.5}
# lua5.4, from Python
LUA = """
import sys
from lupa.lua54 import LuaRuntime
lua = LuaRuntime()
lua.globals().arg = lua.table_from(sys.argv[2:])
lua.globals().dofile(sys.argv[1])
"""


@pytest.fixture(scope="module")
def train():
    """Return all kinds of inputs on all axes, some of them at times between rows."""
    multisines = orthogonal_multisines({name: LIMITS[name] for name in FULL}, 10.0, (0.2, 2.0))
    return wavetrain(
        [
            {"elevator": doublet(0.333, 0.05)},
            {"rudder": three_two_one_one(0.4, -0.15)},
            multisines,
            {"throttle": doublet(2.0, 0.2)},
        ],
        pause=1.0,
        limits=LIMITS,
    )


@pytest.fixture(scope="module")
def flown(train, tmp_path_factory):
    """Return what the script logs and sets: time, inputs by axis, widths of servos 1 to 11."""
    path = tmp_path_factory.mktemp("lua") / "plan.lua"
    stub = Path(__file__).with_name("autopilot.lua")

    def run(jitter=0, off=1e9, full=FULL):
        path.write_text(ardupilot_script(train, 50.0, full))
        command = [sys.executable, "-c", LUA, str(stub), str(path), str(jitter), str(off)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        rows = [line.split(",") for line in done.stdout.splitlines()]
        names = ["time", *train.inputs, *(f"servo{k}" for k in range(1, 12))]
        return pd.DataFrame(rows, columns=names).astype(float), done.stderr

    return run


def test_the_script_gives_the_planned_signal(train, flown):
    logged, said = flown()
    table = train.table(50.0)
    assert "plan: complete" in said
    assert_allclose(logged["time"][: len(table)], table["time"], atol=1e-12)
    for axis in train.inputs:
        assert_allclose(logged[axis][: len(table)], table[axis], atol=1e-6)
    assert (logged[list(train.inputs)].iloc[len(table) :] == 0).all(axis=None)


def test_limits_hold_at_every_step_of_a_script_that_is_called_late(flown, train):
    logged, _ = flown(jitter=35)
    for axis, limit in LIMITS.items():
        assert logged[axis].abs().max() <= limit
    late = logged[logged["time"] <= train.duration]
    assert_allclose(late["rudder"], train("rudder", late["time"]), rtol=0, atol=1e-6)


def test_servos_move_by_the_inputs_around_the_autopilots_commands(flown):
    """Commands of the stub are 5 % of the range, 40 % of the throttle."""
    logged, _ = flown()
    right = 0.05 + logged["aileron"] / 0.35
    up = 0.05 - logged["elevator"] / 0.4
    yaw = 0.05 - logged["rudder"] / 0.5
    for name, expected in (
        ("servo1", 1500 + 500 * right), ("servo5", 1500 - 500 * right), ("servo4", 1500 + 500 * yaw),
        ("servo2", 1480 + np.where(up > 0, 520, 480) * up), ("servo3", 1000 + 1000 * (0.4 + logged["throttle"])),
    ):  # fmt: skip
        assert_allclose(logged[name], expected, atol=0.5 + 1e-6)


PULSE = {0.0: doublet(1.0, 0.1)}
ELEVONS = dict.fromkeys(("elevon_left", "elevon_right"), 0.15)


@pytest.mark.parametrize(
    ("inputs", "full", "words"),
    [
        ({"thrust": {0.0: doublet(1, 5.0)}}, FULL, "that move with the thrust: add"),
        ({"rudder": PULSE}, {"rudder": 0.0}, "expected a number > 0"),
        ({"elevator": PULSE}, {"flap": 1.0}, "full deflection of 'flap'.*expected some of"),
        (
            dict.fromkeys(("elevator", "aileron"), PULSE),
            ELEVONS,
            "elevon_left up to 0.2",
        ),
        ({"throttle": {0.0: doublet(1, 1.5)}}, FULL, "full deflection is 1"),
    ],
)
def test_what_cannot_be_written_is_refused(inputs, full, words):
    with pytest.raises(ValueError, match=words):
        ardupilot_script(Wavetrain(inputs), 50.0, full)

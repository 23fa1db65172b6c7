"""Flights behind a stand-in for ArduPilot, which sends packets as SIM_JSON.cpp does and reads lines as it does."""

import json
import socket
import struct
import threading
from contextlib import suppress

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.control import fly
from skdgp.dynamics import (
    Aerodynamics,
    Servos,
    SimulationWarning,
    Turbulence,
    simulate,
    standard_density,
    trim,
)

GRAVITY = 9.80665
FULL = {"aileron": 0.4, "elevator": 0.3, "rudder": 0.3, "thrust": 60.0}
NEUTRAL = (1500, 1500, 1100, 1500)
RATE = 400


@pytest.fixture(scope="module")
def steady(glider):
    return trim(glider.model(), glider.aircraft, 20.0, altitude=250.0)


class Autopilot:
    """A stand-in for ArduPilot: what it sends, and the lines that it gets."""

    def __init__(self, port):
        self.target = ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(2)
        self.count = 0
        self.read = None

    def send(self, pulses=NEUTRAL, *, count=None, n_pulses=16, rate=RATE):
        """Send pulses and return what comes back."""
        self.count = self.count + 1 if count is None else count
        magic = {16: 18458, 32: 29569}[n_pulses]
        sent = (*pulses, *[0] * n_pulses)[:n_pulses]
        packet = struct.pack(f"<HHI{n_pulses}H", magic, rate, self.count, *sent)
        self.socket.sendto(packet, self.target)
        line = self.socket.recv(4096)
        assert line[:1] == line[-1:] == b"\n"
        assert b" " not in line
        self.read = json.loads(line)
        return self.read


@pytest.fixture
def flown(port, glider, steady):
    """Fly a model behind an autopilot that a function plays; return the result."""

    def flown(play, model=None, full=FULL, aircraft=None, **options):
        ready = threading.Event()
        failures = []

        def run():
            ready.wait(10)
            autopilot = Autopilot(port)
            try:
                play(autopilot)
            except BaseException as failure:
                failures.append(failure)
            finally:
                autopilot.socket.close()

        thread = threading.Thread(target=run)
        thread.start()
        options = {"wait": 0.3, "port": port, "ready": ready.set} | options
        try:
            aircraft = aircraft or glider.aircraft
            return fly(model or glider.model(), aircraft, steady, full, **options)
        finally:
            ready.set()
            thread.join()
            for failure in failures:
                raise failure

    return flown


@pytest.mark.parametrize("n_pulses", [16, 32])
def test_the_lines_have_what_ardupilot_asks_for(flown, n_pulses):
    def play(autopilot):
        said = autopilot.send((0,) * 4, n_pulses=n_pulses)
        assert {"timestamp", "imu", "position", "attitude", "velocity"} <= said.keys()
        assert {*map(len, said["imu"].values())} == {3}
        assert said["timestamp"] == 1 / RATE
        w, x, y, z = said["quaternion"]
        assert_allclose(said["attitude"][1], np.arcsin(2 * (w * y - x * z)), atol=1e-12)

    assert flown(play).steps == 1


def test_tells_that_it_left_what_was_learned(flown, glider):
    """Full up elevator for a second: alpha was learned up to 0.1 rad, into which it swings back, and out again."""
    limits = np.outer([-5.0, 5.0], np.ones(8))
    limits[:, 0] = [-0.1, 0.1]

    def play(autopilot):
        for elevator in (1900, 1500):
            for _ in range(RATE):
                autopilot.send((1500, elevator, 1500, 1500))

    with pytest.warns(SimulationWarning, match="% of the flight is outside of what"):
        result = flown(play, glider.model(limits=limits), wait=1.0)
    outside = ~result.table["alpha"].between(-0.104, 0.104)
    assert 0 < outside.mean() < 1
    # regressors at the beginning of a step count
    assert np.mean((result.table["beyond"] == "alpha") == outside) > 0.97
    assert_allclose(result.outside, outside.mean(), rtol=0, atol=0.03)


def test_in_the_air_without_pulses_it_stays_in_trim(flown, steady):
    def play(autopilot):
        for _ in range(200):
            said = autopilot.send((0,) * 16)
        assert_allclose(said["position"], [20.0 * 0.5, 0.0, -100.0], atol=1e-3)
        assert_allclose(said["attitude"], [0.0, steady.theta, 0.0], atol=1e-4)
        down = [-np.sin(steady.theta), 0.0, np.cos(steady.theta)]
        assert_allclose(said["imu"]["accel_body"], np.multiply(-GRAVITY, down), atol=1e-3)
        # equivalent airspeed, of the density at 250 m above the sea
        assert_allclose(
            said["airspeed"], 20.0 * np.sqrt(standard_density(250.0) / 1.225), rtol=1e-4
        )

    result = flown(play)
    assert "silent for 0.3 s" in result.reason
    assert_allclose(result.table["altitude"], 250.0, atol=1e-3)


@pytest.mark.parametrize("lag", [0.0, 0.08])
def test_flies_as_simulate_does(flown, lag, glider, steady):
    """Half aileron and elevator for 0.5 s, with delay and lag of the servos."""
    model = glider.model(servos=Servos(lag=lag, delay=0.4 * lag))
    pulses = (1700, 1600, 1500, 1500)
    controls = {"aileron": 0.5 * 0.4, "elevator": -0.25 * 0.3, "rudder": 0.0, "thrust": 30.0}

    def play(autopilot):
        for _ in range(200):
            autopilot.send(pulses)

    # servos begin at their first command
    row = flown(play, model=model, seconds=0.5).table.iloc[-1]
    expected = simulate(model, glider.aircraft, steady, controls, dt=1 / RATE, duration=0.5)
    k = int(np.argmin(np.abs(expected["time"] - row["time"])))
    for name in ("p", "q", "r", "phi", "theta", "altitude", "airspeed"):
        assert_allclose(row[name], expected[name].iloc[k], rtol=1e-6, atol=1e-7, err_msg=name)


@pytest.mark.parametrize(
    ("place", "rate", "reverse"), [(0, 0, False), (1, 1, False), (3, 2, False), (0, 0, True)]
)
def test_a_positive_output_turns_up_or_right(flown, place, rate, reverse):
    parameters = {
        "SERVO1_FUNCTION": 4, "SERVO2_FUNCTION": 19, "SERVO3_FUNCTION": 70, "SERVO4_FUNCTION": 21,
        "SERVO1_REVERSED": float(reverse),
    }  # fmt: skip

    def play(autopilot):
        pulses = np.array(NEUTRAL)
        pulses[place] = 1700
        gyro = [autopilot.send(pulses)["imu"]["gyro"][rate] for _ in range(40)]
        assert (gyro[-1] > 0.01) != reverse
        assert (gyro[-1] < -0.01) == reverse

    flown(play, parameters=parameters)


def test_a_flight_is_over_at_the_ground(flown):
    def play(autopilot):
        autopilot.socket.settimeout(0.5)
        with suppress(TimeoutError):
            while True:
                said = autopilot.send((1500, 1350, 1100, 1500), rate=50)
        assert -1.0 < said["position"][2] < 0.0

    assert "at the ground" in flown(play, height=3.0).reason


def test_wind_and_gusts_are_felt(flown):
    airspeeds = []

    def play(autopilot):
        for _ in range(300):
            airspeeds.append(autopilot.send((0,) * 16)["airspeed"])

    turbulence = Turbulence(np.full(3, 1.0), np.full(3, 10.0))
    table = flown(play, wind=[0.0, 5.0, 0.0], gusts=turbulence).table
    assert_allclose(table["east"].iloc[-1], 5.0 * 0.75, atol=0.5)
    assert 0.1 < np.std(airspeeds) < 3.0


def test_a_path_is_one_aircraft_of_the_posterior(flown):
    def play(autopilot):
        for _ in range(100):
            autopilot.send((1700, 1600, 1500, 1500))

    mean, third, again, fourth = (
        flown(play, path=path).table["p"].iloc[-1] for path in (None, 3, 3, 4)
    )
    assert third == again
    assert len({mean, third, fourth}) == 3


def test_ctrl_c_ends_the_flight_and_keeps_its_table(flown, glider):
    pressed = threading.Event()
    linear = glider.model()

    def interrupted(X):
        if pressed.is_set():
            raise KeyboardInterrupt
        return linear(X)

    def play(autopilot):
        for _ in range(20):
            autopilot.send()
        pressed.set()
        autopilot.socket.settimeout(0.2)
        with pytest.raises(TimeoutError):
            autopilot.send()

    result = flown(play, model=Aerodynamics(interrupted, linear.regressors), wait=5.0)
    assert result.reason == "ended by Ctrl-C"
    assert result.steps == 20
    assert result.table["time"].max() > 8 / RATE


class TestRefuses:
    def test_a_port_in_use(self, port, glider, steady):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", port))
            with pytest.raises(ValueError, match=rf"Got the port 127.0.0.1:{port}, but .* another"):
                fly(glider.model(), glider.aircraft, steady, FULL, port=port)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"full": {"aileron": 0.4}}, "Got no value of elevator, rudder, thrust at full output"),
            ({"wind": [1.0, 2.0]}, "but expected 3 finite numbers"),
            ({"parameters": {"SERVO1_MIN": 2000.0}}, "SERVO1_MIN 2000, TRIM 1500"),
        ],
    )
    def test_what_cannot_be(self, options, message, glider, steady):
        with pytest.raises(ValueError, match=message):
            fly(glider.model(), glider.aircraft, steady, **{"full": FULL} | options)

    def test_a_surface_without_effect(self, glider, steady):
        idle = np.where(np.arange(8) == 6, 0.0, glider.slopes)
        with pytest.raises(ValueError, match="whose aileron does not change p"):
            fly(glider.model(idle), glider.aircraft, steady, FULL)


def test_elevons_are_mixed_back(flown):
    """Left = pitch - roll, right = pitch + roll."""
    parameters = {"SERVO1_FUNCTION": 77, "SERVO2_FUNCTION": 78, "SERVO3_FUNCTION": 70}

    def play(autopilot):
        for _ in range(40):
            said = autopilot.send((1600, 1800, 1500))
        p, q, _ = said["imu"]["gyro"]
        assert p > 0.01
        assert q > 0.01

    row = flown(play, parameters=parameters).table.iloc[-1]
    assert_allclose(row["aileron"], 0.4 * 0.25)
    assert_allclose(row["elevator"], -0.3 * 0.5)


def test_a_repeated_packet_is_no_step_and_a_restart_a_new_flight(flown):
    def play(autopilot):
        first = autopilot.send(count=7)
        assert autopilot.send(count=7) == first
        assert autopilot.send(count=8)["timestamp"] == 2 / RATE
        assert autopilot.send(count=0) == first

    result = flown(play)
    assert result.steps == 3
    assert result.table["flight"].tolist() == [0, 1]
    assert result.table["time"].tolist() == [1 / RATE, 1 / RATE]


@pytest.mark.parametrize(
    "garbage", [b"", b"hello", bytes(40), struct.pack("<HHI16H", 29569, 400, 1, *[1500] * 16)]
)
def test_garbage_is_named_and_ignored(flown, garbage):
    def play(autopilot):
        autopilot.socket.sendto(garbage, autopilot.target)
        autopilot.send()

    told = rf"Got {len(garbage)} bytes from 127.0.0.1:\d+ .* but expected 16 or 32"
    with pytest.warns(UserWarning, match=told):
        assert flown(play).steps == 1

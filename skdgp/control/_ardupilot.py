"""A model as the physics of ArduPilot's simulator, by its JSON interface over UDP.

The protocol is that of ArduPilot's ``libraries/SITL/SIM_JSON.cpp`` and its page
``libraries/SITL/examples/JSON/readme.md``.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.messages import warn
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Vector
from skdgp._flight.channels import EARTH_VELOCITY, EULER, SPECIFIC_FORCE
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import SEA_LEVEL_DENSITY, standard_density
from skdgp._flight.servo_functions import NO_PULSE, WEIGHTS, ServoRange
from skdgp._flight.tables import check_full_deflections, check_number
from skdgp.control._margins import effect_of
from skdgp.control._parameters import servo_functions
from skdgp.dynamics import (
    ATTITUDE,
    REASONS,
    Aerodynamics,
    Air,
    Aircraft,
    LinearModel,
    Motion,
    SimulationWarning,
    Simulator,
    Trim,
    Turbulence,
    linearize,
    thrust_control,
)

# Number of pulses of a packet by its first word
PULSES = {18458: 16, 29569: 32}
# Rate that a positive output of a surface raises
RAISED = {"aileron": "p", "elevator": "q", "rudder": "r"}


# Longest step of the integration [s]
LONGEST_STEP = 0.01
# Longest time that a packet asks for [s]: ArduPilot ignores longer ones
LONGEST_FRAME = 0.09
# Time between two rows of the table [s]
ROW_STEP = 0.0199


def read_packet(data: bytes) -> tuple[int, int, list[int]] | None:
    """Return steps a second that ArduPilot asks for, number of the step and pulses [us], None if the bytes are none."""
    for magic, n_pulses in PULSES.items():
        layout = f"<HHI{n_pulses}H"
        if len(data) == struct.calcsize(layout):
            first, rate, number, *pulses = struct.unpack(layout, data)
            if first == magic:
                return rate, number, pulses
    return None


class Servo(NamedTuple):
    """An output of the autopilot: its place among the pulses, and its part of a control at some of them [us]."""

    place: int
    pulses: tuple[float, ...]
    values: Vector

    def __call__(self, pulse: float) -> float:
        """Return the part of the control at a pulse, by straight lines."""
        return float(np.interp(pulse, self.pulses, self.values))


def servos_of(
    gains: Mapping[str, float], parameters: Mapping[str, float]
) -> dict[str, list[Servo]]:
    """Return the servos of controls by ArduPilot's ``SERVOn_*``, by default aileron, elevator, throttle, rudder.

    The ``gains`` are the controls at an output of 1, which rolls right, pitches up or yaws right. Raises
    ValueError if the pulses of a servo do not increase.
    """
    functions = servo_functions(parameters)
    servos: dict[str, list[Servo]] = {}
    for control, gain in gains.items():
        is_surface = control in RAISED
        servos[control] = []
        for function, weight in WEIGHTS[control if is_surface else "throttle"].items():
            numbers = [n for n in functions if functions[n] == function]
            for n in numbers:
                at_1 = gain * weight / len(numbers)
                servos[control].append(_servo(parameters, n, at_1, is_surface))
    return servos


def _servo(parameters: Mapping[str, float], n: int, at_1: float, is_surface: bool) -> Servo:
    """Return servo n with its part of a control at an output of 1; those of a surface begin at -1."""
    low, middle, high, is_reversed = ServoRange.of(parameters, n)
    if not low <= middle <= high or low == high:
        raise ValueError(
            f"Got SERVO{n}_MIN {low:g}, TRIM {middle:g} and MAX {high:g}, but expected pulses that increase."
        )
    used = (low, middle, high) if is_surface else (low, high)
    values = at_1 * np.linspace(-1.0 if is_surface else 0.0, 1.0, len(used))
    return Servo(n - 1, used, values[::-1] if is_reversed else values)


def commands_of(pulses: Sequence[int], servos: Mapping[str, list[Servo]]) -> dict[str, float]:
    """Return the commanded controls by name, without those whose servos get no pulse."""
    sent = dict(enumerate(pulses))
    commands = {}
    for name, of_control in servos.items():
        of_servos = [sent.get(servo.place, 0) for servo in of_control]
        if min(of_servos, default=0) > NO_PULSE:
            commands[name] = sum(
                servo(pulse) for servo, pulse in zip(of_control, of_servos, strict=True)
            )
    return commands


def full_outputs(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    full: Mapping[str, float],
    thrust: str | None = "auto",
) -> dict[str, float]:
    """Return the values at full output of the controls that an autopilot moves, by default of the aircraft and 1.

    Raises ValueError if a value is missing, of another control, or no number > 0.
    """
    engine = thrust_control(aircraft, thrust)
    controls = {*Motion(model, aircraft, thrust=thrust).controls, engine}
    moved = (*RAISED, engine or "throttle")
    known = [name for name in moved if name in controls]
    defaults = {"throttle": 1.0} if engine in (None, "throttle") else {}
    given = check_full_deflections(full, [*known, "throttle"])
    full = {**defaults, **(aircraft.full_deflections or {}), **given}
    lacking = [name for name in known if name not in full]
    if lacking:
        raise ValueError(
            f"Got no value of {', '.join(lacking)} at full output: give deflections [rad] of surfaces, "
            f"thrust [N] or propeller_speed [rad/s] (--full {lacking[0]}=...)."
        )
    return {name: full[name] for name in known}


def _effect(linear: LinearModel, control: str) -> float:
    """Return the sign of the effect of a surface on its rate, 1 of others; raise ValueError if it has none."""
    if control not in RAISED:
        return 1.0
    effect = effect_of(linear, control, RAISED[control])
    if effect == 0.0:
        raise ValueError(
            f"Got a model whose {control} does not change {RAISED[control]}, but expected that it does: "
            "the autopilot could not fly it."
        )
    return float(np.sign(effect))


def bind(link: socket.socket, address: str, port: int) -> None:
    """Bind a socket to the port at which ArduPilot's simulator is expected; raise ValueError if it cannot be used."""
    try:
        link.bind((address, port))
    except (OSError, OverflowError) as error:
        raise ValueError(
            f"Got the port {address}:{port}, but it cannot be used ({error}): end the program that has it, or name "
            "another port."
        ) from error


def receive(link: socket.socket, wait: float) -> tuple[Any, Any] | None:
    """Return the next packet and its sender, or None if none comes within ``wait`` [s]; warn of other bytes."""
    end = time.monotonic() + wait
    while (left := end - time.monotonic()) > 0:
        link.settimeout(left)
        try:
            data, sender = link.recvfrom(2048)
        except TimeoutError:
            return None
        except ConnectionError:  # of an earlier answer, in Windows
            continue
        packet = read_packet(data)
        if packet is not None:
            return packet, sender
        warn(
            f"Got {len(data)} bytes from {sender[0]}:{sender[1]} that are no packet of ArduPilot's JSON interface, but "
            "expected 16 or 32 pulses behind the number 18458 or 29569: they are ignored."
        )
    return None


class Flown(NamedTuple):
    """A flight behind an autopilot."""

    #: A flight table with at most 50 rows a second; each start of the autopilot is a ``flight``, from 0
    #: on. ``beyond`` is the regressor farthest outside its training range, or ""
    table: pd.DataFrame
    steps: int  #: Packets that were answered by a step
    computing: float  #: Time that the steps took [s]
    reason: str  #: Why the flight is over

    @property
    def outside(self) -> float:
        """Fraction of the flight outside of what the model was learned from."""
        return float((self.table["beyond"] != "").mean()) if len(self.table) else 0.0


def fly(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    steady: Trim,
    full: Mapping[str, float],
    *,
    parameters: Mapping[str, float] | None = None,
    height: float = 100.0,
    path: int | None = None,
    wind: Any = None,
    gusts: Turbulence | None = None,
    thrust: str | None = "auto",
    address: str = "127.0.0.1",
    port: int = 9002,
    wait: float = 60.0,
    seconds: float = np.inf,
    ready: Callable[[], None] | None = None,
) -> Flown:
    """Fly a model in ArduPilot's simulator: answer each packet of pulses with a step of the nonlinear motion.

    ArduPilot is started with ``sim_vehicle.py -v ArduPlane --model JSON:127.0.0.1``; its protocol is
    that of ``SIM_JSON.cpp``. The aircraft has the servos of its model. A restart of the autopilot starts
    another flight. Silence for ``wait``, ``seconds`` or Ctrl-C end it.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    steady : Trim
        Its altitude [m] is that of the start.
    full : mapping of str to float
        Values with the servos at their ends: deflections [rad] of aileron, elevator and rudder, in the unit of the
        control, by default those of the aircraft; ``thrust`` [N] or ``propeller_speed`` [rad/s] where that sets the
        thrust. Pulses of elevons and
        V-tails contain ArduPilot's MIXING_GAIN.
    parameters : mapping of str to float, optional
        ``SERVOn_FUNCTION``, ``_MIN``, ``_TRIM``, ``_MAX``, ``_REVERSED`` of the autopilot, see
        `read_parameters`. By default servos 1 to 4 are aileron, elevator, throttle and rudder, 1100
        to 1900 us.
    height : float, default=100.0
        Of the start above the ground [m]. The flight begins at the trim and is over at the ground: an
        aircraft that takes off and lands is that of :func:`skdgp.export.write_jsbsim`.
    path : int, optional
        Seed of one aircraft of the posterior, and of the gusts; by default the mean flies.
    wind : array-like (3,), optional
        Velocity of the air, north, east, down [m/s].
    gusts : Turbulence, optional
        Dryden's gusts besides the wind.
    thrust : "auto" or None
        As for :func:`skdgp.dynamics.simulate`.
    address, port : str and int
        Of this program.
    wait : float, default=60.0
        Longest silence of the autopilot [s].
    seconds : float, optional
        Duration of the last flight; by default until the autopilot is silent.
    ready : callable, optional
        Called once packets are expected.

    Returns
    -------
    Flown

    Raises
    ------
    ValueError
        If the port is in use, no packet comes, a control has no value at full output, a wind is
        invalid, or the model has no posterior for a ``path``.

    Warns
    -----
    UserWarning
        If other bytes come, which are ignored.
    SimulationWarning
        If the flight left the training range of a regressor.
    """
    check_number("height", height, unit="m")
    check_number("wait", wait, unit="s")
    linear = linearize(model, aircraft, steady, thrust=thrust)
    full = full_outputs(model, aircraft, full, thrust)
    gains = {name: _effect(linear, name) * value for name, value in full.items()}
    servos = servos_of(gains, parameters or {})
    air = Air(wind=wind, gusts=gusts)
    simulator = Simulator(model, aircraft, LONGEST_STEP, air=air, thrust=thrust)
    flights = _Flights(simulator, servos, steady, steady.altitude - height, path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, one_blas_thread():
        bind(link, address, port)
        if ready is not None:
            ready()
        try:
            reason = flights.serve(link, wait, seconds)
        except KeyboardInterrupt:
            if not flights.n_steps:
                raise
            reason = "ended by Ctrl-C"
        if not flights.n_starts:
            raise ValueError(
                f"Got no packet at {address}:{port} for {wait:g} s, but expected ArduPilot: start "
                "sim_vehicle.py -v ArduPlane --model JSON:127.0.0.1."
            )
    flown = Flown(pd.DataFrame(flights.rows), flights.n_steps, flights.computing, reason)
    if flown.outside:
        warn(
            f"{flown.outside:.1%} of the flight is outside of what the model was learned from: the column beyond says "
            "where. A stall that was not flown is not in the model.",
            SimulationWarning,
        )
    return flown


class _Flights:
    """Flights of a model from a trim to the ground, an altitude [m]; each start of the autopilot begins another."""

    def __init__(
        self,
        simulator: Simulator,
        servos: Mapping[str, list[Servo]],
        steady: Trim,
        ground: float,
        path: int | None,
    ) -> None:
        self.simulator = simulator
        self.servos = servos
        self.steady = steady
        self.ground = ground
        self.path = path
        self.rows: list[dict[str, Any]] = []
        self.n_starts = 0
        self.n_steps = 0
        self.computing = 0.0
        self._start()

    def _start(self) -> None:
        """Put the aircraft at its trim, heading north."""
        self.channels = self.simulator.reset(self.steady, random_state=self.path)
        self._row_time = -np.inf  # of the last row of this flight [s]

    def serve(self, link: socket.socket, wait: float, seconds: float) -> str:
        """Answer packets; return why the flight is over."""
        last = sys.maxsize  # number of the last packet
        line = ""
        while self.simulator.time < seconds:
            received = receive(link, wait)
            if received is None:
                return f"the autopilot is silent for {wait:g} s"
            (rate, number, pulses), sender = received
            # ArduPilot repeats a packet whose answer it did not get
            if number != last:
                if number < last:
                    self._start()
                    self.n_starts += 1
                last = number
                began = time.perf_counter()
                commands = self.steady.controls | commands_of(pulses, self.servos)
                duration = min(1.0 / max(rate, 1), LONGEST_FRAME)
                if reason := self._advance(commands, duration):
                    return f"the flight ended after {self.simulator.time:.1f} s: {reason}"
                line = self._readings()
                self.computing += time.perf_counter() - began
                self.n_steps += 1
            with suppress(OSError):  # one that is gone is noticed by its silence
                link.sendto(line.encode(), sender)
        return f"{seconds:g} s were flown"

    def _advance(self, commands: dict[str, float], duration: float) -> str:
        """Fly for a ``duration`` [s] with constant commands; return why the flight is over, "" while it is not."""
        self.channels = self.simulator.step(commands, duration)
        altitude = self.channels["altitude"]  # NaN if the flight has ended
        if altitude <= self.ground:
            return "at the ground"
        if self.simulator.ended:
            return REASONS[self.simulator.ended]
        self.channels["density"] = float(standard_density(altitude))
        now = self.simulator.time
        if now - self._row_time > ROW_STEP:
            self._row_time = now
            name = {"flight": self.n_starts - 1}
            self.rows.append(name | self.channels | commands | {"beyond": self.simulator.beyond})
        return ""

    def _readings(self) -> str:
        """Return the line of JSON that ArduPilot reads; it knows no space behind a colon."""
        values = self.channels
        position = [values["north"], values["east"], values["down"] + self.ground]
        # SITL's airspeed is the equivalent one
        equivalent = values["airspeed"] * math.sqrt(values["density"] / SEA_LEVEL_DENSITY)
        facts = {
            "timestamp": self.simulator.time,
            "imu": {
                "gyro": [values[name] for name in RATE_NAMES],
                "accel_body": [values[name] for name in SPECIFIC_FORCE],
            },
            "position": position,
            "attitude": [values[name] for name in EULER],
            "quaternion": self.simulator.state[ATTITUDE].tolist(),
            "velocity": [values[name] for name in EARTH_VELOCITY],
            "airspeed": equivalent,
        }
        return "\n" + json.dumps(facts, separators=(",", ":"), allow_nan=False) + "\n"

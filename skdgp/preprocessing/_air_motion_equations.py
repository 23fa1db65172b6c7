"""The filter's linearisation of a record: states are gusts, errors of the path and rates."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.frames import STANDARD_GRAVITY, cross_matrix
from skdgp.dynamics import Aircraft
from skdgp.preprocessing._air_motion_filter import Linearisation, Noise
from skdgp.preprocessing._air_motion_model import (
    AIR,
    ERRORS,
    OWN,
    RATES,
    SHARED,
    STATE_TERMS,
    AirMotionModel,
    Inputs,
    differentiated,
)

GUST, FAST, TURN = slice(0, 3), slice(3, 6), slice(8, 11)
"""Places of the states: two parts of the gust, north, east, down; what errors of the path and of
attitude add to the air velocity, body axes y and z [m/s]; rates [rad/s].
"""
N_STATES = 11
PATH_TIME = 10.0  # s, correlation of errors of the path; guess
RATE_START = 0.1  # (rad/s)^2, variance of the rates of the first sample
NOT_SAMPLED = 1e12
LEAST_LAG, LAG_STEP = 1e-4, 1e-4  # s
RESPONSE_TIME = 4.0  # s, memory of the motion that surfaces cause
ANSWER_TIME = 8.0  # s, memory of the surfaces' answers to gusts
N_BINS = 16  # of this time
TINY = 1e-300
LATE = 1  # samples; a command follows the noise of the same sample
WINDS = ("wind_north", "wind_east", "wind_down")
ARM = ("arm_x", "arm_y", "arm_z")
BIASES = {"p_bias": 3, "q_bias": 4, "r_bias": 5, "alpha_bias": 7, "beta_bias": 8}
"""Places of the biased among the sensors."""
AIRSPEED = 6


class Record(NamedTuple):
    """n samples of a flight without a gap, and its path over the ground."""

    flight: int
    rows: Indices  # (n,) of the table
    step: Vector  # (n - 1,) [s]
    velocity: Matrix  # (n, 3) over the ground, body axes [m/s]
    attitude: Array  # (n, 3, 3) NED to body
    measured: Matrix  # (n, 9) ax, ay, az, p, q, r, airspeed, alpha, beta; NaN where not sampled
    inputs: Inputs  # as logged
    answers: Matrix | None = None  # (n, k) part of the surfaces by which an autopilot answers gusts

    def first(self, n: int) -> Record:
        """Return the first n samples."""
        parts = self.velocity[:n], self.attitude[:n], self.measured[:n]
        inputs = self.inputs.part(slice(n))
        return Record(self.flight, self.rows[:n], self.step[: n - 1], *parts, inputs)

    def with_axial_force(self, mass: float) -> Record:
        """Return the record with the measured axial force in place of thrust and CX."""
        measured, thrust = self.measured.copy(), self.inputs.thrust.copy()
        thrust[:, 0] = mass * measured[:, 0]
        measured[:, 0] = np.nan
        return self._replace(measured=measured, inputs=self.inputs._replace(thrust=thrust))

    def with_answers(self, innovation: Matrix) -> Record:
        """Return the record with the part of its surfaces that innovations (n - 1, m) up to each sample explain.

        By least squares on sums of the innovations over bins of the past, wider the earlier. What else
        moves a surface is a first-order process of the surface's own correlation (Cochrane & Orcutt
        1949): inputs hold their values for a while.
        """
        n, m = len(self.rows), innovation.shape[1]
        reach = max(ANSWER_TIME / np.median(self.step), 2.0)
        edges = np.append(0, np.unique(np.geomspace(1, reach, N_BINS).round().astype(int)))
        before = np.zeros((edges[-1] + 2, m))
        total = np.cumsum(np.concatenate([before, innovation]), axis=0)
        at = np.arange(n) + edges[-1] + 1
        sums = [total[at - early] - total[at - late] for early, late in pairwise(edges)]
        columns, surfaces = np.concatenate(sums, axis=1), self.inputs.surfaces
        answers = np.empty_like(surfaces)
        for k, surface in enumerate((surfaces - surfaces.mean(axis=0)).T):
            rest = surface - columns @ np.linalg.lstsq(columns, surface, rcond=None)[0]
            rho = (rest[1:] @ rest[:-1]) / max(rest @ rest, TINY)
            X, y = columns[1:] - rho * columns[:-1], surface[1:] - rho * surface[:-1]
            answers[:, k] = columns @ np.linalg.lstsq(X, y, rcond=None)[0]
        return self._replace(answers=answers)

    def earth_velocity(self) -> Matrix:
        """Return the velocity over the ground north, east, down (n, 3)."""
        return (np.swapaxes(self.attitude, 1, 2) @ self.velocity[..., None])[..., 0]

    @property
    def sampled(self) -> Mask:
        """Whether a sensor has any sample, (9,)."""
        return np.any(np.isfinite(self.measured[1:]), axis=0)


class Layout(NamedTuple):
    """Places of the derivatives in the matrix (6, k) of the model, and among the parameters."""

    rows: Indices
    columns: Indices
    names: list[str]
    n_features: int

    @property
    def n_slopes(self) -> int:
        """Number of parameters, and of instruments of the derivatives, which follow them."""
        return len(self.names) + len(self.rows)

    @classmethod
    def of(cls, derivatives: list[str], surfaces: list[str]) -> Layout:
        """Return the layout of derivatives by name, such as CZ_alpha, which come first of a flight's parameters."""
        features = [*STATE_TERMS, *surfaces]
        parts = [name.split("_", 1) for name in derivatives]
        rows = np.array([COEFFICIENTS.index(row) for row, _ in parts])
        columns = np.array([features.index(term) for _, term in parts])
        return cls(rows, columns, [*derivatives, *SHARED, *OWN], len(features))

    def place(self, *names: str) -> list[int]:
        """Return places among the parameters of a flight."""
        return [self.names.index(name) for name in names]

    def model(self, aircraft: Aircraft, value: dict) -> AirMotionModel:
        """Return the aircraft's equations of motion at parameters by name."""
        derivatives = np.zeros((6, self.n_features))
        names = self.names[: len(self.rows)]
        derivatives[self.rows, self.columns] = [value[name] for name in names]
        return AirMotionModel(aircraft, derivatives, np.array([value[name] for name in ARM]))


def lagged(surfaces: Matrix, lag: float, step: float) -> Matrix:
    """Return the outputs (n, k) of servos with a first-order lag [s], exact for inputs linear between samples."""
    r = max(lag, LEAST_LAG) / step
    a = np.exp(-1 / r)
    numerator, denominator = [1 - (1 - a) * r, (1 - a) * r - a], [1, -a]
    return lfilter(numerator, denominator, surfaces - surfaces[0], axis=0) + surfaces[0]


def actual_inputs(record: Record, value: dict) -> tuple[Inputs, Matrix]:
    """Return the inputs with lag and scale of the thrust, and d surfaces / d lag."""
    step, raw = float(np.median(record.step)), record.inputs
    lag = max(value["servo_lag"], LEAST_LAG)
    here, more = (lagged(raw.surfaces, each, step) for each in (lag, lag + LAG_STEP))
    inputs = Inputs(here, raw.thrust * (1 + value["thrust_scale"]), raw.density)
    return inputs, (more - here) / LAG_STEP


def noise(value: dict, sampled: Mask) -> Noise:
    """Return the noises at parameters by name, each (...), of the sensors that are ``sampled`` (9,)."""
    one = np.ones_like(value["ax"])
    gust = [value["gust_north"], value["gust_east"], value["gust_down"]]
    time = [value["time_h"], value["time_h"], value["time_v"]]
    fast = [value["fast_h"], value["fast_h"], value["fast_v"]]
    faster = [value["faster_h"], value["faster_h"], value["faster_v"]]
    both = [*gust, *(a * b for a, b in zip(gust, fast, strict=True))]
    sd = np.stack([*both, value["path_y"], value["path_z"]], axis=-1)
    both = [*time, *(a * b for a, b in zip(time, faster, strict=True))]
    times = np.stack([*both, PATH_TIME * one, PATH_TIME * one], axis=-1)
    drive = np.stack([value["drive_p"], value["drive_q"], value["drive_r"]], axis=-1)
    forces = [value["ax"], value["ay"], value["az"]]
    sensors = [*forces, *[value["gyro"]] * 3, value["airspeed"], *[value["vane"]] * 2]
    return Noise(
        rate=np.concatenate([2 * sd**2 / times, drive**2], axis=-1),
        decay=np.concatenate([1 / times, np.zeros_like(drive)], axis=-1),
        surface=value["surface"] ** 2,
        sensor=np.stack(sensors, axis=-1)[..., sampled] ** 2,
        start=np.concatenate([sd**2, np.full_like(drive, RATE_START)], axis=-1),
    )


class Point(NamedTuple):
    """Values of a function (n, k) at states (n, 12) of the model, and what its derivatives need."""

    state: Matrix
    values: Matrix
    slopes: Array  # (n, k, 12)
    terms: Matrix  # (n, f) of the coefficients
    response: Matrix  # (n, f) their values in the motion that surfaces cause
    changes: Array  # (n, 6, 2) d coefficients / d (lag, thrust_scale)

    def by_parameters(self, layout: Layout, attitude: Array | None) -> Array:
        """Return derivatives (n, k, parameters) and instruments.

        Those by wind and arm are given where the air velocity contains them, that is with ``attitude``.
        """
        out = np.zeros((*self.slopes.shape[:2], layout.n_slopes))
        by_error = self.slopes[:, :, ERRORS]
        nd = len(layout.rows)
        out[:, :, :nd] = by_error[:, :, layout.rows] * self.terms[:, None, layout.columns]
        out[:, :, -nd:] = by_error[:, :, layout.rows] * self.response[:, None, layout.columns]
        out[:, :, layout.place("servo_lag", "thrust_scale")] = by_error @ self.changes
        if attitude is not None:
            by_air = self.slopes[:, :, AIR]
            out[:, :, layout.place(*WINDS)] = -by_air @ attitude
            out[:, :, layout.place(*ARM)] = -by_air @ cross_matrix(self.state[:, RATES])
        return out


def _predictions(
    record: Record,
    model: AirMotionModel,
    value: dict,
    inputs: Inputs,
    by_lag: Matrix,
    states: Matrix,
    decay: Vector,
) -> tuple[Array, Point, Point, Point, Matrix]:
    """Return predictions of each sample but the first from filtered states (n, N), as of `linearised`.

    They are d air velocity / d states (n, 3, N), what is at the end of a step about its start, the
    sensors from the past alone and with the recorded path, and the states (n - 1, N).
    """
    later, step = inputs.part(slice(1, None)), record.step
    air, by_state = air_velocity(record, value, states)
    changes = _changes(model, record, by_lag, air)
    # what sensors with scale and biases read
    scale, offset = np.ones(9), np.zeros(9)
    scale[AIRSPEED] += value["airspeed_scale"]
    offset[[*BIASES.values()]] = [value[name] for name in BIASES]

    def point(air: Matrix, rates: Matrix) -> Point:
        state = np.concatenate([air, rates, np.zeros((len(air), 6))], axis=1)
        values, slopes = differentiated(lambda s: model.sensors(s, later), state)
        terms = model.terms(air, rates, later.surfaces)
        read = scale * values + offset, scale[:, None] * slopes
        return Point(state, *read, terms, response[1:], changes[1:])

    # The step from the filtered state to the next sample.
    rates = states[:-1, TURN]
    state = np.concatenate([air[:-1], rates, np.zeros((len(step), 6))], axis=1)
    gravity = STANDARD_GRAVITY * record.attitude[:-1, :, 2]
    drift = -(by_state[:-1] * decay @ states[:-1, :, None])[..., 0]
    end, slopes = differentiated(lambda s: model.step(s, gravity, drift, inputs, step), state)
    surfaces = inputs.surfaces
    if record.answers is not None:
        surfaces = surfaces - lagged(record.answers, value["servo_lag"], float(np.median(step)))
    response = _response(model, state, slopes, surfaces, step)
    past = point(end[:, AIR], end[:, RATES])
    terms = model.terms(air[:-1], rates, inputs.surfaces[:-1])
    middle = 0.5 * (past.terms + terms), 0.5 * (response[1:] + response[:-1])
    start = Point(state, end, slopes, *middle, 0.5 * (changes[1:] + changes[:-1]))

    predicted = states[:-1] * np.exp(-step[:, None] * decay)
    predicted[:, TURN] = end[:, RATES]
    change = predicted - states[1:]
    known = point(air[1:] + (by_state[1:] @ change[..., None])[..., 0], end[:, RATES])
    return by_state, start, past, known, predicted


def _response(
    model: AirMotionModel, state: Matrix, slopes: Array, surfaces: Matrix, step: Vector
) -> Matrix:
    """Return the terms (n, f) of the coefficients in the motion that surfaces cause about the mean one.

    It contains no gusts. ``slopes`` (n - 1, 6, 12) are the derivatives of a step from ``state``. The
    motion is damped to a memory of `RESPONSE_TIME`, as that of an unstable aircraft would grow.
    """
    late = np.concatenate([surfaces[:1]] * LATE + [surfaces[: len(surfaces) - LATE]])
    change = late - late.mean(axis=0)
    A = slopes[:, :, :6]
    B = slopes[:, :, ERRORS] @ model.derivatives[:, len(STATE_TERMS) :]
    push = (B @ (0.5 * (change[1:] + change[:-1]))[..., None])[..., 0]
    growth = np.abs(np.linalg.eigvals(A.mean(axis=0))).max()
    A = A * np.exp(-np.median(step) / RESPONSE_TIME) / max(growth, 1.0)
    motion = np.zeros((len(surfaces), 6))
    for k in range(len(A)):
        motion[k + 1] = A[k] @ motion[k] + push[k]
    return model.terms(state[:, AIR].mean(axis=0) + motion[:, AIR], motion[:, RATES], late)


def linearised(
    record: Record, layout: Layout, aircraft: Aircraft, value: dict, states: Matrix, decay: Vector
) -> Linearisation:
    """Return the linear filter about filtered states (n, N) and parameters by name.

    ``decay`` (N,) are 1 / correlation time of the states, zero for the rates.
    """
    model = layout.model(aircraft, value)
    inputs, by_lag = actual_inputs(record, value)
    by_state, start, past, known, predicted = _predictions(
        record, model, value, inputs, by_lag, states, decay
    )
    later, step = inputs.part(slice(1, None)), record.step[:, None]
    moved = _chained(start.slopes, by_state[:-1])
    moved[:, AIR] -= step[..., None] * by_state[:-1] * decay
    transition = np.exp(-step * decay)[:, :, None] * np.eye(N_STATES)
    transition[:, TURN] = moved[:, RATES]

    by_parameters = start.by_parameters(layout, record.attitude[:-1])
    transition_slopes = np.zeros((len(moved), N_STATES, layout.n_slopes))
    transition_slopes[:, TURN] = by_parameters[:, RATES]
    past_slopes = past.by_parameters(layout, None) + past.slopes[:, :, :6] @ by_parameters
    past_slopes += _direct(past, layout, model, later, value)
    known_slopes = known.by_parameters(layout, record.attitude[1:])
    known_slopes += _direct(known, layout, model, later, value)

    measured, use = record.measured[1:], record.sampled
    there = np.isfinite(measured)
    return Linearisation(
        states=states,
        predicted=predicted,
        transition=transition,
        transition_slopes=transition_slopes,
        innovation=np.where(there, measured - past.values, 0.0)[:, use],
        innovation_states=(past.slopes[:, :, :6] @ moved)[:, use],
        innovation_noise=_chained(past.slopes, by_state[1:])[:, use],
        innovation_slopes=past_slopes[:, use],
        residual=np.where(there, measured - known.values, 0.0)[:, use],
        residual_states=_chained(known.slopes, by_state[1:])[:, use],
        residual_slopes=known_slopes[:, use],
        step=record.step,
        surface_noise=_surface_noise(start.slopes, model, inputs),
        response=start.response,
        weight=np.where(there, 1.0, NOT_SAMPLED)[:, use],
    )


def _surface_noise(slopes: Array, model: AirMotionModel, inputs: Inputs) -> Array:
    """Return the covariance (n, N, N) by surfaces that are off by their change in the step."""
    jump = np.diff(inputs.surfaces, axis=0)
    push = slopes[:, RATES, ERRORS] @ model.derivatives[:, len(STATE_TERMS) :] * jump[:, None]
    covariance = np.zeros((len(jump), N_STATES, N_STATES))
    covariance[:, TURN, TURN] = push @ np.swapaxes(push, 1, 2)
    return covariance


def air_velocity(record: Record, value: dict, states: Matrix) -> tuple[Matrix, Array]:
    """Return the velocity relative to the air (n, 3), body axes, and its derivatives by the states (n, 3, N)."""
    by_state = np.zeros((len(states), 3, N_STATES))
    by_state[:, :, GUST] = by_state[:, :, FAST] = -record.attitude
    by_state[:, 1, 6] = by_state[:, 2, 7] = -1.0
    by_state[:, :, TURN] = cross_matrix([value[name] for name in ARM])
    ground = record.velocity - record.attitude @ [value[name] for name in WINDS]
    return ground + (by_state @ states[:, :, None])[..., 0], by_state


def _chained(slopes: Array, air_by_state: Array) -> Array:
    """Return derivatives (n, k, N) by the filter's states, from those by the model's (n, k, 12)."""
    by_states = slopes[:, :, AIR] @ air_by_state
    by_states[:, :, TURN] += slopes[:, :, RATES]
    return by_states


def _changes(model: AirMotionModel, record: Record, by_lag: Matrix, air: Matrix) -> Array:
    """Return d coefficients / d (lag, thrust_scale), (n, 6, 2)."""
    aircraft, thrust = model.aircraft, record.inputs.thrust
    pressure = 0.5 * record.inputs.density * np.sum(air**2, axis=1)
    lengths = np.append(np.ones(3), aircraft.moment_lengths)
    by_thrust = thrust / lengths / (pressure * aircraft.wing_area)[:, None]
    return np.stack([by_lag @ model.derivatives[:, len(STATE_TERMS) :].T, by_thrust], axis=-1)


def _direct(
    point: Point, layout: Layout, model: AirMotionModel, inputs: Inputs, value: dict
) -> Array:
    """Return derivatives of the sensors by their own errors (n, 9, parameters and instruments)."""
    slopes = np.zeros((len(point.values), 9, layout.n_slopes))
    slopes[:, [*BIASES.values()], layout.place(*BIASES)] = 1.0
    (scale,) = layout.place("airspeed_scale")
    slopes[:, AIRSPEED, scale] = point.values[:, AIRSPEED] / (1 + value["airspeed_scale"])
    slopes[:, :3, layout.place(*ARM)] = model.arm_slopes(point.state, inputs)
    return slopes

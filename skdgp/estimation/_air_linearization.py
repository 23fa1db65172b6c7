r"""Linearization of a record of the filter-error method, at filtered states and parameters.

States (9): gusts north, east, down g [m/s]; errors of path and attitude e that add to the air
velocity, body axes y and z [m/s]; rate of roll of the air :math:`p_g` and rates of the aircraft
:math:`\omega` [rad/s]. Coefficients feel :math:`p - p_g`, no sensor does. With the velocity v of the
centre of gravity over the ground (body axes) as recorded, attitude R (NED to body), steady wind w and
error r of the position of the sensors,

.. math:: v_a = v - R (w + g) - e - \omega \times r,

which `air_velocity` evaluates. The rates follow by one Runge-Kutta step of the equations of motion
(``_air_model.py``), the other states decay. Measurements are the nine sensors at the end of the step, from
the past alone (innovation), and with the recorded path (residual).

Variables of the model are the motion M, which is air velocity and rates, errors of the coefficients C and :math:`p_g`.
A coefficient is the sum of its derivatives times terms, such as alpha. By the chain rule a value h(M, C) has the
slopes by states and derivatives

.. math:: \frac{d h}{d z} = \frac{\partial h}{\partial M} \frac{d M}{d z} +
          \frac{\partial h}{\partial C} \frac{d C}{d z}, \quad
          \frac{d C_i}{d C_{ij}} = \mathrm{term}_j.

Slopes by constants are differences of the predictions. Instruments are the slopes by derivatives with
the terms in the motion that surfaces alone cause.

n samples, m sensors, N states, k parameters of a flight, of which the first d are derivatives of the
coefficients and c are constants, f terms. Slopes by z are by the N states of a sample, the k parameters, and the d
instruments, the last two q together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.linalg import matrix_vector
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.frames import STANDARD_GRAVITY, air_data, cross, cross_matrix
from skdgp.dynamics import Aircraft
from skdgp.estimation._air_model import (
    AIR_ROLL,
    AIR_VELOCITY,
    BODY_RATES,
    COEFFICIENT_ERRORS,
    MOTION,
    N_VARIABLES,
    AirMotionModel,
    Inputs,
    Slipstream,
    differentiated,
    relative_rates,
    sensors,
)
from skdgp.estimation._air_parameters import (
    AIRCRAFT_CONSTANTS,
    ARM,
    FLIGHT_CONSTANTS,
    STATE_TERMS,
    TAIL,
    WINDS,
    stacked,
)
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import Linearization, Slopes, propagated
from skdgp.estimation._sensors import BIASED, INERTIAL_READINGS, SENSORS, SensorErrors
from skdgp.estimation._servos import servo_output

N_STATES = 9
GUST = slice(0, 3)
PATH_ERROR_Y = 3
PATH_ERROR_Z = 4
AIR_ROLL_STATE = 5
RATE_STATES = slice(6, 9)
"""Places of the states: the gust, errors of the path, rate of roll of the air, rates of the aircraft."""
CONSTANTS = (*AIRCRAFT_CONSTANTS, *FLIGHT_CONSTANTS)
"""Parameters of a flight behind the derivatives."""
SENSOR_ERRORS = {"airspeed_scale", *BIASED}
"""Constants of the readings alone, which no motion depends on."""
CONSTANT_STEP = 1e-5
"""Step of constants in slopes, in their own units."""


class Layout(NamedTuple):
    """The aircraft, and places of its derivatives in the matrix (6, k) of the model, and among the parameters."""

    aircraft: Aircraft
    mean_thrust: float  # of the flights, over dynamic pressure and wing area
    rows: Indices  # (d,) coefficient of each derivative
    columns: Indices  # (d,) its term
    names: list[str]  # of the k parameters of a flight
    surfaces: list[str]

    @classmethod
    def of(
        cls, aircraft: Aircraft, mean_thrust: float, derivatives: list[str], surfaces: list[str]
    ) -> Layout:
        """Return the layout of derivatives by name, such as CZ_alpha, which come first of a flight's parameters."""
        terms = [*STATE_TERMS, *surfaces]
        pairs = [name.split("_", 1) for name in derivatives]
        rows = np.array([COEFFICIENTS.index(coefficient) for coefficient, _ in pairs])
        columns = np.array([terms.index(term) for _, term in pairs])
        names = [*derivatives, *CONSTANTS]
        return cls(aircraft, mean_thrust, rows, columns, names, surfaces)

    def model(self, value: Mapping[str, Any]) -> AirMotionModel:
        """Return the equations of motion at parameters by name."""
        derivatives = np.zeros((6, len(STATE_TERMS) + len(self.surfaces)))
        names = self.names[: self.n_derivatives]
        derivatives[self.rows, self.columns] = [value[name] for name in names]
        reached = np.isin(self.surfaces, TAIL).astype(float)
        slipstream = Slipstream(value["slipstream"], self.mean_thrust, reached)
        return AirMotionModel(self.aircraft, derivatives, slipstream)

    @property
    def n_derivatives(self) -> int:
        """Number of derivatives."""
        return len(self.rows)

    def is_by(self, *terms: str) -> Mask:
        """Return whether each derivative is by one of the state's terms."""
        return np.isin(self.columns, [STATE_TERMS.index(name) for name in terms])

    def by_terms(self, by_coefficients: Array, terms: Matrix) -> Array:
        """Return d h / d derivatives and instruments (n, m, 2 d), from d h / d coefficients (n, m, 6).

        ``terms`` (n, 2 f) are of the derivatives and, behind these, of the instruments.
        """
        columns = np.concatenate([self.columns, self.columns + terms.shape[1] // 2])
        return by_coefficients[:, :, np.tile(self.rows, 2)] * terms[:, None, columns]


def air_velocity(record: Record, value: Mapping[str, Any], states: Matrix) -> Matrix:
    """Return the velocity relative to the air (n, 3), body axes."""
    wind = stacked(value, *WINDS) + states[:, GUST]
    air = record.velocity - matrix_vector(record.attitude, wind)
    air[:, 1] -= states[:, PATH_ERROR_Y]
    air[:, 2] -= states[:, PATH_ERROR_Z]
    return air - cross(states[:, RATE_STATES], stacked(value, *ARM))


def air_velocity_slopes(record: Record, value: Mapping[str, Any]) -> Array:
    """Return the slopes of the velocity relative to the air by the states (n, 3, N)."""
    by_state = np.zeros((len(record.rows), 3, N_STATES))
    by_state[:, :, GUST] = -record.attitude
    by_state[:, 1, PATH_ERROR_Y] = -1.0
    by_state[:, 2, PATH_ERROR_Z] = -1.0
    by_state[:, :, RATE_STATES] = cross_matrix(stacked(value, *ARM))
    return by_state


def slopes_by_constants(
    function: Callable[[Mapping[str, Any]], Array], value: Mapping[str, Any], names: Iterable[str]
) -> Array:
    """Return the slopes (..., c) of a function (...) of parameters by name, by some constants."""
    here = function(value)
    slopes = []
    for name in names:
        moved = function({**value, name: value[name] + CONSTANT_STEP})
        slopes.append((moved - here) / CONSTANT_STEP)
    return np.stack(slopes, axis=-1)


def readings_of(record: Record, value: Mapping[str, Any], truth: Matrix) -> Matrix:
    """Return the readings (n - 1, m) of the sensors of a record, of true values (n - 1, 9)."""
    return SensorErrors.of(value).readings(truth)[:, record.sampled]


class RecordModel:
    """Motion and readings of a record at parameters by name: surfaces are behind the servos."""

    def __init__(self, record: Record, layout: Layout, value: Mapping[str, Any]) -> None:
        self.record = record
        self.value = value
        self.model = layout.model(value)
        logged = record.inputs
        step = record.median_step
        surfaces = servo_output(logged.surfaces, value["servo_lag"], step)
        late = value["servo_delay"] * np.gradient(surfaces, step, axis=0)
        thrust = logged.thrust * (1 + value["thrust_scale"])
        self.inputs = Inputs(surfaces - late, thrust, logged.density)
        self.end_inputs = self.inputs.part(slice(1, None))

    def variables(self, states: Matrix) -> Matrix:
        """Return the variables (n, 13) along the recorded path at states (n, N) of the samples."""
        return _variables(air_velocity(self.record, self.value, states), states)

    def later_variables(self, states: Matrix) -> Matrix:
        """Return the same at states (n - 1, N) after each step."""
        later = self.record.part(slice(1, None))
        return _variables(air_velocity(later, self.value, states), states)

    def moved(self, start: Matrix, drift: Matrix) -> Matrix:
        """Return the motion (n - 1, 6) after each step from variables (n - 1, 13), in air of a drift (n - 1, 3)."""
        gravity = STANDARD_GRAVITY * self.record.attitude[:-1, :, 2]
        return self.model.step(start, gravity, drift, self.inputs, self.record.time_step)

    def truth(self, end: Matrix) -> Matrix:
        """Return what sensors without errors read (n - 1, 9) at variables (n - 1, 13) after each step."""
        loads = self.model.accelerations(end, self.end_inputs)
        return sensors(loads, end, self.record.position + stacked(self.value, *ARM))

    def readings(self, end: Matrix) -> Matrix:
        """Return the readings of the m sensors (n - 1, m) at variables (n - 1, 13) after each step."""
        return readings_of(self.record, self.value, self.truth(end))


class Expansion(RecordModel):
    """Model, inputs and motion of a record at filtered states (n, N) and parameters by name.

    ``decay`` (N,) are 1 / correlation time of the states, zero for the rates. The model moves the motion
    over each step, from a sample (start) to the next one (end).
    """

    def __init__(
        self,
        record: Record,
        layout: Layout,
        value: Mapping[str, Any],
        states: Matrix,
        decay: Vector,
    ) -> None:
        super().__init__(record, layout, value)
        self.layout = layout
        self.states = states
        self.air_by_state = air_velocity_slopes(record, value)
        airspeed = np.linalg.norm(air_velocity(record, value, states), axis=1)
        tau = self.model.relative_thrust(airspeed, self.inputs)
        self.surface_effect = self.model.slipstream.effect(tau)  # (n, k)
        # gusts and errors of the path decay, and the air velocity with them
        self.remaining = np.exp(-record.time_step[:, None] * decay)
        self.drift_by_state = -self.air_by_state[:-1] * decay
        self.drift = matrix_vector(self.drift_by_state, states[:-1])
        # variables (n - 1, 13) before and after each step, and after it along the recorded path
        self.start = self.variables(states)[:-1]
        motion = self.moved(self.start, self.drift)
        self.predicted = states[:-1] * self.remaining  # (n - 1, N)
        self.predicted[:, RATE_STATES] = motion[:, BODY_RATES]
        self.end = _variables(motion[:, AIR_VELOCITY], self.predicted)
        self.along = self.later_variables(self.predicted)
        # measured less predicted, zero where not sampled
        self.measured = record.measured[1:, record.sampled]
        self.past_truth = self.truth(self.end)
        self.path_truth = self.truth(self.along)
        past = readings_of(record, value, self.past_truth)
        path = readings_of(record, value, self.path_truth)
        self.past_error = np.nan_to_num(self.measured - past)
        self.path_error = np.nan_to_num(self.measured - path)
        # of the motion, (n - 1, 6, 13), and of the readings, (n - 1, m, 13)
        self.by_start = differentiated(
            lambda start: self.moved(start, self.drift), self.start, motion
        )
        self.past_by_end = differentiated(self.readings, self.end, past)
        self.path_by_along = differentiated(self.readings, self.along, path)

    def _predictions(self, value: Mapping[str, Any]) -> Matrix:
        """Return rates after each step, readings of the past and along the path (n - 1, 3 + 2 m) at other constants."""
        rates, past, path = self.predicted[:, RATE_STATES], self.past_truth, self.path_truth
        changed = {name for name in CONSTANTS if value[name] != self.value[name]}
        if not changed <= SENSOR_ERRORS:
            there = RecordModel(self.record, self.layout, value)
            motion = there.moved(there.variables(self.states)[:-1], self.drift)
            end = self.end.copy()
            end[:, MOTION] = motion
            rates, past = motion[:, BODY_RATES], there.truth(end)
            path = there.truth(there.later_variables(self.predicted))
        readings = [readings_of(self.record, value, truth) for truth in (past, path)]
        return np.concatenate([rates, *readings], axis=1)

    def linearization(self) -> Linearization:
        """Return the linear filter about the states and parameters."""
        Phi, D = self._slopes_by_states()
        end_by_state = _by_states(self.air_by_state[1:])
        return Linearization(
            states=self.states,
            predicted=self.predicted,
            Phi=Phi,
            past_error=self.past_error,
            D=D,
            L=self.past_by_end @ end_by_state,
            path_error=self.path_error,
            H=self.path_by_along @ end_by_state,
            time_step=self.record.time_step,
            surface_noise=self._surface_noise(),
            surface_reading_variance=self._surface_reading_variance(),
            added=self._added_noise(),
        )

    def _slopes_by_states(self) -> tuple[Array, Array]:
        """Return slopes of the states after each step, and of readings of the past, by the states before."""
        by_state = self.by_start @ _by_states(self.air_by_state[:-1])
        by_state[:, AIR_VELOCITY] += self.record.time_step[:, None, None] * self.drift_by_state
        Phi = self.remaining[:, :, None] * np.eye(N_STATES)
        Phi[:, RATE_STATES] = by_state[:, BODY_RATES]
        D = self.past_by_end[..., MOTION] @ by_state
        by_air_roll = self.past_by_end[..., AIR_ROLL]
        D[..., AIR_ROLL_STATE] += by_air_roll * self.remaining[:, [AIR_ROLL_STATE]]
        return Phi, D

    @cached_property
    def by_constants(self) -> Array:
        """Slopes of `_predictions` by all constants (n - 1, 3 + 2 m, c)."""
        return slopes_by_constants(self._predictions, self.value, CONSTANTS)

    def slopes_of_flight(self) -> Callable[[slice], Slopes]:
        """Return the slopes by the constants of a flight alone, as a function of some steps."""
        values = slopes_by_constants(self._predictions, self.value, FLIGHT_CONSTANTS)
        return lambda steps: _slopes_of(values[steps])

    def slopes(self, steps: slice) -> Slopes:
        """Return the slopes of some steps by parameters and instruments."""
        step_terms, end_terms, path_terms = (terms[steps] for terms in self.terms)
        by_terms = self.layout.by_terms
        motion_by_errors = self.by_start[steps, :, COEFFICIENT_ERRORS]
        past_by_errors = self.past_by_end[steps, :, MOTION] @ motion_by_errors
        rates = by_terms(motion_by_errors[:, BODY_RATES], step_terms)
        past = by_terms(past_by_errors, step_terms)
        past += by_terms(self.past_by_end[steps, :, COEFFICIENT_ERRORS], end_terms)
        path = by_terms(self.path_by_along[steps, :, COEFFICIENT_ERRORS], path_terms)
        by_derivatives = np.concatenate([rates, past, path], axis=1)
        own, of_instruments = np.split(by_derivatives, [self.layout.n_derivatives], axis=2)
        return _slopes_of(np.concatenate([own, self.by_constants[steps], of_instruments], axis=2))

    @cached_property
    def terms(self) -> list[Matrix]:
        """The terms of the coefficients (n - 1, 2 f) in each step, after it, and after it along the path.

        Behind the terms of the derivatives stand those of the instruments.
        """
        instants = (self.start, self.end, self.along)
        inputs = (self.inputs.part(slice(-1)), self.end_inputs, self.end_inputs)
        start, end, along = map(self._terms_at, instants, inputs)
        # terms within a step are the mean of the terms at its ends
        caused = self.instrument_terms(self.record.answers)
        return [
            np.hstack([0.5 * (start + end), means_of_neighbours(caused)]),
            np.hstack([end, caused[1:]]),
            np.hstack([along, caused[1:]]),
        ]

    def _terms_at(self, variables: Matrix, inputs: Inputs) -> Matrix:
        """Return the terms of the coefficients (n - 1, f) at variables (n - 1, 13)."""
        air = air_data(variables[:, AIR_VELOCITY])
        return self.model.terms(air, relative_rates(variables), inputs)

    def instrument_terms(self, answers: Matrix) -> Matrix:
        """Return the terms (n, f) of the coefficients in the motion that surfaces cause about the mean one.

        It contains no gusts, nor an autopilot's ``answers`` (n, k + 1) to these. The motion is damped to a
        correlation time of 4 s, as the motion of an unstable aircraft would grow.
        """
        # without an autopilot's answers to gusts
        answered = servo_output(answers[:, :-1], self.value["servo_lag"], self.record.median_step)
        surfaces = self.inputs.surfaces - answered
        thrust = self.inputs.thrust.copy()
        thrust[:, 0] -= answers[:, -1]
        # a command follows the noise of the same sample
        late = np.concatenate([surfaces[:1], surfaces[:-1]])
        A = self.by_start[:, :, MOTION]
        growth = np.abs(np.linalg.eigvals(A.mean(axis=0))).max()
        damping = np.exp(-self.record.median_step / 4.0)
        A = A * damping / max(growth, 1.0)
        B = self.by_start[:, :, COEFFICIENT_ERRORS] @ self.model.by_surfaces
        moved = (late - late.mean(axis=0)) * self.surface_effect
        push = B @ means_of_neighbours(moved)[..., None]
        motion = propagated(A, push)[..., 0]
        motion[:, AIR_VELOCITY] += self.start[:, AIR_VELOCITY].mean(axis=0)
        air = air_data(motion[:, AIR_VELOCITY])
        inputs = self.inputs._replace(surfaces=late, thrust=thrust)
        return self.model.terms(air, motion[:, BODY_RATES], inputs)

    def _added_noise(self) -> Array:
        """Return the covariance (n - 1, m, m) of vibration, and huge variances where a sensor is not sampled."""
        vibration = np.zeros((len(SENSORS), len(SENSORS)))
        vibration[INERTIAL_READINGS, INERTIAL_READINGS] = self.record.vibration
        sampled = self.record.sampled
        missing = 1e12 * np.isnan(self.measured)
        return missing[..., None] * np.eye(missing.shape[1]) + vibration[np.ix_(sampled, sampled)]

    def _surface_noise(self) -> Array:
        """Return the covariance (n - 1, N, N) by surfaces that are off by their change in the step.

        Or by their error between samples of a slow clock.
        """
        jump = np.diff(self.inputs.surfaces, axis=0)
        between_samples = means_of_neighbours(self.record.surface_errors)
        is_slow = self.record.surface_errors.any(axis=0)
        error = np.where(is_slow, between_samples, jump)
        error = error * means_of_neighbours(self.surface_effect)
        rates_by_errors = self.by_start[:, BODY_RATES, COEFFICIENT_ERRORS]
        push = rates_by_errors @ self.model.by_surfaces * error[:, None]
        covariance = np.zeros((len(jump), N_STATES, N_STATES))
        covariance[:, RATE_STATES, RATE_STATES] = push @ push.mT
        return covariance

    def _surface_reading_variance(self) -> Matrix:
        """Return the variance of readings (n - 1, m) by the errors of surfaces between samples."""
        by_surfaces = self.past_by_end[..., COEFFICIENT_ERRORS] @ self.model.by_surfaces
        error = self.record.surface_errors[1:] * self.surface_effect[1:]
        return np.sum((by_surfaces * error[:, None]) ** 2, axis=-1)


def _variables(air: Matrix, states: Matrix) -> Matrix:
    """Return the variables of the model (n, 13) at states (n, N), without errors of the coefficients."""
    without_errors = np.zeros((len(air), 6))
    rates = states[:, RATE_STATES]
    return np.concatenate([air, rates, without_errors, states[:, [AIR_ROLL_STATE]]], axis=1)


def _by_states(air_by_state: Array) -> Array:
    """Return d variables of the model / d states (n, 13, N), from d air velocity / d states (n, 3, N)."""
    slopes = np.zeros((len(air_by_state), N_VARIABLES, N_STATES))
    slopes[:, AIR_VELOCITY] = air_by_state
    slopes[:, BODY_RATES, RATE_STATES] = np.eye(3)
    slopes[:, AIR_ROLL, AIR_ROLL_STATE] = 1.0
    return slopes


def _slopes_of(values: Array) -> Slopes:
    """Return the slopes, from those of rates, readings of the past and along the path (k, 3 + 2 m, q)."""
    n, height, q = values.shape
    rates, past, path = np.split(values, [3, (3 + height) // 2], axis=1)
    states = np.zeros((n, N_STATES, q))
    states[:, RATE_STATES] = rates
    return Slopes(states, past, path)


def means_of_neighbours(values: Array) -> Array:
    """Return the means of neighbours along the first axis."""
    return 0.5 * (values[1:] + values[:-1])

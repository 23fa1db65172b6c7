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
slopes

.. math:: \frac{d h}{d z} = \frac{\partial h}{\partial M} \frac{d M}{d z} +
          \frac{\partial h}{\partial C} \frac{d C}{d z}, \quad
          \frac{d C_i}{d C_{ij}} = \mathrm{term}_j.

Instruments are the same derivatives with the terms in the motion that surfaces alone cause.

n samples, m sensors, N states, k parameters of a flight, of which the first d are derivatives of the
coefficients and c are constants, f terms. Slopes by z are by the N states of a sample, the k parameters, and the d
instruments, together N + q.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.linalg import matrix_vector
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.frames import STANDARD_GRAVITY, cross_matrix
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
)
from skdgp.estimation._air_parameters import (
    AIRCRAFT_CONSTANTS,
    ARM,
    FLIGHT_CONSTANTS,
    STATE_TERMS,
    TAIL,
    WINDS,
    is_coupling,
    stacked,
)
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import Linearization, PastPrediction, PathPrediction, Transition
from skdgp.estimation._sensors import (
    AIRSPEED,
    BIASED,
    FORCE_READINGS,
    INERTIAL_READINGS,
    SENSORS,
    SensorErrors,
)
from skdgp.estimation._servos import servo_output, servo_slopes
from skdgp.estimation._settings import AIR_SETTINGS, AirSettings

N_STATES = 9
GUST = slice(0, 3)
PATH_ERROR_Y = 3
PATH_ERROR_Z = 4
AIR_ROLL_STATE = 5
RATE_STATES = slice(6, 9)
"""Places of the states: the gust, errors of the path, rate of roll of the air, rates of the aircraft."""
COEFFICIENT_CONSTANTS = ("servo_lag", "servo_delay", "thrust_scale", "slipstream")
"""Constants that change the coefficients."""
LEARNED_BIASES = {
    name: BIASED[name] for name in [*AIRCRAFT_CONSTANTS, *FLIGHT_CONSTANTS] if name in BIASED
}
"""Places of the biased among the sensors."""


class Layout(NamedTuple):
    """Places of the derivatives in the matrix (6, k) of the model, and among the parameters."""

    rows: Indices  # (d,) coefficient of each derivative
    columns: Indices  # (d,) its term
    names: list[str]  # of the k parameters of a flight
    surfaces: list[str]
    #: Whether slopes by the instruments follow those by the parameters; not where derivatives are held
    by_instruments: bool = True

    @classmethod
    def of(cls, derivatives: list[str], surfaces: list[str], by_instruments: bool = True) -> Layout:
        """Return the layout of derivatives by name, such as CZ_alpha, which come first of a flight's parameters."""
        terms = [*STATE_TERMS, *surfaces]
        rows, columns = [], []
        for name in derivatives:
            coefficient, term = name.split("_", 1)
            rows.append(COEFFICIENTS.index(coefficient))
            columns.append(terms.index(term))
        names = [*derivatives, *AIRCRAFT_CONSTANTS, *FLIGHT_CONSTANTS]
        return cls(
            np.array(rows),
            np.array(columns),
            names,
            surfaces,
            by_instruments=by_instruments,
        )

    @property
    def n_terms(self) -> int:
        """Number f of terms."""
        return len(STATE_TERMS) + len(self.surfaces)

    @property
    def n_derivatives(self) -> int:
        """Number of derivatives."""
        return len(self.rows)

    @property
    def n_constants(self) -> int:
        """Number of constants."""
        return len(self.names) - self.n_derivatives

    @property
    def n_slopes(self) -> int:
        """Number q of slopes by parameters and instruments."""
        return len(self.names) + self.by_instruments * self.n_derivatives

    def place(self, *names: str) -> list[int]:
        """Return places of parameters among the slopes."""
        return [self.names.index(name) for name in names]

    def place_of_constants(self, *names: str) -> list[int]:
        """Return places of parameters among the constants."""
        return [place - self.n_derivatives for place in self.place(*names)]

    def of_coefficient(self, name: str) -> Indices:
        """Return the places of the derivatives of a coefficient."""
        return np.flatnonzero(self.rows == COEFFICIENTS.index(name))

    @property
    def are_couplings(self) -> Mask:
        """Whether each derivative is outside of the classical list."""
        return np.array([is_coupling(name) for name in self.names[: self.n_derivatives]])

    def is_by(self, *terms: str) -> Mask:
        """Return whether each derivative is by one of the state's terms."""
        return np.isin(self.columns, [STATE_TERMS.index(name) for name in terms])

    @property
    def constants(self) -> slice:
        """Places of the constants, which are the parameters behind the derivatives, among the slopes by z."""
        return slice(N_STATES + self.n_derivatives, N_STATES + len(self.names))

    def motion_slopes(self, attitude: Array, rates: Matrix, air_by_state: Array) -> Array:
        """Return d variables of the model / d states and constants, (n, 13, N + c), at given coefficients."""
        slopes = np.zeros((len(rates), N_VARIABLES, N_STATES + self.n_constants))
        slopes[:, AIR_VELOCITY, :N_STATES] = air_by_state
        slopes[:, BODY_RATES, RATE_STATES] = np.eye(3)
        slopes[:, AIR_ROLL, AIR_ROLL_STATE] = 1.0
        by_constants = slopes[..., N_STATES:]
        by_constants[:, AIR_VELOCITY, self.place_of_constants(*WINDS)] = -attitude
        by_constants[:, AIR_VELOCITY, self.place_of_constants(*ARM)] = -cross_matrix(rates)
        return slopes

    def through_coefficients(self, by_variables: Array, slopes: CoefficientSlopes) -> Array:
        """Return the term d h / d C d C / d z of the chain rule, (n, m, N + q).

        From d h / d variables, (n, m, 13). States do not change the coefficients at a given motion.
        """
        by_coefficients = by_variables[..., COEFFICIENT_ERRORS]
        values = np.zeros((*by_variables.shape[:2], N_STATES + self.n_slopes))
        by_constants = values[..., self.constants]
        places = self.place_of_constants(*COEFFICIENT_CONSTANTS)
        by_constants[..., places] = by_coefficients @ slopes.by_constants
        by_rows = by_coefficients[:, :, self.rows]
        by_derivatives = values[..., N_STATES : self.constants.start]
        np.multiply(by_rows, slopes.terms[:, None, self.columns], out=by_derivatives)
        if self.by_instruments:
            by_instruments = values[..., self.constants.stop :]
            np.multiply(by_rows, slopes.instrument_terms[:, None, self.columns], out=by_instruments)
        return values

    def chained(
        self, by_variables: Array, motion_slopes: Array, coefficient_slopes: CoefficientSlopes
    ) -> Array:
        """Return d h / d z (n, m, N + q) by both terms of the chain rule, from d h / d variables (n, m, 13)."""
        values = self.through_coefficients(by_variables, coefficient_slopes)
        through_motion = by_variables @ motion_slopes
        values[..., :N_STATES] += through_motion[..., :N_STATES]
        values[..., self.constants] += through_motion[..., N_STATES:]
        return values


class CoefficientSlopes(NamedTuple):
    """Slopes of the coefficients of n samples by derivatives, instruments and constants, at a given motion."""

    terms: Matrix  # (n, f) d C_i / d C_ij
    instrument_terms: Matrix  # (n, f) the same of instruments
    by_constants: Array  # (n, 6, 4) by `COEFFICIENT_CONSTANTS`


def motion_model(
    record: Record, layout: Layout, aircraft: Aircraft, value: Mapping[str, Any]
) -> AirMotionModel:
    """Return the equations of motion of the aircraft, and of the sensors of a record, at parameters by name."""
    derivatives = np.zeros((6, layout.n_terms))
    names = layout.names[: layout.n_derivatives]
    derivatives[layout.rows, layout.columns] = [value[name] for name in names]
    reached = np.isin(layout.surfaces, TAIL).astype(float)
    slipstream = Slipstream(value["slipstream"], record.mean_thrust, reached)
    arm = record.position + stacked(value, *ARM)
    return AirMotionModel(aircraft, derivatives, arm, slipstream)


def air_velocity(record: Record, value: Mapping[str, Any], states: Matrix) -> tuple[Matrix, Array]:
    """Return the velocity relative to the air (n, 3), body axes, and its derivatives by the states (n, 3, N)."""
    by_state = np.zeros((len(states), 3, N_STATES))
    by_state[:, :, GUST] = -record.attitude
    by_state[:, 1, PATH_ERROR_Y] = -1.0
    by_state[:, 2, PATH_ERROR_Z] = -1.0
    by_state[:, :, RATE_STATES] = cross_matrix(stacked(value, *ARM))
    steady = record.velocity - record.attitude @ stacked(value, *WINDS)
    return steady + matrix_vector(by_state, states), by_state


class _Readings(NamedTuple):
    """Readings of the m sensors that are sampled, after each step, and their partial derivatives."""

    values: Matrix  # (n - 1, m)
    by_variables: Array  # (n - 1, m, 13) of the model
    by_constants: Array  # (n - 1, m, c) by biases, scale and position of the sensors


class Expansion:
    """Model, inputs and motion of a record at filtered states (n, N) and parameters by name.

    ``decay`` (N,) are 1 / correlation time of the states, zero for the rates. The model moves the motion
    over each step, from a sample (start) to the next one (end).
    """

    def __init__(
        self,
        record: Record,
        layout: Layout,
        aircraft: Aircraft,
        value: Mapping[str, Any],
        states: Matrix,
        decay: Vector,
        settings: AirSettings = AIR_SETTINGS,
    ) -> None:
        self.record = record
        self.layout = layout
        self.value = value
        self.states = states
        self.settings = settings
        self.model = motion_model(record, layout, aircraft, value)
        logged = record.inputs
        surfaces, by_servos = servo_slopes(logged.surfaces, value["servo_lag"], record.median_step)
        thrust = logged.thrust * (1 + value["thrust_scale"])
        self.inputs = Inputs(surfaces, thrust, logged.density)
        self.end_inputs = self.inputs.part(slice(1, None))
        self.air, self.air_by_state = air_velocity(record, value, states)
        tau = self.model.relative_thrust(np.linalg.norm(self.air, axis=1), self.inputs)
        self.surface_effect = self.model.slipstream.effect(tau)  # (n, k)
        self.constant_slopes = self.model.constant_slopes(
            self.air, self.inputs, by_servos, logged.thrust
        )
        # gusts and errors of the path decay, and the air velocity with them
        self.remaining = np.exp(-record.time_step[:, None] * decay)
        self.drift_by_state = -self.air_by_state[:-1] * decay
        # motion over each step: variables (n - 1, 13) before and after, d end / d start (n - 1, 6, 13)
        self.start = _variables(self.air, states)[:-1]
        self.end, self.by_start = self._moved()
        # of the m sensors that have any sample, after each step
        self.measured = record.measured[1:, record.sampled]
        self.is_sampled = np.isfinite(self.measured)

    def _moved(self) -> tuple[Matrix, Array]:
        """Return the variables (n - 1, 13) after the step from each sample, and d end / d start (n - 1, 6, 13)."""
        drift = matrix_vector(self.drift_by_state, self.states[:-1])
        gravity = STANDARD_GRAVITY * self.record.attitude[:-1, :, 2]
        time_step = self.record.time_step
        end, slopes = differentiated(
            lambda start: self.model.step(start, gravity, drift, self.inputs, time_step), self.start
        )
        after = self.states[:-1] * self.remaining
        after[:, RATE_STATES] = end[:, BODY_RATES]
        return _variables(end[:, AIR_VELOCITY], after), slopes

    def linearization(self) -> Linearization:
        """Return the linear filter about the states and parameters."""
        instrument_terms = self.instrument_terms()
        step_slopes = self._step_slopes(instrument_terms)
        predicted = self._predicted_states()
        readings = self._readings(self.end)
        missing, vibration = self._added_noise()
        return Linearization(
            states=self.states,
            predicted=predicted,
            transition=self._transition(step_slopes),
            past=self._past_prediction(readings, step_slopes, instrument_terms),
            path=self._path_prediction(predicted, instrument_terms),
            time_step=self.record.time_step,
            surface_noise=self._surface_noise(),
            surface_reading_variance=self._surface_reading_variance(readings.by_variables),
            missing=missing,
            vibration=vibration,
        )

    def instrument_terms(self) -> Matrix:
        """Return the terms (n, f) of the coefficients in the motion that surfaces cause about the mean one.

        It contains no gusts. The motion is damped to a correlation time of
        ``settings.response_time``, as the motion of an unstable aircraft would grow.
        """
        commanded = self._commanded()
        surfaces = commanded.surfaces
        delay = self.settings.response_delay
        late = np.concatenate([surfaces[:1]] * delay + [surfaces[: len(surfaces) - delay]])
        A = self.by_start[:, :, MOTION]
        growth = np.abs(np.linalg.eigvals(A.mean(axis=0))).max()
        damping = np.exp(-self.record.median_step / self.settings.response_time)
        A = A * damping / max(growth, 1.0)
        B = self.by_start[:, :, COEFFICIENT_ERRORS] @ self.model.by_surfaces
        moved = (late - late.mean(axis=0)) * self.surface_effect
        motion = _motion(A, matrix_vector(B, means_of_neighbours(moved)))
        motion[:, AIR_VELOCITY] += self.start[:, AIR_VELOCITY].mean(axis=0)
        return self.model.terms(motion, commanded._replace(surfaces=late))

    def _commanded(self) -> Inputs:
        """Return surfaces and thrust without an autopilot's answers to gusts."""
        answers = self.record.answers
        inputs = self.inputs
        if answers is None:
            return inputs
        late = servo_output(answers[:, :-1], self.value["servo_lag"], self.record.median_step)
        thrust = inputs.thrust.copy()
        thrust[:, 0] -= answers[:, -1]
        return inputs._replace(surfaces=inputs.surfaces - late, thrust=thrust)

    def _predicted_states(self) -> Matrix:
        """Return the states (n - 1, N) after each step."""
        predicted = self.states[:-1] * self.remaining
        predicted[:, RATE_STATES] = self.end[:, BODY_RATES]
        return predicted

    def _step_slopes(self, instrument_terms: Matrix) -> Array:
        """Return d motion after the step / d z, (n - 1, 6, N + q)."""
        # terms within a step are the mean of the terms at its ends
        terms = self.model.terms(self.start, self.inputs.part(slice(-1)), self.start[:, AIR_ROLL])
        end_terms = self._end_terms(self.end)
        coefficients = CoefficientSlopes(
            terms=0.5 * (terms + end_terms),
            instrument_terms=means_of_neighbours(instrument_terms),
            by_constants=means_of_neighbours(self.constant_slopes),
        )
        motion = self.layout.motion_slopes(
            self.record.attitude[:-1], self.start[:, BODY_RATES], self.air_by_state[:-1]
        )
        slopes = self.layout.chained(self.by_start, motion, coefficients)
        time_step = self.record.time_step[:, None, None]
        slopes[:, AIR_VELOCITY, :N_STATES] += time_step * self.drift_by_state
        return slopes

    def _transition(self, step_slopes: Array) -> Transition:
        """Return the slopes of the states after each step."""
        Phi = self.remaining[:, :, None] * np.eye(N_STATES)
        Theta = np.zeros((len(Phi), N_STATES, self.layout.n_slopes))
        Phi[:, RATE_STATES] = step_slopes[:, BODY_RATES, :N_STATES]
        Theta[:, RATE_STATES] = step_slopes[:, BODY_RATES, N_STATES:]
        return Transition(Phi, Theta)

    def _past_prediction(
        self, readings: _Readings, step_slopes: Array, instrument_terms: Matrix
    ) -> PastPrediction:
        """Return the prediction of the readings at the end of each step, from its start alone.

        The motion there depends on z by ``step_slopes``, the coefficients by their terms there.
        """
        coefficients = self._end_coefficient_slopes(self.end, instrument_terms)
        through_coefficients = self.layout.through_coefficients(readings.by_variables, coefficients)
        through_motion = readings.by_variables[..., MOTION] @ step_slopes
        slopes = through_coefficients + through_motion  # d h / d C d C / d z + d h / d M d M / d z
        by_air_roll = readings.by_variables[..., AIR_ROLL]
        slopes[..., AIR_ROLL_STATE] += by_air_roll * self.remaining[:, [AIR_ROLL_STATE]]
        by_state, by_parameters = self._by_state_and_parameters(slopes, readings)
        motion_by_state = self._end_motion_slopes(self.end)[..., :N_STATES]
        return PastPrediction(
            error=self._errors(readings.values),
            by_state_before=by_state,
            by_state_after=readings.by_variables @ motion_by_state,
            by_parameters=by_parameters,
        )

    def _path_prediction(self, predicted: Matrix, instrument_terms: Matrix) -> PathPrediction:
        """Return the prediction of the readings at the recorded path, with the predicted gusts and rates."""
        change = matrix_vector(self.air_by_state[1:], predicted - self.states[1:])
        variables = _variables(self.air[1:] + change, predicted)
        readings = self._readings(variables)
        slopes = self.layout.chained(
            readings.by_variables,
            self._end_motion_slopes(variables),
            self._end_coefficient_slopes(variables, instrument_terms),
        )
        by_state, by_parameters = self._by_state_and_parameters(slopes, readings)
        return PathPrediction(self._errors(readings.values), by_state, by_parameters)

    def _readings(self, end: Matrix) -> _Readings:
        """Return the readings at variables (n - 1, 13) after each step."""
        errors = SensorErrors.of(self.value)
        truth, slopes = differentiated(lambda s: self.model.sensors(s, self.end_inputs), end)
        sampled = self.record.sampled
        by_variables = (errors.scale[:, None] * slopes)[:, sampled]
        layout = self.layout
        by_constants = np.zeros((*truth.shape, layout.n_constants))
        biases = layout.place_of_constants(*LEARNED_BIASES)
        by_constants[:, [*LEARNED_BIASES.values()], biases] = 1.0
        (scale,) = layout.place_of_constants("airspeed_scale")
        by_constants[:, AIRSPEED, scale] = truth[:, AIRSPEED]
        arm = layout.place_of_constants(*ARM)
        by_constants[:, FORCE_READINGS, arm] = self.model.arm_slopes(end, self.end_inputs)
        return _Readings(
            values=errors.readings(truth)[:, sampled],
            by_variables=by_variables,
            by_constants=by_constants[:, sampled],
        )

    def _end_motion_slopes(self, end: Matrix) -> Array:
        """Return d variables / d states and constants of the same sample, (n - 1, 13, N + c)."""
        return self.layout.motion_slopes(
            self.record.attitude[1:], end[:, BODY_RATES], self.air_by_state[1:]
        )

    def _end_coefficient_slopes(self, end: Matrix, instrument_terms: Matrix) -> CoefficientSlopes:
        """Return the slopes of the coefficients at variables (n - 1, 13) after each step."""
        return CoefficientSlopes(
            self._end_terms(end), instrument_terms[1:], self.constant_slopes[1:]
        )

    def _end_terms(self, end: Matrix) -> Matrix:
        """Return the terms (n - 1, f) of the coefficients at variables (n - 1, 13) after each step."""
        return self.model.terms(end, self.end_inputs, end[:, AIR_ROLL])

    def _by_state_and_parameters(self, slopes: Array, readings: _Readings) -> tuple[Array, Array]:
        """Return slopes of readings by the states, and by parameters with the constants of the sensors."""
        slopes[..., self.layout.constants] += readings.by_constants
        return slopes[..., :N_STATES].copy(), slopes[..., N_STATES:]

    def _errors(self, values: Matrix) -> Matrix:
        """Return measured less predicted readings (n - 1, m), zero where not sampled."""
        return np.where(self.is_sampled, self.measured - values, 0.0)

    def _added_noise(self) -> tuple[Matrix, Matrix]:
        """Return variances (n - 1, m) where a sensor is not sampled, and the covariance (m, m) of vibration."""
        not_sampled = 1e12  # variance [SI], whatever the noise of the sensor
        missing = np.where(self.is_sampled, 0.0, not_sampled)
        vibration = np.zeros((len(SENSORS), len(SENSORS)))
        vibration[INERTIAL_READINGS, INERTIAL_READINGS] = self.record.vibration
        sampled = self.record.sampled
        return missing, vibration[np.ix_(sampled, sampled)]

    def _surface_noise(self) -> Array:
        """Return the covariance (n - 1, N, N) by surfaces that are off by their change in the step.

        Or by their error between samples of a slow clock.
        """
        jump = np.diff(self.inputs.surfaces, axis=0)
        between_samples = means_of_neighbours(self.record.surface_errors)
        error = np.where(self.record.periods > 0, between_samples, jump)
        error = error * means_of_neighbours(self.surface_effect)
        rates_by_errors = self.by_start[:, BODY_RATES, COEFFICIENT_ERRORS]
        push = rates_by_errors @ self.model.by_surfaces * error[:, None]
        covariance = np.zeros((len(jump), N_STATES, N_STATES))
        covariance[:, RATE_STATES, RATE_STATES] = push @ push.mT
        return covariance

    def _surface_reading_variance(self, by_variables: Array) -> Matrix:
        """Return the variance of readings (n - 1, m) by the errors of surfaces between samples."""
        by_surfaces = by_variables[..., COEFFICIENT_ERRORS] @ self.model.by_surfaces
        error = self.record.surface_errors[1:] * self.surface_effect[1:]
        return np.sum((by_surfaces * error[:, None]) ** 2, axis=-1)


def _motion(A: Array, push: Matrix) -> Matrix:
    """Return x (n, k) of x_{k+1} = A_k x_k + push_k from zero."""
    x = np.zeros((len(A) + 1, push.shape[1]))
    for k in range(len(A)):
        x[k + 1] = A[k] @ x[k] + push[k]
    return x


def _variables(air: Matrix, states: Matrix) -> Matrix:
    """Return the variables of the model (n, 13) at states (n, N), without errors of the coefficients."""
    without_errors = np.zeros((len(air), 6))
    rates = states[:, RATE_STATES]
    return np.concatenate([air, rates, without_errors, states[:, [AIR_ROLL_STATE]]], axis=1)


def means_of_neighbours(values: Array) -> Array:
    """Return the means of neighbours along the first axis."""
    return 0.5 * (values[1:] + values[:-1])

r"""Linearization of a record of the filter-error method, at filtered states and parameters.

States (11): gusts north, east, down in a slow and a fast part :math:`g_1, g_2` [m/s]; errors of path
and attitude e that add to the air velocity, body axes y and z [m/s]; rates :math:`\omega` [rad/s]. With
the ground velocity v (body axes), attitude R (NED to body), steady wind w and position r of the sensors,

.. math:: v_a = v - R (w + g_1 + g_2) - e - \omega \times r,

which `air_velocity` evaluates. The rates follow by one Runge-Kutta step of the equations of motion
(``_air_model.py``), the other states decay. Measurements are the nine sensors at the end of the step, from
the past alone (innovation), and with the recorded path (residual).

Derivatives by parameters follow from air velocity and coefficients by the chain rule. Instruments,
which follow the parameters, are the same derivatives with the terms of the coefficients in the
motion that surfaces cause.
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
    AIR_VELOCITY,
    BODY_RATES,
    COEFFICIENT_ERRORS,
    N_VARIABLES,
    AirMotionModel,
    Inputs,
    differentiated,
)
from skdgp.estimation._air_parameters import (
    ARM,
    OWN,
    SHARED,
    STATE_TERMS,
    WINDS,
    is_coupling,
    stacked,
)
from skdgp.estimation._air_records import Record, servo_output, servo_slopes
from skdgp.estimation._kalman import Linearization
from skdgp.estimation._sensors import AIRSPEED, BIASED, FORCE_READINGS, SensorErrors
from skdgp.estimation._settings import AIR_SETTINGS, AirSettings

N_STATES = 11
SLOW_GUST = slice(0, 3)
FAST_GUST = slice(3, 6)
PATH_ERROR_Y = 6
PATH_ERROR_Z = 7
RATE_STATES = slice(8, 11)
"""Places of the states: two parts of the gust, errors of the path, rates."""
BIASES = {name: BIASED[name] for name in [*SHARED, *OWN] if name in BIASED}
"""Places of the biased among the sensors."""


class Layout(NamedTuple):
    """Places of the derivatives in the matrix (6, k) of the model, and among the parameters."""

    rows: Indices
    columns: Indices
    names: list[str]
    n_features: int
    #: Whether slopes by the instruments of the derivatives follow the others; not where these are held
    by_instruments: bool = True

    @classmethod
    def of(cls, derivatives: list[str], surfaces: list[str], by_instruments: bool = True) -> Layout:
        """Return the layout of derivatives by name, such as CZ_alpha, which come first of a flight's parameters."""
        features = [*STATE_TERMS, *surfaces]
        rows, columns = [], []
        for name in derivatives:
            coefficient, term = name.split("_", 1)
            rows.append(COEFFICIENTS.index(coefficient))
            columns.append(features.index(term))
        names = [*derivatives, *SHARED, *OWN]
        return cls(
            np.array(rows),
            np.array(columns),
            names,
            len(features),
            by_instruments=by_instruments,
        )

    @property
    def n_derivatives(self) -> int:
        """Number of derivatives."""
        return len(self.rows)

    @property
    def n_slopes(self) -> int:
        """Number of slopes: by all parameters, and by instruments of the derivatives."""
        return len(self.names) + self.by_instruments * self.n_derivatives

    def place(self, *names: str) -> list[int]:
        """Return places of parameters among the slopes."""
        return [self.names.index(name) for name in names]

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

    def variable_slopes(
        self,
        attitude: Array,
        rates: Matrix,
        air_by_state: Array,
        coefficient_changes: Array | float = 0.0,
    ) -> Array:
        """Return d variables of the model / d states and parameters, (n, 12, N + k), zero by derivatives.

        ``coefficient_changes`` (n, 6, 2) are by lag of the servos and scale of the thrust.
        """
        slopes = np.zeros((len(rates), N_VARIABLES, N_STATES + len(self.names)))
        slopes[:, AIR_VELOCITY, :N_STATES] = air_by_state
        slopes[:, BODY_RATES, RATE_STATES] = np.eye(3)
        by_parameters = slopes[..., N_STATES:]
        lag_and_thrust = self.place("servo_lag", "thrust_scale")
        by_parameters[:, COEFFICIENT_ERRORS, lag_and_thrust] = coefficient_changes
        by_parameters[:, AIR_VELOCITY, self.place(*WINDS)] = -attitude
        by_parameters[:, AIR_VELOCITY, self.place(*ARM)] = -cross_matrix(rates)
        return slopes

    def chained(self, by_variables: Array, slopes: Array, terms: Matrix, response: Matrix) -> Array:
        """Return d values / d z (n, m, N + p), from d values / d variables (n, m, 12).

        By the `variable_slopes`, the terms (n, f) of the derivatives, and their values ``response``
        in the motion that surfaces cause, of the instruments.
        """
        by_coefficients = by_variables[:, :, COEFFICIENT_ERRORS][:, :, self.rows]
        by_states = by_variables @ slopes[..., :N_STATES]
        by_derivatives = by_coefficients * terms[:, None, self.columns]
        by_constants = by_variables @ slopes[..., N_STATES + self.n_derivatives :]
        parts = [by_states, by_derivatives, by_constants]
        if self.by_instruments:
            parts.append(by_coefficients * response[:, None, self.columns])
        return np.concatenate(parts, axis=-1)


def motion_model(layout: Layout, aircraft: Aircraft, value: Mapping[str, Any]) -> AirMotionModel:
    """Return the aircraft's equations of motion at parameters by name."""
    derivatives = np.zeros((6, layout.n_features))
    names = layout.names[: layout.n_derivatives]
    derivatives[layout.rows, layout.columns] = [value[name] for name in names]
    return AirMotionModel(aircraft, derivatives, stacked(value, *ARM))


def air_velocity(record: Record, value: Mapping[str, Any], states: Matrix) -> tuple[Matrix, Array]:
    """Return the velocity relative to the air (n, 3), body axes, and its derivatives by the states (n, 3, N)."""
    by_state = np.zeros((len(states), 3, N_STATES))
    by_state[:, :, SLOW_GUST] = -record.attitude
    by_state[:, :, FAST_GUST] = -record.attitude
    by_state[:, 1, PATH_ERROR_Y] = -1.0
    by_state[:, 2, PATH_ERROR_Z] = -1.0
    by_state[:, :, RATE_STATES] = cross_matrix(stacked(value, *ARM))
    steady = record.velocity - record.attitude @ stacked(value, *WINDS)
    return steady + matrix_vector(by_state, states), by_state


class _Readings(NamedTuple):
    """Readings of the m sensors that are sampled, after each step."""

    values: Matrix  # (n - 1, m)
    by_variables: Array  # (n - 1, m, 12)
    slopes: Array  # (n - 1, m, N + p) by z


class _Expansion:
    """Model, inputs and motion of a record at filtered states (n, N) and parameters by name.

    ``z`` below stands for the N states of a sample, the parameters and the instruments, together.
    """

    def __init__(
        self,
        record: Record,
        layout: Layout,
        aircraft: Aircraft,
        value: Mapping[str, Any],
        states: Matrix,
        decay: Vector,
    ) -> None:
        self.record = record
        self.layout = layout
        self.value = value
        self.states = states
        self.model = motion_model(layout, aircraft, value)
        logged = record.inputs
        surfaces, by_lag = servo_slopes(logged.surfaces, value["servo_lag"], record.median_step)
        thrust = logged.thrust * (1 + value["thrust_scale"])
        self.inputs = Inputs(surfaces, thrust, logged.density)
        self.later = self.inputs.part(slice(1, None))
        self.air, self.air_by_state = air_velocity(record, value, states)
        self.changes = self.model.lag_and_thrust_slopes(self.air, logged, by_lag)
        self.start = _variables(self.air, states[:, RATE_STATES])[:-1]
        # gusts and errors of the path decay, and the air velocity with them
        self.kept = np.exp(-record.step[:, None] * decay)
        self.drift_by_state = -self.air_by_state[:-1] * decay

    def step(self) -> tuple[Matrix, Array]:
        """Return the variables (n - 1, 12) after the step from each sample, and d end / d start (n - 1, 6, 12)."""
        drift = matrix_vector(self.drift_by_state, self.states[:-1])
        gravity = STANDARD_GRAVITY * self.record.attitude[:-1, :, 2]
        steps = self.record.step
        end, slopes = differentiated(
            lambda start: self.model.step(start, gravity, drift, self.inputs, steps), self.start
        )
        return _variables(end[:, AIR_VELOCITY], end[:, BODY_RATES]), slopes

    def step_slopes(self, end: Matrix, by_start: Array, response: Matrix) -> Array:
        """Return d air velocity and rates after the step / d z, (n - 1, 6, N + p)."""
        # terms within a step are the mean of the terms at its ends
        terms = self.model.terms(self.start, self.inputs.part(slice(-1)).surfaces)
        end_terms = self.model.terms(end, self.later.surfaces)
        variables = self.layout.variable_slopes(
            self.record.attitude[:-1],
            self.start[:, BODY_RATES],
            self.air_by_state[:-1],
            _means(self.changes),
        )
        terms = 0.5 * (terms + end_terms)
        slopes = self.layout.chained(by_start, variables, terms, _means(response))
        slopes[:, AIR_VELOCITY, :N_STATES] += self.record.step[:, None, None] * self.drift_by_state
        return slopes

    def end_variables(self, end: Matrix) -> Array:
        """Return d variables / d states and parameters of the same sample, (n - 1, 12, N + k)."""
        return self.layout.variable_slopes(
            self.record.attitude[1:], end[:, BODY_RATES], self.air_by_state[1:], self.changes[1:]
        )

    def end_slopes(self, end: Matrix, by_variables: Array, response: Matrix) -> Array:
        """Return d values / d z of the same sample, (n - 1, m, N + p), from d values / d variables."""
        terms = self.model.terms(end, self.later.surfaces)
        return self.layout.chained(by_variables, self.end_variables(end), terms, response[1:])

    def past(self, end: Matrix, step_slopes: Array, response: Matrix) -> _Readings:
        """Return the readings at the end of the step, from its start alone."""
        readings = self._readings(end)
        readings.slopes[:] += readings.by_variables[..., :6] @ step_slopes
        by_errors = readings.by_variables.copy()
        by_errors[..., :6] = 0.0
        readings.slopes[:] += self.end_slopes(end, by_errors, response)
        return readings

    def recorded(self, end: Matrix, predicted: Matrix, response: Matrix) -> _Readings:
        """Return the readings at the recorded path, with the predicted gusts and rates."""
        change = matrix_vector(self.air_by_state[1:], predicted - self.states[1:])
        variables = _variables(self.air[1:] + change, end[:, BODY_RATES])
        readings = self._readings(variables)
        readings.slopes[:] += self.end_slopes(variables, readings.by_variables, response)
        return readings

    def _readings(self, end: Matrix) -> _Readings:
        """Return readings at variables (n - 1, 12), with their slopes by z at given variables."""
        errors = SensorErrors.of(self.value)
        truth, by_variables = differentiated(lambda s: self.model.sensors(s, self.later), end)
        values = errors.readings(truth)
        layout = self.layout
        slopes = np.zeros((*values.shape, N_STATES + layout.n_slopes))
        by_parameters = slopes[..., N_STATES:]
        by_parameters[:, [*BIASES.values()], layout.place(*BIASES)] = 1.0
        (scale,) = layout.place("airspeed_scale")
        by_parameters[:, AIRSPEED, scale] = truth[:, AIRSPEED]
        by_parameters[:, FORCE_READINGS, layout.place(*ARM)] = self.model.arm_slopes(
            end, self.later
        )
        use = self.record.sampled
        return _Readings(
            values[:, use], errors.scale[use, None] * by_variables[:, use], slopes[:, use]
        )

    def response(self, by_start: Array, settings: AirSettings) -> Matrix:
        """Return the terms (n, f) of the coefficients in the motion that surfaces cause about the mean one.

        It contains no gusts. The motion is damped to a correlation time of
        ``settings.response_time``, as the motion of an unstable aircraft would grow.
        """
        surfaces = self._commanded()
        delay = settings.response_delay
        late = np.concatenate([surfaces[:1]] * delay + [surfaces[: len(surfaces) - delay]])
        A = by_start[:, :, :6]
        growth = np.abs(np.linalg.eigvals(A.mean(axis=0))).max()
        A = A * np.exp(-self.record.median_step / settings.response_time) / max(growth, 1.0)
        B = by_start[:, :, COEFFICIENT_ERRORS] @ self.model.by_surfaces
        motion = _motion(A, matrix_vector(B, _means(late - late.mean(axis=0))))
        motion[:, AIR_VELOCITY] += self.start[:, AIR_VELOCITY].mean(axis=0)
        return self.model.terms(motion, late)

    def _commanded(self) -> Matrix:
        """Return the surfaces (n, k) without an autopilot's answers to gusts."""
        answers = self.record.answers
        if answers is None:
            return self.inputs.surfaces
        late = servo_output(answers, self.value["servo_lag"], self.record.median_step)
        return self.inputs.surfaces - late

    def surface_noise(self, by_start: Array) -> Array:
        """Return the covariance (n - 1, N, N) by surfaces that are off by their change in the step.

        Or by their error between samples of a slow clock.
        """
        jump = np.diff(self.inputs.surfaces, axis=0)
        error = np.where(self.record.periods > 0, _means(self.record.surface_errors), jump)
        push = by_start[:, BODY_RATES, COEFFICIENT_ERRORS] @ self.model.by_surfaces * error[:, None]
        covariance = np.zeros((len(jump), N_STATES, N_STATES))
        covariance[:, RATE_STATES, RATE_STATES] = push @ push.mT
        return covariance

    def surface_readings(self, by_end: Array) -> Matrix:
        """Return the variance of readings (n - 1, m) by the errors of surfaces between samples."""
        by_surfaces = by_end[..., COEFFICIENT_ERRORS] @ self.model.by_surfaces
        return np.sum((by_surfaces * self.record.surface_errors[1:, None]) ** 2, axis=-1)


def linearized(
    record: Record,
    layout: Layout,
    aircraft: Aircraft,
    value: Mapping[str, Any],
    states: Matrix,
    decay: Vector,
    settings: AirSettings = AIR_SETTINGS,
) -> Linearization:
    """Return the linear filter about filtered states (n, N) and parameters by name.

    ``decay`` (N,) are 1 / correlation time of the states, zero for the rates.
    """
    expansion = _Expansion(record, layout, aircraft, value, states, decay)
    end, by_start = expansion.step()
    response = expansion.response(by_start, settings)
    step_slopes = expansion.step_slopes(end, by_start, response)
    predicted = states[:-1] * expansion.kept
    predicted[:, RATE_STATES] = end[:, BODY_RATES]
    transition = expansion.kept[:, :, None] * np.eye(N_STATES, N_STATES + layout.n_slopes)
    transition[:, RATE_STATES] = step_slopes[:, BODY_RATES]

    past = expansion.past(end, step_slopes, response)
    recorded = expansion.recorded(end, predicted, response)
    noise_slopes = past.by_variables @ expansion.end_variables(end)[..., :N_STATES]
    measured = record.measured[1:, record.sampled]
    is_sampled = np.isfinite(measured)
    not_sampled = 1e12  # variance [SI], whatever the noise of the sensor
    transition, transition_slopes = _split(transition)
    innovation_states, innovation_slopes = _split(past.slopes)
    residual_states, residual_slopes = _split(recorded.slopes)
    return Linearization(
        states=states,
        predicted=predicted,
        transition=transition,
        transition_slopes=transition_slopes,
        innovation=np.where(is_sampled, measured - past.values, 0.0),
        innovation_states=innovation_states,
        innovation_noise=noise_slopes,
        innovation_slopes=innovation_slopes,
        residual=np.where(is_sampled, measured - recorded.values, 0.0),
        residual_states=residual_states,
        residual_slopes=residual_slopes,
        step=record.step,
        surface_noise=expansion.surface_noise(by_start),
        surface_readings=expansion.surface_readings(past.by_variables),
        missing=np.where(is_sampled, 0.0, not_sampled),
        response=_means(response),
    )


def _split(slopes: Array) -> tuple[Array, Array]:
    """Return derivatives by the states, and by parameters and instruments."""
    return slopes[..., :N_STATES].copy(), slopes[..., N_STATES:]


def _motion(A: Array, push: Matrix) -> Matrix:
    """Return x (n, k) of x_{k+1} = A_k x_k + push_k from zero."""
    x = np.zeros((len(A) + 1, push.shape[1]))
    for k in range(len(A)):
        x[k + 1] = A[k] @ x[k] + push[k]
    return x


def _variables(air: Matrix, rates: Matrix) -> Matrix:
    """Return the variables of the model (n, 12), without errors of the coefficients."""
    return np.concatenate([air, rates, np.zeros((len(air), 6))], axis=1)


def _means(values: Array) -> Array:
    """Return the means of neighbours along the first axis."""
    return 0.5 * (values[1:] + values[:-1])

r"""Linearization of a record of the filter-error method, at filtered states and parameters.

States (11): gusts north, east, down in a slow and a fast part :math:`g_1, g_2` [m/s]; errors of path
and attitude e that add to the air velocity, body axes y and z [m/s]; rates :math:`\omega` [rad/s]. With
the velocity v of the centre of gravity over the ground (body axes) as recorded, attitude R (NED to body),
steady wind w and error r of the position of the sensors,

.. math:: v_a = v - R (w + g_1 + g_2) - e - \omega \times r,

which `air_velocity` evaluates. The rates follow by one Runge-Kutta step of the equations of motion
(``_air_model.py``), the other states decay. Measurements are the nine sensors at the end of the step, from
the past alone (innovation), and with the recorded path (residual).

Variables s of the model are air velocity, rates, and errors of the coefficients C. A coefficient is the
sum of its derivatives times terms, such as alpha. By the chain rule a value h(s) has the slopes

.. math:: \frac{d h}{d z} = \frac{\partial h}{\partial s} \frac{d s}{d z}, \quad
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
    AIR_VELOCITY,
    BODY_RATES,
    COEFFICIENT_ERRORS,
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
from skdgp.estimation._kalman import Linearization
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

N_STATES = 11
SLOW_GUST = slice(0, 3)
FAST_GUST = slice(3, 6)
PATH_ERROR_Y = 6
PATH_ERROR_Z = 7
RATE_STATES = slice(8, 11)
"""Places of the states: two parts of the gust, errors of the path, rates."""
COEFFICIENT_CONSTANTS = ("servo_lag", "thrust_scale", "slipstream")
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

    def variable_slopes(
        self,
        attitude: Array,
        rates: Matrix,
        air_by_state: Array,
        of_coefficients: Array | float = 0.0,
    ) -> Array:
        """Return d variables of the model / d states and constants, (n, 12, N + c).

        They are zero by derivatives. ``of_coefficients`` (n, 6, 3) are slopes by `COEFFICIENT_CONSTANTS`.
        """
        slopes = np.zeros((len(rates), N_VARIABLES, self.constants.stop - self.n_derivatives))
        slopes[:, AIR_VELOCITY, :N_STATES] = air_by_state
        slopes[:, BODY_RATES, RATE_STATES] = np.eye(3)
        by_constants = slopes[..., N_STATES:]
        places = self.place_of_constants(*COEFFICIENT_CONSTANTS)
        by_constants[:, COEFFICIENT_ERRORS, places] = of_coefficients
        by_constants[:, AIR_VELOCITY, self.place_of_constants(*WINDS)] = -attitude
        by_constants[:, AIR_VELOCITY, self.place_of_constants(*ARM)] = -cross_matrix(rates)
        return slopes

    def chained(
        self, by_variables: Array, slopes: Array, terms: Matrix, instrument_terms: Matrix
    ) -> Array:
        """Return d h / d z (n, m, N + q) by the chain rule, from d h / d s (n, m, 12).

        ``slopes`` are d s / d states and constants of `variable_slopes`, ``terms`` (n, f) those of the
        derivatives.
        """
        values = np.empty((*by_variables.shape[:2], N_STATES + self.n_slopes))
        by_states_and_constants = by_variables @ slopes
        values[..., :N_STATES] = by_states_and_constants[..., :N_STATES]
        values[..., self.constants] = by_states_and_constants[..., N_STATES:]
        by_coefficients = by_variables[:, :, COEFFICIENT_ERRORS][:, :, self.rows]
        by_derivatives = values[..., N_STATES : self.constants.start]
        np.multiply(by_coefficients, terms[:, None, self.columns], out=by_derivatives)
        if self.by_instruments:
            by_instruments = values[..., self.constants.stop :]
            np.multiply(
                by_coefficients, instrument_terms[:, None, self.columns], out=by_instruments
            )
        return values


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
    by_state[:, :, SLOW_GUST] = -record.attitude
    by_state[:, :, FAST_GUST] = -record.attitude
    by_state[:, 1, PATH_ERROR_Y] = -1.0
    by_state[:, 2, PATH_ERROR_Z] = -1.0
    by_state[:, :, RATE_STATES] = cross_matrix(stacked(value, *ARM))
    steady = record.velocity - record.attitude @ stacked(value, *WINDS)
    return steady + matrix_vector(by_state, states), by_state


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
    # motion over each step
    end, by_start = expansion.predict()
    instrument_terms = expansion.instrument_terms(by_start, settings)
    step_slopes = expansion.step_slopes(end, by_start, instrument_terms)
    predicted = states[:-1] * expansion.remaining
    predicted[:, RATE_STATES] = end[:, BODY_RATES]
    transition = expansion.remaining[:, :, None] * np.eye(N_STATES)
    transition_slopes = np.zeros((len(end), N_STATES, layout.n_slopes))
    transition[:, RATE_STATES] = step_slopes[:, BODY_RATES, :N_STATES]
    transition_slopes[:, RATE_STATES] = step_slopes[:, BODY_RATES, N_STATES:]

    # two predictions of the readings at its end
    past = expansion.readings_of_past(end, step_slopes, instrument_terms)
    path = expansion.readings_of_path(end, predicted, instrument_terms)
    noise_slopes = past.by_variables @ expansion.end_variable_slopes(end)[..., :N_STATES]

    # their errors
    measured = record.measured[1:, record.sampled]
    is_sampled = np.isfinite(measured)
    not_sampled = 1e12  # variance [SI], whatever the noise of the sensor
    vibration = np.zeros((len(SENSORS), len(SENSORS)))
    vibration[INERTIAL_READINGS, INERTIAL_READINGS] = record.vibration
    innovation_states, innovation_slopes = _split(past.slopes)
    residual_states, residual_slopes = _split(path.slopes)
    return Linearization(
        states=states,
        predicted=predicted,
        transition=transition,
        transition_slopes=transition_slopes,
        innovation=np.where(is_sampled, measured - past.values, 0.0),
        innovation_states=innovation_states,
        innovation_noise=noise_slopes,
        innovation_slopes=innovation_slopes,
        residual=np.where(is_sampled, measured - path.values, 0.0),
        residual_states=residual_states,
        residual_slopes=residual_slopes,
        step=record.step,
        surface_noise=expansion.surface_noise(by_start),
        surface_reading_variance=expansion.surface_reading_variance(past.by_variables),
        missing=np.where(is_sampled, 0.0, not_sampled),
        vibration=vibration[np.ix_(record.sampled, record.sampled)],
        instrument_terms=_means(instrument_terms),
    )


class _Readings(NamedTuple):
    """Readings of the m sensors that are sampled, after each step, and their slopes."""

    values: Matrix  # (n - 1, m)
    by_variables: Array  # (n - 1, m, 12)
    slopes: Array  # (n - 1, m, N + q) by z


class _Expansion:
    """Model, inputs and motion of a record at filtered states (n, N) and parameters by name.

    `predict` and `step_slopes` predict the motion. Two predictions of the readings follow:
    `readings_of_past` at the end of this step, from the past alone, and `readings_of_path` at the
    recorded path.
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
        self.model = motion_model(record, layout, aircraft, value)
        logged = record.inputs
        surfaces, by_lag = servo_slopes(logged.surfaces, value["servo_lag"], record.median_step)
        thrust = logged.thrust * (1 + value["thrust_scale"])
        self.inputs = Inputs(surfaces, thrust, logged.density)
        self.end_inputs = self.inputs.part(slice(1, None))
        self.air, self.air_by_state = air_velocity(record, value, states)
        tau = self.model.relative_thrust(np.linalg.norm(self.air, axis=1), self.inputs)
        self.surface_effect = self.model.slipstream.effect(tau)  # (n, k)
        self.constant_slopes = self.model.constant_slopes(
            self.air, self.inputs, by_lag, logged.thrust
        )
        self.start = _variables(self.air, states[:, RATE_STATES])[:-1]
        # gusts and errors of the path decay, and the air velocity with them
        self.remaining = np.exp(-record.step[:, None] * decay)
        self.drift_by_state = -self.air_by_state[:-1] * decay

    def predict(self) -> tuple[Matrix, Array]:
        """Return the variables (n - 1, 12) after the step from each sample, and d end / d start (n - 1, 6, 12)."""
        drift = matrix_vector(self.drift_by_state, self.states[:-1])
        gravity = STANDARD_GRAVITY * self.record.attitude[:-1, :, 2]
        steps = self.record.step
        end, slopes = differentiated(
            lambda start: self.model.step(start, gravity, drift, self.inputs, steps), self.start
        )
        return _variables(end[:, AIR_VELOCITY], end[:, BODY_RATES]), slopes

    def instrument_terms(self, by_start: Array, settings: AirSettings) -> Matrix:
        """Return the terms (n, f) of the coefficients in the motion that surfaces cause about the mean one.

        It contains no gusts. The motion is damped to a correlation time of
        ``settings.response_time``, as the motion of an unstable aircraft would grow.
        """
        commanded = self._commanded()
        surfaces = commanded.surfaces
        delay = settings.response_delay
        late = np.concatenate([surfaces[:1]] * delay + [surfaces[: len(surfaces) - delay]])
        A = by_start[:, :, :6]
        growth = np.abs(np.linalg.eigvals(A.mean(axis=0))).max()
        A = A * np.exp(-self.record.median_step / settings.response_time) / max(growth, 1.0)
        B = by_start[:, :, COEFFICIENT_ERRORS] @ self.model.by_surfaces
        moved = (late - late.mean(axis=0)) * self.surface_effect
        motion = _motion(A, matrix_vector(B, _means(moved)))
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

    def step_slopes(self, end: Matrix, by_start: Array, instrument_terms: Matrix) -> Array:
        """Return d air velocity and rates after the step / d z, (n - 1, 6, N + q)."""
        # terms within a step are the mean of the terms at its ends
        terms = self.model.terms(self.start, self.inputs.part(slice(-1)))
        end_terms = self.model.terms(end, self.end_inputs)
        variables = self.layout.variable_slopes(
            self.record.attitude[:-1],
            self.start[:, BODY_RATES],
            self.air_by_state[:-1],
            _means(self.constant_slopes),
        )
        terms = 0.5 * (terms + end_terms)
        slopes = self.layout.chained(by_start, variables, terms, _means(instrument_terms))
        slopes[:, AIR_VELOCITY, :N_STATES] += self.record.step[:, None, None] * self.drift_by_state
        return slopes

    def readings_of_past(
        self, end: Matrix, step_slopes: Array, instrument_terms: Matrix
    ) -> _Readings:
        """Return the readings at the end of the step, from its start alone.

        Air velocity and rates there depend on z by ``step_slopes``, the coefficients by their terms at the end.
        """
        values, by_variables, by_constants = self._readings(end)
        by_coefficients = by_variables.copy()
        by_coefficients[..., :6] = 0.0
        slopes = self.end_slopes(end, by_coefficients, instrument_terms)
        slopes += by_variables[..., :6] @ step_slopes
        slopes[..., self.layout.constants] += by_constants
        return _Readings(values, by_variables, slopes)

    def readings_of_path(
        self, end: Matrix, predicted: Matrix, instrument_terms: Matrix
    ) -> _Readings:
        """Return the readings at the recorded path, with the predicted gusts and rates."""
        change = matrix_vector(self.air_by_state[1:], predicted - self.states[1:])
        variables = _variables(self.air[1:] + change, end[:, BODY_RATES])
        values, by_variables, by_constants = self._readings(variables)
        slopes = self.end_slopes(variables, by_variables, instrument_terms)
        slopes[..., self.layout.constants] += by_constants
        return _Readings(values, by_variables, slopes)

    def _readings(self, end: Matrix) -> tuple[Matrix, Array, Array]:
        """Return readings at variables (n - 1, 12), and their slopes by these and by the sensors' constants."""
        errors = SensorErrors.of(self.value)
        truth, by_variables = differentiated(lambda s: self.model.sensors(s, self.end_inputs), end)
        values = errors.readings(truth)
        layout = self.layout
        n_constants = layout.constants.stop - layout.constants.start
        by_constants = np.zeros((*values.shape, n_constants))
        by_constants[:, [*LEARNED_BIASES.values()], layout.place_of_constants(*LEARNED_BIASES)] = (
            1.0
        )
        (scale,) = layout.place_of_constants("airspeed_scale")
        by_constants[:, AIRSPEED, scale] = truth[:, AIRSPEED]
        arm = layout.place_of_constants(*ARM)
        by_constants[:, FORCE_READINGS, arm] = self.model.arm_slopes(end, self.end_inputs)
        by_variables = errors.scale[:, None] * by_variables
        sampled = self.record.sampled
        return values[:, sampled], by_variables[:, sampled], by_constants[:, sampled]

    def end_slopes(self, end: Matrix, by_variables: Array, instrument_terms: Matrix) -> Array:
        """Return d values / d z of the same sample, (n - 1, m, N + q), from d values / d variables."""
        terms = self.model.terms(end, self.end_inputs)
        slopes = self.end_variable_slopes(end)
        return self.layout.chained(by_variables, slopes, terms, instrument_terms[1:])

    def end_variable_slopes(self, end: Matrix) -> Array:
        """Return d variables / d states and constants of the same sample, (n - 1, 12, N + c)."""
        return self.layout.variable_slopes(
            self.record.attitude[1:],
            end[:, BODY_RATES],
            self.air_by_state[1:],
            self.constant_slopes[1:],
        )

    def surface_noise(self, by_start: Array) -> Array:
        """Return the covariance (n - 1, N, N) by surfaces that are off by their change in the step.

        Or by their error between samples of a slow clock.
        """
        jump = np.diff(self.inputs.surfaces, axis=0)
        error = np.where(self.record.periods > 0, _means(self.record.surface_errors), jump)
        error = error * _means(self.surface_effect)
        push = by_start[:, BODY_RATES, COEFFICIENT_ERRORS] @ self.model.by_surfaces * error[:, None]
        covariance = np.zeros((len(jump), N_STATES, N_STATES))
        covariance[:, RATE_STATES, RATE_STATES] = push @ push.mT
        return covariance

    def surface_reading_variance(self, by_end: Array) -> Matrix:
        """Return the variance of readings (n - 1, m) by the errors of surfaces between samples."""
        by_surfaces = by_end[..., COEFFICIENT_ERRORS] @ self.model.by_surfaces
        error = self.record.surface_errors[1:] * self.surface_effect[1:]
        return np.sum((by_surfaces * error[:, None]) ** 2, axis=-1)


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

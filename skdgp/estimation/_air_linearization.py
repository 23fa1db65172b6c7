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

from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.frames import STANDARD_GRAVITY, cross_matrix
from skdgp.dynamics import Aircraft
from skdgp.estimation._air_model import (
    AIR,
    ERRORS,
    RATES,
    AirMotionModel,
    Inputs,
    differentiated,
)
from skdgp.estimation._air_parameters import (
    ARM,
    OWN,
    PATH_ERRORS,
    SHARED,
    STATE_TERMS,
    WINDS,
    Gusts,
    stacked,
)
from skdgp.estimation._air_records import Record, servo_output, servo_slopes
from skdgp.estimation._kalman import Linearization, Noise
from skdgp.estimation._sensors import AIRSPEED, BIASED, FORCE, SensorErrors
from skdgp.estimation._settings import AIR_SETTINGS, AirSettings

N_STATES = 11
SLOW = slice(0, 3)
FAST = slice(3, 6)
PATH_Y = 6
PATH_Z = 7
TURN = slice(8, 11)
"""Places of the states: two parts of the gust, errors of the path, rates."""
NOT_SAMPLED = 1e12  # variance of a sensor without a sample, over its usual one
BIASES = {name: BIASED[name] for name in [*SHARED, *OWN] if name in BIASED}
"""Places of the biased among the sensors."""


class Layout(NamedTuple):
    """Places of the derivatives in the matrix (6, k) of the model, and among the parameters."""

    rows: Indices
    columns: Indices
    names: list[str]
    n_features: int

    @classmethod
    def of(cls, derivatives: list[str], surfaces: list[str]) -> Layout:
        """Return the layout of derivatives by name, such as CZ_alpha, which come first of a flight's parameters."""
        features = [*STATE_TERMS, *surfaces]
        rows, columns = [], []
        for name in derivatives:
            coefficient, term = name.split("_", 1)
            rows.append(COEFFICIENTS.index(coefficient))
            columns.append(features.index(term))
        names = [*derivatives, *SHARED, *OWN]
        return cls(np.array(rows), np.array(columns), names, len(features))

    @property
    def n_derivatives(self) -> int:
        """Number of derivatives."""
        return len(self.rows)

    @property
    def n_slopes(self) -> int:
        """Number of parameters, and of instruments of the derivatives, which follow them."""
        return len(self.names) + self.n_derivatives

    def place(self, *names: str) -> list[int]:
        """Return places among the parameters of a flight."""
        return [self.names.index(name) for name in names]

    def of_coefficient(self, name: str) -> Indices:
        """Return the places of the derivatives of a coefficient."""
        return np.flatnonzero(self.rows == COEFFICIENTS.index(name))

    def is_by(self, *terms: str) -> Mask:
        """Return whether each derivative is by one of the state's terms."""
        return np.isin(self.columns, [STATE_TERMS.index(name) for name in terms])

    def errors(self, terms: Matrix, response: Matrix, changes: Array) -> Array:
        """Return d coefficients / d parameters and instruments (n, 6, p), at given air velocity.

        From the terms (n, f), their values ``response`` in the motion that surfaces cause, and
        ``changes`` (n, 6, 2) by lag of the servos and scale of the thrust.
        """
        errors = np.zeros((len(terms), 6, self.n_slopes))
        place = np.arange(self.n_derivatives)
        errors[:, self.rows, place] = terms[:, self.columns]
        errors[:, self.rows, len(self.names) + place] = response[:, self.columns]
        errors[:, :, self.place("servo_lag", "thrust_scale")] = changes
        return errors

    def air_slopes(self, attitude: Array, rates: Matrix) -> Array:
        """Return d air velocity / d parameters (n, 3, p)."""
        slopes = np.zeros((len(rates), 3, self.n_slopes))
        slopes[:, :, self.place(*WINDS)] = -attitude
        slopes[:, :, self.place(*ARM)] = -cross_matrix(rates)
        return slopes

    def model(self, aircraft: Aircraft, value: Mapping[str, Any]) -> AirMotionModel:
        """Return the aircraft's equations of motion at parameters by name."""
        derivatives = np.zeros((6, self.n_features))
        names = self.names[: self.n_derivatives]
        derivatives[self.rows, self.columns] = [value[name] for name in names]
        return AirMotionModel(aircraft, derivatives, stacked(value, *ARM))


def air_noise(value: Mapping[str, Any], sampled: Mask, settings: AirSettings) -> Noise:
    """Return the noises at parameters by name, each (s,), of the sensors that are ``sampled`` (9,)."""
    gusts = Gusts.of(value)
    path_std = stacked(value, *PATH_ERRORS)
    path_time = np.full_like(path_std, settings.path_time)
    drive = stacked(value, "drive_p", "drive_q", "drive_r")
    std = np.concatenate([gusts.slow_std, gusts.fast_std, path_std], axis=-1)
    time = np.concatenate([gusts.slow_time, gusts.fast_time, path_time], axis=-1)
    start_rates = np.full_like(drive, settings.start_rate_variance)
    inertial = stacked(value, "ax", "ay", "az", "gyro", "gyro", "gyro")
    air = stacked(value, "airspeed", "vane", "vane")
    sensors = np.concatenate([inertial, air], axis=-1)
    return Noise(
        rate=np.concatenate([2 * std**2 / time, drive**2], axis=-1),  # of Gauss-Markov processes
        decay=np.concatenate([1 / time, np.zeros_like(drive)], axis=-1),
        surface=value["surface"] ** 2,
        sensor=sensors[..., sampled] ** 2,
        start=np.concatenate([std**2, start_rates], axis=-1),
    )


def air_velocity(record: Record, value: Mapping[str, Any], states: Matrix) -> tuple[Matrix, Array]:
    """Return the velocity relative to the air (n, 3), body axes, and its derivatives by the states (n, 3, N)."""
    by_state = np.zeros((len(states), 3, N_STATES))
    by_state[:, :, SLOW] = -record.attitude
    by_state[:, :, FAST] = -record.attitude
    by_state[:, 1, PATH_Y] = -1.0
    by_state[:, 2, PATH_Z] = -1.0
    by_state[:, :, TURN] = cross_matrix(stacked(value, *ARM))
    steady = record.velocity - record.attitude @ stacked(value, *WINDS)
    return steady + (by_state @ states[:, :, None])[..., 0], by_state


class _Point(NamedTuple):
    """Values of a function (n, k) at variables (n, 12) of the model, and its derivatives."""

    values: Matrix
    slopes: Array  # (n, k, 12)
    errors: Array  # (n, 6, parameters) d coefficients / d parameters and instruments
    variables: Matrix

    @property
    def air(self) -> Matrix:
        """Air velocity of a step's end."""
        return self.values[:, AIR]

    @property
    def rates(self) -> Matrix:
        """Rates of a step's end."""
        return self.values[:, RATES]


class _Expansion:
    """Aircraft, inputs and motion of a record at filtered states (n, N) and parameters by name."""

    def __init__(
        self,
        record: Record,
        layout: Layout,
        aircraft: Aircraft,
        value: Mapping[str, Any],
        states: Matrix,
        decay: Vector,
        settings: AirSettings,
    ) -> None:
        self.record = record
        self.layout = layout
        self.value = value
        self.states = states
        self.decay = decay
        self.settings = settings
        self.model = layout.model(aircraft, value)
        raw = record.inputs
        surfaces, by_lag = servo_slopes(raw.surfaces, value["servo_lag"], record.median_step)
        thrust = raw.thrust * (1 + value["thrust_scale"])
        self.inputs = Inputs(surfaces, thrust, raw.density)
        self.later = self.inputs.part(slice(1, None))
        self.air, self.air_by_state = air_velocity(record, value, states)
        self.changes = self.model.lag_and_thrust_slopes(self.air, raw, by_lag)

    def step(self) -> tuple[_Point, Matrix, Matrix]:
        """Return the step from the filtered states to the next samples, (n - 1, 6), and responses.

        The response (n, f) has the terms of the coefficients in the motion that surfaces cause. Its
        mean over each step (n - 1, f) comes last.
        """
        record, model, inputs = self.record, self.model, self.inputs
        variables = _variables(self.air, self.states[:, TURN])[:-1]
        gravity = STANDARD_GRAVITY * record.attitude[:-1, :, 2]
        # gusts and errors of the path decay, and the air velocity with them
        drift = -(self.air_by_state[:-1] * self.decay @ self.states[:-1, :, None])[..., 0]
        end, slopes = differentiated(
            lambda s: model.step(s, gravity, drift, inputs, record.step), variables
        )
        surfaces = self._commanded()
        response = _response(model, variables, slopes, surfaces, record, self.settings)
        # terms within a step are the mean of the terms at its ends
        terms = model.terms(variables[:, AIR], variables[:, RATES], inputs.surfaces[:-1])
        terms_at_end = model.terms(end[:, AIR], end[:, RATES], self.later.surfaces)
        mean_response = 0.5 * (response[1:] + response[:-1])
        mean_changes = 0.5 * (self.changes[1:] + self.changes[:-1])
        errors = self.layout.errors(0.5 * (terms_at_end + terms), mean_response, mean_changes)
        return _Point(end, slopes, errors, variables), response, mean_response

    def sensors(self, air: Matrix, rates: Matrix, response: Matrix) -> _Point:
        """Return the readings (n - 1, 9) at the end of each step."""
        variables = _variables(air, rates)
        truth, slopes = differentiated(lambda s: self.model.sensors(s, self.later), variables)
        sensors = SensorErrors.of(self.value)
        terms = self.model.terms(air, rates, self.later.surfaces)
        errors = self.layout.errors(terms, response[1:], self.changes[1:])
        readings = sensors.readings(truth)
        return _Point(readings, sensors.scale[:, None] * slopes, errors, variables)

    def sensor_slopes(self, point: _Point) -> Array:
        """Return derivatives (n - 1, 9, parameters and instruments) of readings by parameters of the sensors."""
        layout = self.layout
        slopes = np.zeros((*point.values.shape, layout.n_slopes))
        slopes[:, [*BIASES.values()], layout.place(*BIASES)] = 1.0
        (scale,) = layout.place("airspeed_scale")
        slopes[:, AIRSPEED, scale] = point.values[:, AIRSPEED] / (1 + self.value["airspeed_scale"])
        slopes[:, FORCE, layout.place(*ARM)] = self.model.arm_slopes(point.variables, self.later)
        return slopes

    def predicted(self, rates: Matrix) -> Matrix:
        """Return the states (n - 1, N) at the end of each step, with its rates."""
        predicted = self.states[:-1] * np.exp(-self.record.step[:, None] * self.decay)
        predicted[:, TURN] = rates
        return predicted

    def _commanded(self) -> Matrix:
        """Return the surfaces (n, k) without an autopilot's answers to gusts."""
        answers = self.record.answers
        if answers is None:
            return self.inputs.surfaces
        late = servo_output(answers, self.value["servo_lag"], self.record.median_step)
        return self.inputs.surfaces - late


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
    expansion = _Expansion(record, layout, aircraft, value, states, decay, settings)
    step = record.step[:, None]
    air_by_state = expansion.air_by_state
    air_by_parameters = layout.air_slopes(record.attitude, states[:, TURN])

    # the step from filtered states
    start, response, mean_response = expansion.step()
    end_by_states = _by_states(start, air_by_state[:-1])
    end_by_states[:, AIR] -= step[..., None] * air_by_state[:-1] * decay
    end_by_parameters = _by_parameters(start, air_by_parameters[:-1])
    transition = np.exp(-step * decay)[:, :, None] * np.eye(N_STATES)
    transition[:, TURN] = end_by_states[:, RATES]
    transition_slopes = np.zeros((len(step), N_STATES, layout.n_slopes))
    transition_slopes[:, TURN] = end_by_parameters[:, RATES]

    # sensors at its end, from the past alone
    past = expansion.sensors(start.air, start.rates, response)
    past_by_end = past.slopes[:, :, :6]
    past_by_errors = past.slopes[:, :, ERRORS] @ past.errors
    past_slopes = past_by_end @ end_by_parameters + past_by_errors + expansion.sensor_slopes(past)

    # and at the recorded path, with the predicted gusts
    predicted = expansion.predicted(start.rates)
    change = (air_by_state[1:] @ (predicted - states[1:])[..., None])[..., 0]
    sensed = expansion.sensors(expansion.air[1:] + change, start.rates, response)
    air_by_parameters = layout.air_slopes(record.attitude[1:], start.rates)
    known_slopes = _by_parameters(sensed, air_by_parameters) + expansion.sensor_slopes(sensed)

    measured = record.measured[1:]
    is_sampled = np.isfinite(measured)
    use = record.sampled
    return Linearization(
        states=states,
        predicted=predicted,
        transition=transition,
        transition_slopes=transition_slopes,
        innovation=np.where(is_sampled, measured - past.values, 0.0)[:, use],
        innovation_states=(past_by_end @ end_by_states)[:, use],
        innovation_noise=_by_states(past, air_by_state[1:])[:, use],
        innovation_slopes=past_slopes[:, use],
        residual=np.where(is_sampled, measured - sensed.values, 0.0)[:, use],
        residual_states=_by_states(sensed, air_by_state[1:])[:, use],
        residual_slopes=known_slopes[:, use],
        step=record.step,
        surface_noise=_surface_noise(start.slopes, expansion.model, expansion.inputs),
        weight=np.where(is_sampled, 1.0, NOT_SAMPLED)[:, use],
        response=mean_response,
    )


def _variables(air: Matrix, rates: Matrix) -> Matrix:
    """Return the variables of the model (n, 12), without errors of the coefficients."""
    return np.concatenate([air, rates, np.zeros((len(air), 6))], axis=1)


def _by_states(point: _Point, air_by_state: Array) -> Array:
    """Return derivatives (n, k, N) by the filter's states, by way of air velocity and rates."""
    by_states = point.slopes[:, :, AIR] @ air_by_state
    by_states[:, :, TURN] += point.slopes[:, :, RATES]
    return by_states


def _by_parameters(point: _Point, air_by_parameters: Array) -> Array:
    """Return derivatives (n, k, p) by parameters, by way of air velocity and coefficients."""
    by_air = point.slopes[:, :, AIR] @ air_by_parameters
    return by_air + point.slopes[:, :, ERRORS] @ point.errors


def _response(
    model: AirMotionModel,
    variables: Matrix,
    slopes: Array,
    surfaces: Matrix,
    record: Record,
    settings: AirSettings,
) -> Matrix:
    """Return the terms (n, f) of the coefficients in the motion that surfaces cause about the mean one.

    It contains no gusts. ``slopes`` (n - 1, 6, 12) are the derivatives of a step from ``variables``.
    The motion is damped to a correlation time of ``settings.response_time``, as the motion of an
    unstable aircraft would grow.
    """
    n = len(surfaces)
    delay = settings.response_delay
    late = np.concatenate([surfaces[:1]] * delay + [surfaces[: n - delay]])
    change = late - late.mean(axis=0)
    mean_change = 0.5 * (change[1:] + change[:-1])
    A = slopes[:, :, :6]
    B = slopes[:, :, ERRORS] @ model.by_surfaces
    push = (B @ mean_change[..., None])[..., 0]
    growth = np.abs(np.linalg.eigvals(A.mean(axis=0))).max()
    damping = np.exp(-record.median_step / settings.response_time)
    A = A * damping / max(growth, 1.0)
    motion = np.zeros((n, 6))
    for k in range(n - 1):
        motion[k + 1] = A[k] @ motion[k] + push[k]
    mean_air = variables[:, AIR].mean(axis=0)
    return model.terms(mean_air + motion[:, AIR], motion[:, RATES], late)


def _surface_noise(slopes: Array, model: AirMotionModel, inputs: Inputs) -> Array:
    """Return the covariance (n - 1, N, N) by surfaces that are off by their change in the step."""
    jump = np.diff(inputs.surfaces, axis=0)
    push = slopes[:, RATES, ERRORS] @ model.by_surfaces * jump[:, None]
    covariance = np.zeros((len(jump), N_STATES, N_STATES))
    covariance[:, TURN, TURN] = push @ push.mT
    return covariance

"""What a flight will teach before it is flown: standard errors of derivatives, of the function, of free flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.linalg import expm
from sklearn.pipeline import Pipeline

from skdgp._compute.typing import Array, Matrix
from skdgp._flight.channels import COEFFICIENTS, HAT, LENGTHS, rate_factor
from skdgp._flight.checks import check_columns, check_names, check_table
from skdgp._flight.clock import check_clock
from skdgp._flight.frames import euler_per_rotation
from skdgp._mechanics.jacobian import ANGLES, TURN, jacobian
from skdgp._mechanics.motion import Motion
from skdgp.dynamics import Aerodynamics, Aircraft, Trim, as_aerodynamics

UNKNOWN = 1e-10
"""Eigenvalue of the scaled Fisher information, over the largest, below which a combination is not
observed.
"""
NO_SHARE = 1e-6  # share of a regressor in such a combination below which it does not matter
SLOPE_STEP, ABSOLUTE_STEP = 0.02, 0.05
"""Half the interval of a posterior's slope: part of the range of a regressor, and absolute where it
has no range.
"""
FUNCTION, FREE_FLIGHT = "function", "free-flight"
WHOLE = (
    FUNCTION,
    FREE_FLIGHT,
)  # goals that are errors of the whole model rather than of one derivative
HORIZON = 2.0  # duration of free flight [s]
ROWS = 500  # number of rows drawn from the flown range of the regressors


@dataclass(frozen=True, eq=False)
class Information:
    r"""Fisher information about the derivatives of P named coefficients by d named regressors.

    ``fisher`` (P, m, m), :math:`F_i = X^T V_i^{-1} X`, is of the constant and the derivatives of
    each coefficient, and of its curvature if that is estimated too. Several flights have their sum:
    ``first + second``.
    """

    fisher: Array
    coefficients: tuple[str, ...]
    regressors: tuple[str, ...]

    def __add__(self, other: Information) -> Information:
        if (self.coefficients, self.regressors) != (other.coefficients, other.regressors):
            raise ValueError(
                f"Got information about {other.coefficients} by {other.regressors}, but expected "
                f"{self.coefficients} by {self.regressors}: give both flights the same regressors "
                f"and noise."
            )
        m = max(self.fisher.shape[1], other.fisher.shape[1])
        return replace(self, fisher=padded(self.fisher, m) + padded(other.fisher, m))

    @property
    def covariance(self) -> Array:
        """Covariance of the estimated derivatives, (P, d, d); infinite where the flight does not determine them."""
        return self.whole_covariance[:, 1:, 1:]

    @property
    def whole_covariance(self) -> Array:
        """Covariance of the constant and the derivatives, (P, 1 + d, 1 + d)."""
        n = 1 + len(self.regressors)
        return np.stack([_inverse(fisher)[:n, :n] for fisher in self.fisher])

    @property
    def std(self) -> pd.DataFrame:
        """Standard error of each derivative: coefficients by regressors."""
        values = np.sqrt(np.einsum("pdd->pd", self.covariance))
        return pd.DataFrame(values, index=self.coefficients, columns=self.regressors)

    def correlation(self, coefficient: str) -> pd.DataFrame:
        """Return the correlation between the errors of the derivatives of a coefficient, (d, d)."""
        check_names([coefficient], self.coefficients, "coefficients")
        covariance = self.covariance[self.coefficients.index(coefficient)]
        std = np.sqrt(np.diag(covariance))
        with np.errstate(invalid="ignore"):
            values = covariance / np.outer(std, std)
        return pd.DataFrame(values, index=self.regressors, columns=self.regressors)

    def confounded(self, least: float = 0.7) -> pd.DataFrame:
        """Return the pairs of regressors that the flight does not tell apart, the strongest correlation first.

        A table of ``coefficient``, ``first``, ``second``, ``correlation``; ``least`` is the least
        correlation, of either sign, between errors of derivatives. Those that are not determined at
        all are in no pair.
        """
        tables = {name: self.correlation(name) for name in self.coefficients}
        pairs = [*combinations(self.regressors, 2)]
        rows = [(name, a, b, table.loc[a, b]) for name, table in tables.items() for a, b in pairs]
        found = pd.DataFrame(rows, columns=["coefficient", "first", "second", "correlation"])
        found = found[found["correlation"].abs() >= least]
        return found.sort_values("correlation", key=np.abs, ascending=False, ignore_index=True)


def expected_information(
    flight: pd.DataFrame, aircraft: Aircraft, regressors: Sequence[str], noise: Mapping[str, float] | pd.DataFrame, *,
    about: ArrayLike | None = None,
) -> Information:  # fmt: skip
    r"""Return what a simulated flight will tell about the derivatives of coefficients.

    Each coefficient is linear in the regressors around a trim, :math:`y = \theta_0 + x^T \theta +
    e`. Its noise e is white, with an Ornstein-Uhlenbeck process added: the covariance of two rows
    is :math:`\sigma^2 \delta + \tau^2 e^{-|t - t'| / T}`, and zero between flights. :math:`F = X^T
    V^{-1} X` is computed from innovations of a Kalman filter (Klein & Morelli, Aircraft System
    Identification, 2006, chapters 5 and 9). Sensor errors of the regressors are not included.

    With ``about``, a coefficient also has unknown curvature: all products of two of x - ``about``.
    Errors are then those of the derivatives at this point. Far from the trim, derivatives of a
    linear function scatter with the curvature, more than predicted.

    Raises ValueError if the flight lacks a column or a value, its time does not increase, a
    coefficient has no noise, or nothing is asked.

    Parameters
    ----------
    flight : DataFrame
        As of :func:`skdgp.dynamics.simulate`; with a column ``flight`` several. Its rows are those
        of the log: white noise counts for each.
    aircraft : Aircraft
        For the lengths of non-dimensional rates.
    regressors : sequence of str
        Such as ``q_hat``, ``elevator``. ``alpha_dot`` and ``beta_dot`` are differentiated where the
        flight lacks them.
    noise : mapping of str to float, or DataFrame
        Standard deviation of the white noise of each coefficient; or a table with the coefficients
        as index and the columns ``white``, ``drift`` (tau) and ``memory`` (T [s]), such as
        `coefficient_noise` returns.
    about : array-like of shape (d,), optional
        Regressors of the trim. Add up information about the same point only.

    Returns
    -------
    Information

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skdgp.design import expected_information
    >>> from skdgp.dynamics import Aircraft
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.5)
    >>> time = np.arange(0, 10, 0.02)
    >>> flight = pd.DataFrame({"time": time, "alpha": 0.05 * np.sin(3 * time), "elevator": 0.05 * np.cos(3 * time)})
    >>> found = expected_information(flight, aircraft, ["alpha", "elevator"], {"Cm": 0.002})
    >>> found.std.round(4)
         alpha  elevator
    Cm  0.0025    0.0025
    """
    noise = noise_table(noise)
    check_columns(noise, ("white", "drift", "memory"), what="noise")
    check_columns(table := check_table(flight), ["time"])
    white, drift, memory = noise[["white", "drift", "memory"]].to_numpy(float).T
    if not (len(noise) and len(regressors)):
        raise ValueError(
            f"Got noise of {list(noise.index)} and regressors {list(regressors)}, but expected at "
            f"least one of each."
        )
    check_clock(table["time"], table.get("flight"))
    least = min(white.min(), drift.min())
    if not (
        np.isfinite(white + drift + memory).all()
        and least >= 0
        and min(white + drift) > 0
        and min(memory) > 0
    ):
        raise ValueError(
            f"Got the noise\n{noise}\nbut expected white >= 0 and drift >= 0, one of them > 0, "
            f"and memory > 0: a "
            "coefficient without noise would be known exactly."
        )
    parts = (
        [part for _, part in table.groupby("flight", sort=False, observed=True)]
        if "flight" in table
        else [table]
    )
    fisher: Any = 0.0
    for part in parts:
        X = np.column_stack([np.ones(len(part)), regressors_of(part, aircraft, regressors)])
        if about is not None:
            z, (first, second) = (
                X[:, 1:] - np.asarray(about, dtype=float),
                np.triu_indices(len(regressors)),
            )
            X = np.column_stack([X, z[:, first] * z[:, second]])
        if not np.isfinite(X).all():
            raise ValueError(
                "Got NaN or infinite regressors, but expected finite ones: leave out those rows."
            )
        whitened = _whitened(X, part["time"].to_numpy(float), white**2, drift**2, memory).swapaxes(
            0, 1
        )
        fisher = fisher + whitened.swapaxes(1, 2) @ whitened
    return Information(fisher, tuple(map(str, noise.index)), tuple(regressors))


def coefficient_noise(model: Any) -> pd.DataFrame:
    """Return the noise of coefficients that a fitted model has found: ``white``, ``drift`` and ``memory`` [s] of each.

    The first two are standard deviations. The model is a `DependentGPRegressor`, fitted with
    ``time`` to know the drift, or a pipeline that ends with it; one of
    :func:`skdgp.identification.identify` has the noise of its flights
    (:func:`skdgp.identification.flight_noise`). Raises ValueError if the model has no noise, or is
    not fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.design import coefficient_noise
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(size=(60, 1))
    >>> model = DependentGPRegressor(structure="trend").fit(X, 2 * X + 0.1 * rng.standard_normal((60, 1)))
    >>> coefficient_noise(model).round(1)
        white  drift  memory
    y0    0.1    0.0     1.0
    """
    if getattr(model, "noise_", None) is not None:
        return model.noise_
    regressor = model[-1] if isinstance(model, Pipeline) else model
    regressor = getattr(regressor, "estimator_", regressor)  # of a CalibratedRegressor
    if not hasattr(regressor, "noise_variance_"):
        raise ValueError(
            f"Got {type(regressor).__name__} without noise_variance_, but expected a fitted "
            f"DependentGPRegressor: fit "
            "it, or give the noise of each coefficient, such as noise={'Cm': 0.004}."
        )
    drift, memory = regressor.drift_variance_, regressor.drift_memory_
    total = regressor.noise_variance_ + regressor.misfit_variance_  # the drift contains misfit
    white, memory = np.sqrt(np.maximum(total - drift, 0.0)), np.where(drift > 0, memory, 1.0)
    columns = {"white": white, "drift": np.sqrt(drift), "memory": memory}
    return pd.DataFrame(columns, index=list(regressor.output_names_))


def noise_table(noise: Mapping[str, float] | pd.DataFrame) -> pd.DataFrame:
    """Return noise as a table; standard deviations by name are of white noise."""
    if isinstance(noise, pd.DataFrame):
        return noise
    return pd.DataFrame({"white": dict(noise), "drift": 0.0, "memory": 1.0})


def regressors_of(flight: pd.DataFrame, aircraft: Aircraft, names: Sequence[str]) -> Matrix:
    """Return the regressors (n, d) of one flight."""
    columns = []
    for name in names:
        channel = name if name in flight else name.removesuffix(HAT)
        is_slope = channel in ("alpha_dot", "beta_dot") and channel not in flight
        source = channel.removesuffix("_dot") if is_slope else channel
        length = LENGTHS.get(channel) if channel != name else None
        check_columns(flight, [source] if length is None else [source, "airspeed"])
        values = flight[source].to_numpy(float)
        if is_slope:
            values = np.gradient(values, flight["time"].to_numpy(float))
        if length is not None:
            values = values * rate_factor(
                channel, getattr(aircraft, length), flight["airspeed"].to_numpy(float)
            )
        columns.append(values)
    return np.stack(columns, axis=-1)


def _whitened(X: Matrix, time: Array, white: Array, drift: Array, memory: Array) -> Array:
    """Return V_i^(-1/2) X for the noise of each coefficient, (n, P, columns): scaled innovations of a Kalman filter."""
    found = np.empty((len(X), len(white), X.shape[1]))
    mean, variance = np.zeros((len(white), X.shape[1])), drift
    for k, row in enumerate(X):
        if k:
            kept = np.exp(-(time[k] - time[k - 1]) / memory)
            mean, variance = kept[:, None] * mean, kept**2 * variance + (1.0 - kept**2) * drift
        total = variance + white
        innovation = row - mean
        found[k] = innovation / np.sqrt(total)[:, None]
        mean = mean + (variance / total)[:, None] * innovation
        variance = variance * white / total
    return found


def padded(fisher: Array, m: int) -> Array:
    """Return information (P, m, m) that knows nothing of the last rows and columns."""
    return np.pad(fisher, [(0, 0), *[(0, m - fisher.shape[1])] * 2])


def scaled_inverse(matrices: Array, jitter: float = 0.0) -> Array:
    """Return the inverses of matrices (P, m, m), computed with a diagonal of ones, to which ``jitter`` is added."""
    scale = np.sqrt(np.maximum(np.einsum("pdd->pd", matrices), np.finfo(float).tiny))
    outer = scale[:, :, None] * scale[:, None]
    return np.linalg.inv(matrices / outer + jitter * np.eye(scale.shape[1])) / outer


def _inverse(fisher: Matrix) -> Matrix:
    """Return the inverse, with infinite variance of what is not determined."""
    seen = np.diag(fisher) > 0
    scale = np.sqrt(np.where(seen, np.diag(fisher), 1.0))
    values, vectors = np.linalg.eigh(fisher / np.outer(scale, scale))
    known = values > UNKNOWN * values[-1]
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T / np.outer(scale, scale)
    lost = ~seen | ((vectors[:, ~known] ** 2).sum(axis=1) > NO_SHARE)
    inverse[lost, lost] = np.inf
    return inverse


def posterior_information(
    model: Any, at: ArrayLike, coefficients: Sequence[str] = COEFFICIENTS
) -> Information:
    r"""Return what a model knows of its derivatives: the inverse of the covariance of their errors.

    The model is as for :func:`skdgp.dynamics.as_aerodynamics`, ``at`` are its regressors (d,).
    Standard errors are ``std_unmerged`` of :func:`skdgp.dynamics.stability_derivatives`. Raises
    ValueError if the model has no posterior covariance.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.design import posterior_information
    >>> from skdgp.dynamics import Aerodynamics
    >>> def covariance(X):        # of CX = a + b alpha, a and b with standard deviations 0.1 and 0.5
    ...     one = 0.01 + 0.25 * X @ X.T
    ...     return np.kron(np.eye(6), one)
    >>> model = Aerodynamics(lambda X: np.zeros((len(X), 6)), ["alpha"], covariance=covariance)
    >>> posterior_information(model, [0.0]).std.loc["Cm", "alpha"].round(3).item()
    0.5
    """
    aerodynamics = as_aerodynamics(model)
    at, d = np.asarray(at, dtype=float), len(aerodynamics.regressors)
    size = (
        np.zeros(d)
        if aerodynamics.limits is None
        else SLOPE_STEP * np.ptp(aerodynamics.limits, axis=0)
    )
    size = np.where(size > 0, size, ABSOLUTE_STEP)
    points = np.concatenate([at[None], at + np.diag(size), at - np.diag(size)])
    slopes = np.concatenate([np.zeros((d, 1)), np.diag(0.5 / size), -np.diag(0.5 / size)], axis=1)
    linear = np.concatenate([np.eye(1, 1 + 2 * d), slopes])
    linear[0] -= at @ slopes  # the constant of a coefficient that is linear in the regressors
    covariance = aerodynamics.covariance(points).reshape(6, 1 + 2 * d, 6, 1 + 2 * d)
    rows = [COEFFICIENTS.index(name) for name in coefficients]
    found = np.stack([linear @ covariance[k, :, k] @ linear.T for k in rows])
    errors = None if aerodynamics.slope_errors is None else aerodynamics.slope_errors(at[None])
    if errors is not None:
        of_slopes = np.concatenate([errors.random[0], errors.method[0]], axis=-1)[rows]  # (P, d, k)
        both = np.concatenate([-(at @ of_slopes)[:, None], of_slopes], axis=1)
        found += both @ both.swapaxes(1, 2)
    return Information(scaled_inverse(found, 1e-9), tuple(coefficients), aerodynamics.regressors)


def _derivatives(model: Aerodynamics, coefficients: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Return numbers of coefficient and regressor by name, such as ``Cm_q``."""
    short = [name.removesuffix(HAT) for name in model.regressors]
    return {
        f"{one}_{name}": (i, k)
        for i, one in enumerate(coefficients)
        for k, name in enumerate(short)
    }


def check_goal(
    goal: Sequence[str] | None, model: Aerodynamics, coefficients: Sequence[str]
) -> tuple[str, ...]:
    """Return the names of a goal, by default all derivatives; raise ValueError if the model cannot tell of them."""
    known = _derivatives(model, coefficients)
    names = (goal,) if isinstance(goal, str) else tuple(known if goal is None else goal)
    lacking = [name for name in names if name not in {*known, *WHOLE}]
    if lacking or not names or isinstance(goal, str):
        raise ValueError(
            f"Got the goal {lacking or goal!r}, but the model has the coefficients "
            f"{list(coefficients)} and the "
            f"regressors {list(model.regressors)}: give a list of {FUNCTION!r}, {FREE_FLIGHT!r} "
            f"or derivatives such as "
            f"{next(iter(known))!r}, or learn a model with that regressor."
        )
    still = (
        np.zeros(len(model.regressors), bool)
        if model.limits is None
        else np.ptp(model.limits, axis=0) == 0
    )
    for name in goal or ():
        if name in known and still[known[name][1]]:
            raise ValueError(
                f"Got the goal {name!r}, but {model.regressors[known[name][1]]} did not move in "
                f"the flights that the "
                "model was learned from, so it knows nothing of its effect: learn from a flight "
                "in which it moves, or "
                "ask for another goal."
            )
    return names


def goal_weights(
    names: Sequence[str], model: Aerodynamics, aircraft: Aircraft, trims: Sequence[Trim], coefficients: Sequence[str],
    thrust: Any,
) -> dict[str, Array]:  # fmt: skip
    r"""Return W (P, 1 + d, 1 + d) of each goal, whose error is the root of :math:`\sum_i \mathrm{tr}(W_i C_i)`.

    :math:`C_i` is the covariance of the constant and the slopes of coefficient i. Of a derivative W
    is one element. With the mean M of :math:`x x^T` over rows x = (1, regressors) of the flown
    envelope, :math:`\mathrm{tr}(M C_i)` is the mean variance of the coefficient. "function": its
    sum over coefficients, each in units of its spread over these rows, over P. "free-flight": the
    mean variance of alpha, beta, phi, theta [rad^2] after two seconds, by errors that stay as they
    are, through the linear model at the trims.
    """
    derivatives, found = _derivatives(model, coefficients), {}
    chosen = [COEFFICIENTS.index(one) for one in coefficients]
    for name in names:
        if name in derivatives:
            i, k = derivatives[name]
            found[name] = np.zeros((len(coefficients), *[1 + len(model.regressors)] * 2))
            found[name][i, 1 + k, 1 + k] = 1.0
            continue
        if model.limits is None:
            raise ValueError(
                f"Got the goal {name!r}, but the model does not say what was flown: give an "
                f"Aerodynamics with limits."
            )
        low, high = model.limits
        rows = low + (high - low) * np.random.default_rng(0).uniform(size=(ROWS, len(low)))
        x = np.column_stack([np.ones(ROWS), rows])
        if name == FUNCTION:
            spread = model(rows)[:, chosen].var(axis=0)
            share = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0) / len(
                chosen
            )
        else:
            share = np.mean(
                [_growth(model, aircraft, point, thrust)[chosen] for point in trims], axis=0
            )
        found[name] = share[:, None, None] * (x.T @ x) / ROWS
    return found


def _growth(model: Aerodynamics, aircraft: Aircraft, point: Trim, thrust: Any) -> Array:
    """Return the mean square of alpha, beta, phi, theta after `HORIZON` by a unit error of each coefficient, (6,)."""
    found = jacobian(Motion(model, aircraft, thrust=thrust), point.state, point.controls)
    system = np.zeros((18, 18))
    system[:12] = np.column_stack([found.state, found.coefficients])
    moved = expm(system * HORIZON)[:12, 12:]
    euler = euler_per_rotation(point.phi, point.theta) @ moved[TURN]
    angles = np.concatenate([found.outputs_state[ANGLES] @ moved, euler[:2]])
    return (angles**2).mean(axis=0)


def errors_of(information: Information, weights: Mapping[str, Array] | None = None) -> pd.Series:
    """Return standard errors by the names of derivatives, and of goals by their weights; inf: not determined."""
    errors, covariance = information.std, information.whole_covariance
    found = {
        f"{i}_{name.removesuffix(HAT)}": errors.loc[i, name]
        for i in errors.index
        for name in errors.columns
    }
    for name, weight in (weights or {}).items():
        found[name] = np.sqrt(np.sum(weight * np.where(weight == 0, 0.0, covariance)))
    return pd.Series(found, dtype=float)

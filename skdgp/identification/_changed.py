"""Whether an aircraft has changed since a model of it was learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import matmul_toeplitz
from scipy.signal import correlate
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch

from skdgp._compute.linalg import constant_columns
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, ELEVONS, HAT, MIRRORED, VANES
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification._flights import named_flights
from skdgp.identification._log_errors import dynamic_load
from skdgp.identification._model_file import options_of
from skdgp.identification._pipeline import (
    FlightPipeline,
    flight_regressors,
    reconstruction_of,
    regressor_names,
)
from skdgp.identification._prepare import usable_flights_of_model
from skdgp.inference import bias_ratio, training_inputs

WHOLE = "whole"


@dataclass(frozen=True)
class ChangeSettings:
    """Settings of the test for a change, chosen."""

    # blocks of a flight that are wanted, and at least so many more than there are weights
    n_blocks: int = 60
    spare_blocks: int = 12
    # length of a block in autocorrelation times of the residuals, if enough blocks remain
    block_times: float = 4.0
    # shortest block in autocorrelation times; in a shorter flight nothing can be told
    fewest_times: float = 1.0
    # shortest flight [s]: of unchanged aircraft 12 % raise an alarm in 4 s, 5 % in 6 s
    fewest_seconds: float = 5.0
    # lag at which the window of the autocovariances ends, as a fraction of the flight, a guess
    longest_lag: float = 0.25
    # standard deviations of constant errors that differ from flight to flight, of accelerometers [m/s^2] and
    # vanes [rad]; guesses
    accelerometer_offset: float = 0.05
    vane_offset: float = 0.005
    # rows at which the covariance of the function is evaluated
    n_rows: int = 100
    # variance of the unknown correlation of the errors of two longitudinal, or two lateral
    # regressors, uniform between -1 and 1
    correlation_variance: float = 1 / 3
    # the same of a longitudinal and a lateral regressor, chosen on one aircraft
    across_variance: float = 0.03
    # p-value below which the summary says that the aircraft has changed
    level: float = 0.05


SETTINGS = ChangeSettings()


@dataclass(frozen=True)
class Changes:
    """Test of flights for a change of the aircraft, by `changed`.

    Attributes
    ----------
    p_values : DataFrame
        By flight: of CX CY CZ Cl Cm Cn and of the whole. Probability of residuals at least as far
        from zero if the aircraft has not changed; NaN where the flight is too short.
    derivatives : DataFrame
        By flight and derivative such as Cm_alpha: the likely ``change`` and its ``std``. The change
        of a coefficient itself, at the mean of the training flights, has its name alone.
    level : float
        p-value below which the summary says that the aircraft has changed.
    """

    p_values: pd.DataFrame
    derivatives: pd.DataFrame
    level: float = SETTINGS.level

    def largest(self, flight: str, n: int = 3) -> pd.DataFrame:
        """Return the n changes of a flight that are most standard deviations from zero."""
        table: Any = self.derivatives.loc[flight]
        deviations = (table["change"] / table["std"]).abs()
        return table.loc[deviations.sort_values(ascending=False).index[:n]]

    def summary(self) -> list[str]:
        """Return a line for each flight."""
        lines = []
        for flight, p in self.p_values.iterrows():
            whole = p[WHOLE]
            if not np.isfinite(whole):
                lines.append(f"flight {flight}: too short to tell whether the aircraft has changed")
                continue
            text = f"flight {flight}: no change of the aircraft found (p = {whole:.2g})"
            if whole < self.level:
                parts = []
                for name, row in self.largest(str(flight)).iterrows():
                    parts.append(f"{name} {row['change']:+.2g} +- {row['std']:.1g}")
                text = f"flight {flight}: the aircraft has changed (p = {whole:.2g}): likely "
                text += ", ".join(parts) + ", +- one standard deviation"
            lines.append(text)
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        derivatives = {}
        for flight in self.p_values.index:
            derivatives[flight] = self.derivatives.loc[flight].to_dict("index")
        return {"p_values": self.p_values.to_dict("index"), "derivatives": derivatives}


def changed(model: Bunch, flights: Any, *, settings: ChangeSettings = SETTINGS) -> Changes:
    r"""Return whether the aircraft of a model has changed in new flights.

    The residuals r of a coefficient, measured without smoothing less predicted, are fitted by least
    squares on the regressors, Q = (1, x): the weights :math:`w = G Q^T r`, :math:`G = (Q^T Q)^{-1}`, are the
    likely change of its derivatives. Without a change their covariance is

    .. math:: C = \frac{C_1 + C_2}{2} + G Q^T K Q G, \quad C_1 = \frac{B - 1}{B} \sum_b w_b w_b^T, \quad
              C_2 = G Q^T R Q G, \quad w_b = G (I - Q_b^T Q_b G)^{-1} Q_b^T e_b.

    C_1 is the jackknife over B blocks of the flight, which are longer than the residuals e of this
    fit are correlated (Bell & McCaffrey 2002): rougher air widens it. It is no estimate of a weight
    that a single block determines, as of a control that moves once, since the fit leaves no residual
    there. C_2 is the covariance for errors with the autocovariance R of e, whatever the regressors,
    with Bartlett's window (Newey & West 1987). K is the uncertainty of the function, in which the
    bias of the fit is replaced. Errors of the regressors bias the slopes of least squares. With the
    covariance :math:`S_0` of the regressors in the fit, and S in the flight, and the covariance c of
    the regressors with the errors, which is the same in both, the bias of the flight differs by

    .. math:: a = (S^{-1} - S_0^{-1})\, c, \quad c_k = \sum_j \rho_{jk} s_j s_k J_j,

    which is zero in flights with the same motion, and large in gentler ones (Fuller 1987,
    section 1.1). The errors have the standard deviations s, and J are the slopes. How far a filter
    makes the errors of one regressor correlate with the estimate of another, :math:`\rho_{jk}`, is
    unknown, and independent for each k; :math:`\rho_{jj}` is 1 of a sensor without a filter, and 0 of
    an optimal smoother. Between a longitudinal and a lateral regressor it is small, as it changes
    its sign in the mirrored flight, and the equations of motion do not.

    A model learns from every m-th row of its flights. Where errors stand at certain times, such as
    those of a surface's timing at the steps of an input, its weights depend on which rows these are.
    C therefore also has the covariance of the weights by every m-th row of the flight, from each first
    one on, about those by all, as far as their variance exceeds the one by chance.

    Accelerometers and vanes have constant errors that differ from flight to flight, of standard
    deviations ``settings.accelerometer_offset`` and ``settings.vane_offset``. C has their effect on the
    weights.

    With k weights, :math:`w^T C^{-1} w\, (\nu - k + 1) / (\nu k)` is compared with
    :math:`F(k, \nu - k + 1)`. The first part of C has the degrees of freedom of its blocks, which
    are few if few blocks hold the motion (Pustejovsky & Tipton 2018); those of C follow from the
    fraction M of C that is the first part, as K is no estimate from blocks (Krishnamoorthy & Yu 2004):

    .. math:: \nu_1 = \frac{k + k^2}{\sum_b \mathrm{tr}\, T_b^2 + (\mathrm{tr}\, T_b)^2}, \quad
              T_b = Q_b^T Q_b G, \quad
              \nu = \nu_1 \frac{k + k^2}{\mathrm{tr}\, M^2 + (\mathrm{tr}\, M)^2}.

    Where :math:`\nu` is at most k - 1, or the flight lasts less than ``settings.fewest_seconds``, it
    is too short: errors that last longer do not show in it.

    The p-values of the coefficients are combined into the whole by Simes' test, which allows for
    positive dependence (Simes 1986).

    A weight of a regressor that did not move in the fit is left out, as its slope was not learned; so
    is the mean where such a regressor is held at another value.

    Raises ValueError as `validate` does.

    Parameters
    ----------
    model : Bunch
        As of :func:`load_model`.
    flights : as of :func:`identify`
        Flights that the model did not learn from.
    settings : ChangeSettings

    Returns
    -------
    Changes
    """
    options = options_of(model)
    named = named_flights(flights, servos=options.get("servos"))
    usable = usable_flights_of_model(model.pipeline, named, model.aircraft)
    predicted = {}
    for name, flight in usable.items():
        X, noise_ratio = flight_regressors(model.pipeline, flight)
        mean = model.pipeline.mean_of_rows(X, noise_ratio)
        predicted[name] = PredictedFlight(model.pipeline.corrected(flight.table), X, mean)
    return changes_in_flights(model.pipeline, predicted, model.aircraft, options, settings)


class PredictedFlight(NamedTuple):
    """A flight and what a model predicts of it."""

    table: pd.DataFrame  # of the corrected channels
    regressors: Matrix  # (n, d) of the last step
    mean: Matrix  # (n, 6) predicted coefficients


def changes_in_flights(
    pipeline: FlightPipeline,
    flights: Mapping[str, PredictedFlight],
    aircraft: Aircraft,
    options: Mapping[str, Any],
    settings: ChangeSettings = SETTINGS,
) -> Changes:
    """Return the changes that predicted flights show, see `changed`; ``options`` are those of the model."""
    residuals = {}
    is_long = {}
    for name, (table, X, mean) in flights.items():
        time = table["time"].to_numpy(float)
        is_long[name] = time[-1] - time[0] >= settings.fewest_seconds
        residuals[name] = FlightResiduals(
            X,
            residuals_without_smoothing(table, mean, aircraft, options),
            stride=_stride(pipeline, time),
            by_acceleration=aircraft.mass / dynamic_load(table, aircraft),
        )
    changes = changes_of(pipeline, residuals, settings)
    return replace(changes, p_values=changes.p_values.where(pd.Series(is_long), axis=0))


class FlightResiduals(NamedTuple):
    """Residuals of a flight, and what their errors depend on.

    Attributes
    ----------
    regressors : ndarray (n, d)
        Of the last step of the model.
    residuals : ndarray (n, 6)
        Measured coefficients, not smoothed, less predicted ones; NaN where unknown.
    stride : int
        Interval of the rows of the fit, in rows of the flight.
    by_acceleration : ndarray (n,) or None
        Change of the force coefficients by an acceleration, m / (qbar S) [s^2/m]. None: accelerometers
        have no constant errors.
    """

    regressors: Matrix
    residuals: Matrix
    stride: int = 1
    by_acceleration: Vector | None = None

    def measured(self) -> FlightResiduals:
        """Return the rows whose coefficients are all known."""
        is_measured = np.isfinite(self.residuals).all(axis=1)
        by_acceleration = self.by_acceleration
        if by_acceleration is not None:
            by_acceleration = by_acceleration[is_measured]
        return self._replace(
            regressors=self.regressors[is_measured],
            residuals=self.residuals[is_measured],
            by_acceleration=by_acceleration,
        )


def changes_of(
    pipeline: Pipeline,
    flights: Mapping[str, FlightResiduals],
    settings: ChangeSettings = SETTINGS,
) -> Changes:
    """Return the changes that the residuals of flights show, see `changed`.

    Parameters
    ----------
    pipeline : Pipeline
    flights : mapping of str to FlightResiduals
    settings : ChangeSettings

    Returns
    -------
    Changes
    """
    p_values = {}
    tables = {}
    spread = _covariance_spread(pipeline, settings)
    for name, given in flights.items():
        flight = given.measured()
        X = flight.regressors
        of_model = _function_covariance(pipeline[-1], X, spread, settings)
        of_model = of_model + _offset_covariance(pipeline, X, flight.by_acceleration, settings)
        fits = [flight_weights(X, r, settings, flight.stride) for r in flight.residuals.T]
        learned = _learned_weights(pipeline, X)
        p_values[name] = _p_values(fits, of_model, learned)
        tables[name] = _derivative_changes(pipeline, fits, of_model, learned)
    return Changes(
        pd.DataFrame.from_dict(p_values, orient="index"),
        pd.concat(tables, names=["flight", "derivative"]),
        settings.level,
    )


def _learned_weights(pipeline: Pipeline, X: Matrix) -> Indices:
    """Return the places of the weights of (1, x) that a model knows, of a flight X (n, d).

    An unknown effect that is constant in the flight moves the mean.
    """
    trained = training_inputs(pipeline[-1].posterior_)
    is_constant = constant_columns(trained)
    is_elsewhere = is_constant & constant_columns(X) & ~np.isclose(X[0], trained[0])
    return np.flatnonzero(np.append(not is_elsewhere.any(), ~is_constant))


def _derivative_changes(
    pipeline: Pipeline, fits: Sequence[FlightWeights], of_model: Array, learned: Indices
) -> pd.DataFrame:
    """Return ``change`` and ``std`` of the learned derivatives by name, from the weights of each coefficient."""
    scale = np.append(1.0, pipeline["standardscaler"].scale_)[learned]
    terms = ["", *(f"_{name.removesuffix(HAT)}" for name in regressor_names(pipeline))]
    tables = []
    for coefficient, fit, uncertainty in zip(COEFFICIENTS, fits, of_model, strict=True):
        std = np.sqrt(np.diag(fit.covariance + fit.of_stride + uncertainty)[learned])
        names = [f"{coefficient}{terms[k]}" for k in learned]
        columns = {"change": fit.weights[learned] / scale, "std": std / scale}
        tables.append(pd.DataFrame(columns, index=names))
    return pd.concat(tables)


def _p_values(fits: Sequence[FlightWeights], of_model: Array, learned: Indices) -> dict[str, float]:
    """Return the p-values of the coefficients and of the whole."""
    p_values = {}
    for coefficient, fit, uncertainty in zip(COEFFICIENTS, fits, of_model, strict=True):
        among_learned = (uncertainty + fit.of_stride)[np.ix_(learned, learned)]
        p_values[coefficient] = _p_value(fit, learned, among_learned)
    p_values[WHOLE] = combined(list(p_values.values()))
    return p_values


def _stride(pipeline: FlightPipeline, time: Vector) -> int:
    """Return the interval of the rows of the fit, in rows of a flight, at least 1."""
    if pipeline.seconds_ is None or len(time) < 2:
        return 1
    interval = pipeline.seconds_ / len(training_inputs(pipeline[-1].posterior_))
    return max(1, round(interval / float(np.median(np.diff(time)))))


def residuals_without_smoothing(
    table: pd.DataFrame, mean: Matrix, aircraft: Aircraft, options: Mapping[str, Any]
) -> Matrix:
    """Return measured less predicted coefficients (n, 6) of a flight, with all noise.

    A smoother that depends on the flight takes more signal from a gentle one.
    """
    loads = {name: options[name] for name in ("thrust", "external_forces")}
    measured = aerodynamic_coefficients(table, aircraft, cutoff=None, **loads)
    return measured.to_numpy() - mean


def _terms(X: Matrix) -> Matrix:
    """Return Q = (1, x), (n, d + 1)."""
    return np.column_stack([np.ones(len(X)), X])


def _error_variances(pipeline: Pipeline) -> Vector:
    """Return the variances (d,) of the errors of the regressors of the last step.

    These are learned from the residuals. Angles that a filter derived from the forces agree with
    the residuals, so there its own variances count, the larger ones.
    """
    variances = np.diag(pipeline[-1].input_covariance_)
    reconstruction = reconstruction_of(pipeline)
    if reconstruction is None or reconstruction.air_motion_ is None:
        return variances
    air = reconstruction.air_motion_.air.mean()
    std = np.array([air.get(f"{name}_std", 0.0) for name in regressor_names(pipeline)])
    return np.maximum(variances, (std / pipeline["standardscaler"].scale_) ** 2)


def _covariance_spread(pipeline: Pipeline, settings: ChangeSettings) -> Matrix:
    """Return the variances (d, d) of the unknown covariances rho_jk s_j s_k of errors and estimates."""
    names = [str(name).removesuffix(HAT) for name in regressor_names(pipeline)]
    is_lateral = np.array([name in MIRRORED for name in names])
    is_elevon = np.array([name in ELEVONS for name in names])  # moves in both planes
    is_across = is_lateral[:, None] != is_lateral
    is_across &= ~(is_elevon[:, None] | is_elevon)
    spread = np.where(is_across, settings.across_variance, settings.correlation_variance)
    np.fill_diagonal(spread, 1.0)
    variances = _error_variances(pipeline)
    return spread * variances[:, None] * variances


def _function_covariance(
    regressor: DependentGPRegressor, X: Matrix, spread: Matrix, settings: ChangeSettings
) -> Array:
    """Return G Q^T K Q G of each output, (P, d + 1, d + 1), from evenly spaced rows of X (n, d)."""
    rows = _even_rows(X, settings)
    n_rows = len(rows)
    mean, cov = regressor.predict(X[rows], return_cov=True, include_input_noise=False)
    n_outputs = mean.shape[1]
    blocks = cov.reshape(n_outputs, n_rows, n_outputs, n_rows)
    in_fit, further = _biases(regressor, X, rows, spread)
    fitting = np.linalg.pinv(_terms(X[rows]))  # G Q^T
    covariances = []
    for i in range(n_outputs):
        # the function's uncertainty includes the bias of the fit
        K = blocks[i, :, i] - in_fit[..., i].T @ in_fit[..., i]
        K = K + further[..., i].T @ further[..., i]
        covariances.append(fitting @ K @ fitting.T)
    return np.stack(covariances)


def _even_rows(X: Matrix, settings: ChangeSettings) -> Indices:
    """Return at most ``settings.n_rows`` evenly spaced rows of X."""
    return np.linspace(0, len(X) - 1, min(settings.n_rows, len(X))).astype(int)


def _offset_covariance(
    pipeline: Pipeline, X: Matrix, by_acceleration: Vector | None, settings: ChangeSettings
) -> Array:
    """Return the covariance of the weights by constant errors of vanes and accelerometers, (P, d + 1, d + 1).

    An error of a vane moves the prediction by the slopes at each row of X (n, d), one of an
    accelerometer moves a force coefficient by the slope ``by_acceleration`` (n,) [s^2/m].
    """
    rows = _even_rows(X, settings)
    slopes = pipeline[-1].predict_gradient(X[rows])
    n_outputs = slopes.shape[1]
    scale = pipeline["standardscaler"].scale_
    effects = []
    for k, name in enumerate(map(str, regressor_names(pipeline))):
        if name in VANES:
            effects.append(slopes[:, :, k] * settings.vane_offset / scale[k])
    if by_acceleration is not None:
        for axis in range(3):
            effect = np.zeros((len(rows), n_outputs))
            effect[:, axis] = settings.accelerometer_offset * by_acceleration[rows]
            effects.append(effect)
    fitting = np.linalg.pinv(_terms(X[rows]))  # G Q^T
    covariance = np.zeros((n_outputs, len(fitting), len(fitting)))
    for effect in effects:
        weights = (fitting @ effect).T
        covariance += weights[:, :, None] * weights[:, None, :]
    return covariance


def _biases(
    regressor: DependentGPRegressor, X: Matrix, rows: Indices, spread: Matrix
) -> tuple[Array, Array]:
    """Return the biases of the fit and the further ones a of a flight X (n, d), (J, n_rows, P) and (d, n_rows, P).

    A bias of slopes turns the function about the mean of the regressors.
    """
    errors = regressor.function_errors()
    if errors is None:
        nothing = np.zeros((0, len(rows), len(regressor.scale_)))
        return nothing, nothing
    in_fit = (X[rows] - errors.centre) @ errors.method[:, 1:]
    J = regressor.predict_gradient(errors.centre[None])[0]
    # standard deviations (P, d) of the covariance of each regressor with the errors
    c = np.sqrt(J**2 @ spread)
    X_fit = training_inputs(regressor.posterior_)
    inverse = np.linalg.pinv(np.atleast_2d(np.cov(X_fit.T)), hermitian=True)
    slopes = np.einsum("jk,ik->kji", inverse, c)
    further = bias_ratio(X_fit, X) @ slopes - slopes
    return in_fit, (X[rows] - X.mean(axis=0)) @ further


class FlightWeights(NamedTuple):
    """Weights of least squares in a flight."""

    #: (d + 1,)
    weights: Vector
    #: Covariance, (d + 1, d + 1)
    covariance: Matrix
    #: Covariance of the difference to weights from rows of a stride only, (d + 1, d + 1)
    of_stride: Matrix
    #: Degrees of freedom of the covariance; 0, and the covariance NaN, if the flight is too short
    freedom: float


def flight_weights(
    X: Matrix, residual: Vector, settings: ChangeSettings = SETTINGS, stride: int = 1
) -> FlightWeights:
    """Return the weights of least squares on the regressors (n, d).

    The flight is too short if its blocks are shorter than the residuals are correlated.
    """
    Q = _terms(X)
    n, k = Q.shape
    G = np.asarray(np.linalg.pinv(Q.T @ Q, hermitian=True), dtype=float)
    weights = G @ (Q.T @ residual)
    e = residual - Q @ weights
    # a change that follows a slow motion makes the residual last longer, not e
    correlated = min(autocorrelation_time(residual), autocorrelation_time(e))
    wanted = max(settings.block_times * correlated, n / settings.n_blocks)
    length = min(wanted, n / (k + settings.spare_blocks))
    if length < max(settings.fewest_times * correlated, 2.0):
        unknown = np.full((k, k), np.nan)
        return FlightWeights(weights, unknown, unknown, 0.0)
    blocks = np.array_split(np.arange(n), int(n / length))
    by_blocks = _jackknife(Q, e, G, blocks)
    by_correlation = _stationary(Q, e, G, settings)
    covariance = (by_blocks + by_correlation) / 2
    of_stride = _stride_covariance(Q, e, G, stride)
    return FlightWeights(weights, covariance, of_stride, _freedom(Q, G, blocks))


def _jackknife(Q: Matrix, e: Vector, G: Matrix, blocks: Sequence[Indices]) -> Matrix:
    """Return the covariance of the weights by their changes w_b without each block."""
    errors = []
    for rows in blocks:
        left_out = np.eye(len(G)) - Q[rows].T @ Q[rows] @ G
        score = Q[rows].T @ e[rows]
        errors.append(G @ (np.linalg.pinv(left_out) @ score))
    w = np.array(errors)
    n_blocks = len(blocks)
    return w.T @ w * (n_blocks - 1) / n_blocks


def _stationary(Q: Matrix, e: Vector, G: Matrix, settings: ChangeSettings) -> Matrix:
    """Return the covariance G Q^T R Q G of the weights, for errors of the autocovariance of e (n,)."""
    n, k = Q.shape
    autocovariance = correlate(e, e, method="fft")[n - 1 :] / (n - k)
    lags = np.arange(n) / (settings.longest_lag * n)
    window = np.maximum(1 - lags, 0.0)
    return G @ Q.T @ matmul_toeplitz(autocovariance * window, Q) @ G


def _stride_covariance(Q: Matrix, e: Vector, G: Matrix, stride: int) -> Matrix:
    """Return the covariance of the weights by rows of a stride about those by all, beyond chance.

    White errors make the chance, which the uncertainty of the function has.
    """
    n, k = Q.shape
    errors = []
    for first in range(stride):
        rows = slice(first, None, stride)
        errors.append(stride * G @ (Q[rows].T @ e[rows]))
    w = np.array(errors)
    covariance = w.T @ w / stride
    variance = np.diag(covariance)
    by_chance = (stride - 1) * (e @ e) / (n - k) * np.diag(G)
    beyond_chance = np.maximum(variance - by_chance, 0.0)
    fraction = np.divide(beyond_chance, variance, out=np.zeros(k), where=variance > 0)
    scale = np.sqrt(fraction)
    return covariance * scale[:, None] * scale


def _freedom(Q: Matrix, G: Matrix, blocks: Sequence[Indices]) -> float:
    """Return the degrees of freedom of a covariance from blocks, (k + k^2) / sum_b (tr T_b^2 + (tr T_b)^2)."""
    squares = 0.0
    rank = 0.0
    for rows in blocks:
        T = Q[rows].T @ Q[rows] @ G
        rank += np.trace(T)
        squares += np.trace(T @ T) + np.trace(T) ** 2
    return float((rank + rank**2) / squares)


def _p_value(flight: FlightWeights, learned: Indices, uncertainty: Matrix) -> float:
    """Return the probability of the ``learned`` weights as far from zero, NaN if the flight is too short."""
    if flight.freedom == 0:
        return float("nan")
    weights = flight.weights[learned]
    scatter = flight.covariance[np.ix_(learned, learned)]
    k = len(weights)
    inverse = np.linalg.pinv(scatter + uncertainty, hermitian=True)
    fraction = scatter @ inverse
    # of Krishnamoorthy & Yu 2004; those of the flight if the scatter is all
    estimated = np.trace(fraction @ fraction) + np.trace(fraction) ** 2
    freedom = flight.freedom * (k + k**2) / estimated
    if freedom <= k - 1:
        return float("nan")
    statistic = weights @ inverse @ weights * (freedom - k + 1) / (freedom * k)
    return float(f_distribution.sf(statistic, k, freedom - k + 1))


def combined(p_values: Sequence[float]) -> float:
    """Return the p-value by Simes' test of those that are known, min n p_(k) / k, NaN if none is."""
    known = [p for p in p_values if np.isfinite(p)]
    return float(false_discovery_control(known).min()) if known else float("nan")

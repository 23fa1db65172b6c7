"""Stability derivatives: coefficients and their slopes at a flight, with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import CHANNELS, COEFFICIENTS, LENGTHS, rate_factor
from skdgp.dynamics._aerodynamics import Aerodynamics, Coefficients, as_aerodynamics
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._linearize import check_paths, flight_point
from skdgp.dynamics._motion import Instant, Motion, check_settled
from skdgp.dynamics._size_errors import errors_of_log, errors_of_sizes
from skdgp.dynamics._trim import Trim
from skdgp.dynamics._unsteady import ROTATION_OF, std_of_biases, unsteady_terms

ROWS = (*COEFFICIENTS, "CL", "CD")
LIFT = ROWS.index("CL")
DRAG = ROWS.index("CD")


def stability_derivatives(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    point: Trim | Sequence[Trim] | ArrayLike,
    controls: Mapping[str, ArrayLike] | None = None,
    *,
    n_paths: int = 200,
    random_state: Seed = 0,
    thrust: str | None = "auto",
    air: Any = None,
    added: ArrayLike | None = None,
    perturbation: str | None = "flown",
) -> pd.DataFrame:
    r"""Return the coefficients and their derivatives at a flight, or at several, with their standard deviations.

    Derivatives by rates are by the non-dimensional ones, :math:`pb/2V`, :math:`qc/2V`,
    :math:`rb/2V`, :math:`\dot\alpha c/2V`, :math:`\dot\beta b/2V`, whatever regressors the model
    has (Stevens, Lewis & Johnson 2016, section 2.3). Lift and drag are

    .. math:: C_L = C_X \sin\alpha - C_Z \cos\alpha, \quad C_D = -C_X \cos\alpha - C_Z \sin\alpha, \quad
        C_{L_\alpha} = C_{X_\alpha} \sin\alpha - C_{Z_\alpha} \cos\alpha - C_D.

    Other coefficients and rates are in body axes. Raises ValueError if the model is not defined
    there, or rows are added to a model that does not hold its own.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    point : Trim, array-like of shape (13,), or several
        Trims, or states (`STATE_NAMES`) with their ``controls``.
    controls : mapping of str to float or array-like of shape (n,), optional
    n_paths : int
        Number of posterior functions that give the standard deviations, each with a relative error
        of 1 / sqrt(2 n_paths); 0: no deviations. A model without a posterior has none.
    random_state : int, RandomState instance or None
        Of the paths.
    thrust, air
        As for :func:`skdgp.dynamics.simulate`; they matter for regressors that follow from the
        loads.
    added : array-like of shape (k, d), optional
        Regressors of rows that are flown next, as :func:`skdgp.design.plan` chooses them. Standard
        deviations are then those expected of a model learned from these rows too.
    perturbation : {"flown", None}
        Derivatives are :math:`E[\partial C / \partial x_k]` for :math:`x_k \sim N(x_{0k}, s_k^2)`, the
        slopes of the best linear approximation over a perturbation of each regressor alone
        (statistical linearisation: Gelb 1974, section 6.2). "flown": s is the
        standard deviation of each regressor around the trims of the training flights. None: local
        slopes, as always of a model that knows no flights. Values of the coefficients are those at
        the flight in both cases.

    Returns
    -------
    DataFrame
        A row for each coefficient (``CL``) and derivative (``CL_alpha``, ``Cm_q``, ``Cn_rudder``),
        with columns ``value``, ``std``, ``lower`` and ``upper`` (95 %), ``coefficient``,
        ``regressor``, and ``per``, the unit of the regressor. ``perturbation`` is s in this unit,
        absent for local slopes (``attrs["slopes"]`` tells which). Several points have an outer level
        ``point``, and columns ``airspeed``, ``alpha``, ``beta``. ``std`` is the standard deviation
        over functions drawn from the posterior, which :func:`skdgp.dynamics.simulate` flies too, and
        by errors of the log. Of a model learned from flights its square is the sum of the squares of

        - ``std_random``: errors correlated between samples and between outputs, estimated block by
          block,
        - ``std_method``: difference to the slopes of a polynomial with past regressors as
          instruments, and how far noise of the regressors flattens a slope,
        - ``std_log``: errors of the log that its flights do not show: times of the channels,
          position of the sensors, scale of the airspeed,
        - ``std_posterior``: the rest.

        Without a time series ``std_posterior`` is all; a model without a posterior of skdgp has no
        parts.

        ``std_merged`` is the possible difference of derivatives by alpha_dot and beta_dot alone
        from the merged ones of the model, see the notes; ``merged`` names the larger one.

        Where sizes of the aircraft have ``deviations``, ``std_aircraft`` is the effect of their errors,
        and of that of the propeller's thrust, on the values, and ``aircraft`` names the largest. These
        are shared. Neither is part
        of ``std``: trim, modes and simulations with the same aircraft hardly depend on them.
        Compare derivatives with other sources by all three.

    Notes
    -----
    A model without alpha_dot and beta_dot gives their effect to the rates, as far as they moved
    together in the flights. Its Cm_q lies between Cm_q and Cm_q + Cm_alpha_dot (Klein & Morelli
    2006, section 5.1; docs/control.md). ``std_merged`` is for derivatives by alpha_dot of 0 +- 0.4
    times those by q, as of a tail in the downwash, and by beta_dot of 0 +- 0.2 times those by r.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, stability_derivatives
    >>> def linear(X):
    ...     alpha, q, elevator = X.T
    ...     zero = 0 * alpha
    ...     return np.stack([-0.04 + 0.3 * alpha, zero, -0.3 - 4.5 * alpha - 0.4 * elevator, zero,
    ...                      0.02 - 0.6 * alpha - 0.12 * q - elevator, zero], axis=-1)
    >>> glider = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.5)
    >>> state = np.array([0, 0, -100, 20, 0, 0, 1, 0, 0, 0, 0, 0, 0])
    >>> table = stability_derivatives(Aerodynamics(linear, ["alpha", "q", "elevator"]), glider, state,
    ...                               {"elevator": 0.0}, thrust=None)
    >>> table.loc[["CL", "CL_alpha", "CD", "Cm_q", "Cm_elevator"], "value"].round(3).to_dict()
    {'CL': 0.3, 'CL_alpha': 4.46, 'CD': 0.04, 'Cm_q': -9.6, 'Cm_elevator': -1.0}
    """
    check_paths(n_paths)
    motion = Motion(as_aerodynamics(model).over(perturbation), aircraft, thrust=thrust, air=air)
    added_rows = None if added is None else _check_added(added, motion.aerodynamics)
    states, controls, is_single = _points(motion, point, controls)
    now = motion.at(states, controls)
    check_settled(now)
    frame = _Frame(motion, now)
    values = frame(now.coefficients, motion.aerodynamics.gradient(now.regressors))
    if not np.isfinite(values).all():
        raise ValueError(
            "Got coefficients or slopes that are not finite: the model is not defined there."
        )
    columns: dict[str, np.ndarray] = {}
    if frame.perturbation is not None:
        columns["perturbation"] = np.broadcast_to(frame.perturbation[:, None], values.shape)
    if n_paths and motion.aerodynamics.is_uncertain:
        columns |= _standard_deviations(motion, now, frame, n_paths, random_state, added_rows)
    if aircraft.deviations or motion.aerodynamics.errors:
        columns |= _errors_of_aircraft(motion, now, frame)
    if "std" in columns and "std_log" in columns:
        columns["std"] = np.hypot(columns["std"], columns["std_log"])
    tables = []
    for k, value in enumerate(values):
        of_point = {name: column[k].ravel() for name, column in columns.items()}
        tables.append(frame.table(value.ravel(), of_point))
    table = tables[0] if is_single else _with_points(tables, now)
    table.attrs["slopes"] = "local" if frame.perturbation is None else "over the perturbation"
    return table


def _with_points(tables: list[pd.DataFrame], now: Instant) -> pd.DataFrame:
    """Return the tables of several points below each other, with airspeed, alpha and beta."""
    for k, table in enumerate(tables):
        table.insert(0, "airspeed", float(now.airspeed[k]))
        table.insert(1, "alpha", float(now.alpha[k]))
        table.insert(2, "beta", float(now.beta[k]))
    return pd.concat(tables, keys=range(len(tables)), names=["point", None])


def _check_added(added: ArrayLike, model: Aerodynamics) -> Array:
    """Return the regressors of rows that are flown next, (k, d)."""
    if model.learned is None:
        raise ValueError(
            "Got rows that are added to a model without its own, but expected one that holds the rows "
            "it was learned from: give a pipeline of identify."
        )
    names = model.regressors
    rows = np.asarray(added, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != len(names) or not np.isfinite(rows).all():
        raise ValueError(
            f"Got added of shape {rows.shape}, but expected finite regressors of shape "
            f"(k, {len(names)}), in the order {', '.join(names)}."
        )
    return rows


def _standard_deviations(
    motion: Motion,
    now: Instant,
    frame: _Frame,
    n_paths: int,
    random_state: Seed,
    added: Array | None,
) -> dict[str, np.ndarray]:
    """Return the standard deviations of the table by column, (n, rows, 1 + columns) each.

    They are of functions drawn from the posterior, and of their parts.
    """
    model = motion.aerodynamics
    std = _std_of_paths(model.sample(n_paths, random_state), now, frame)
    if model.learned is None:
        return {"std": std}
    errors = model.learned.function_errors
    std_random, std_bias = _std_of_errors(errors, now, frame)
    # the part that the errors of the function do not explain
    std_posterior = np.sqrt(np.maximum(std**2 - (std_random**2 + std_bias**2), 0.0))
    parts = {"std_posterior": std_posterior, "std_random": std_random, "std_method": std_bias}
    if added is not None:
        later = _later_parts(model, model.learned, now, frame, std_posterior, added)
        std = std * _ratio(_total(later), _total(parts))
        parts = later
    std_merged, merged = _merged(motion, now, frame, std_of_biases(errors))
    return {"std": std, **parts, "std_merged": std_merged, "merged": merged}


def _std_of_errors(errors: Any, now: Instant, frame: _Frame) -> tuple[Array, Array]:
    """Return the standard deviations of random errors and of biases, (n, rows, 1 + columns); zero without errors."""
    if errors is None:
        nothing = frame.std(np.zeros((*now.coefficients.shape, now.regressors.shape[1], 1)))
        return nothing, nothing
    (values, slopes), (biases, biases_of_slopes) = errors.parts(now.regressors)
    return frame.std(slopes, values), frame.std(biases_of_slopes, biases)


def _later_parts(
    model: Aerodynamics,
    learned: Coefficients,
    now: Instant,
    frame: _Frame,
    std_posterior: Array,
    added: Array,
) -> dict[str, Array]:
    """Return the parts of standard deviations of a model that learned from added rows too.

    The discrepancy, a part of ``std_posterior``, is none that more rows reduce.
    """
    expected = learned.expected_errors(added)
    errors = learned.function_errors
    discrepancy = np.zeros_like(std_posterior)
    discrepancy_later = discrepancy
    if errors is not None:
        discrepancy = _std_of_slopes(errors.discrepancy_slopes(model.perturbation), now, frame)
        of_errors = expected.errors.discrepancy_slopes(model.perturbation)
        discrepancy_later = _std_of_slopes(of_errors, now, frame)
    std_of_kernel = np.sqrt(np.maximum(std_posterior**2 - discrepancy**2, 0.0))
    of_body = std_of_kernel[:, : len(COEFFICIENTS), 1:] / frame.scale[:, None, :]
    before = _std_of_slopes(of_body, now, frame)
    after = _std_of_slopes(expected.narrowing * of_body, now, frame)
    std_random, std_bias = _std_of_errors(expected.errors, now, frame)
    return {
        "std_posterior": np.hypot(std_of_kernel * _ratio(after, before), discrepancy_later),
        "std_random": std_random,
        "std_method": std_bias,
    }


def _total(parts: Mapping[str, Array]) -> Array:
    """Return the standard deviation of independent parts."""
    return np.sqrt(np.sum(np.square([*parts.values()]), axis=0))


def _ratio(after: Array, before: Array) -> Array:
    """Return the ratio of standard deviations, at most one: a model may leave rows out."""
    ratio = np.divide(after, before, out=np.ones_like(before), where=before > 0)
    return np.minimum(ratio, 1.0)


def _merged(
    motion: Motion, now: Instant, frame: _Frame, scatter: ArrayLike
) -> tuple[Array, np.ndarray]:
    """Return the possible effects of alpha_dot and beta_dot on each entry, and the name of the larger."""
    slopes = motion.aerodynamics.gradient(now.regressors)
    magnitudes = frame.magnitudes(unsteady_terms(motion, now, slopes, scatter).errors)
    return np.hypot(*magnitudes), _largest(magnitudes, frame.merged_names()[:, None])


def _std_of_paths(paths: Aerodynamics, now: Instant, frame: _Frame) -> Array:
    """Return the standard deviation (n, rows, 1 + columns) over functions drawn from the posterior."""
    X = now.regressors
    regressors = np.broadcast_to(X, (paths.n_paths or 1, *X.shape))
    return frame(paths(regressors), paths.gradient(regressors)).std(axis=0, ddof=1)


def _std_of_slopes(std: Array, now: Instant, frame: _Frame) -> Array:
    """Return the standard deviations (n, rows, 1 + columns) of slopes, by ``std`` (n, 6, d) of body axes.

    Errors of different outputs are independent.
    """
    n, d = now.regressors.shape
    independent = np.eye(6)[:, None]
    slopes = np.broadcast_to(std, (n, 6, d))[..., None] * independent
    return frame.std(slopes)


def _errors_of_aircraft(motion: Motion, now: Instant, frame: _Frame) -> dict[str, np.ndarray]:
    """Return the effect of errors of the log and of the aircraft's sizes, and names of the largest of the latter."""
    aircraft = motion.aircraft
    factors = {**(aircraft.deviations or {}), **motion.aerodynamics.errors}
    slopes = motion.aerodynamics.gradient(now.regressors)
    values = np.concatenate([now.coefficients[..., None], slopes], axis=-1)
    errors = errors_of_sizes(factors, aircraft.inertia, motion.regressors, values)
    magnitudes = np.abs(frame(errors[..., 0], errors[..., 1:]))
    names = np.array(list(factors), dtype=object)
    is_of_log = np.isin(names, list(errors_of_log(motion.aerodynamics.errors)))
    columns = {}
    if is_of_log.any():
        columns["std_log"] = np.sqrt(np.sum(magnitudes[is_of_log] ** 2, axis=0))
    if not is_of_log.all():
        size_errors = magnitudes[~is_of_log]
        columns["std_aircraft"] = np.sqrt(np.sum(size_errors**2, axis=0))
        columns["aircraft"] = _largest(size_errors, names[~is_of_log, None, None, None])
    return columns


def _largest(magnitudes: Array, names: np.ndarray) -> np.ndarray:
    """Return the name of the largest of k magnitudes (k, ...) by entry, "" where all vanish."""
    names = np.broadcast_to(names, magnitudes.shape)
    largest = np.take_along_axis(names, magnitudes.argmax(axis=0)[None], axis=0)[0]
    return np.where(magnitudes.any(axis=0), largest, "")


class _Frame:
    """Conversion of coefficients and slopes in body axes to rows and columns of the table of derivatives."""

    def __init__(self, motion: Motion, now: Instant):
        # what turns CX CY CZ Cl Cm Cn into the rows, (n, rows, 6)
        self.turn = _turn(now.alpha)
        self.columns = list(motion.regressors)
        # slopes by the conventional quantities over slopes by the model's regressors, (n, d)
        self.scale = np.ones((len(now.airspeed), len(self.columns)))
        for k, name in enumerate(self.columns):
            if name in LENGTHS:
                length = motion.aircraft.lengths[LENGTHS[name]]
                usual = rate_factor(name, length, now.airspeed)
                self.scale[:, k] = motion.factor(k, now.airspeed) / usual
        # of the conventional quantities, (n, 1 + d), NaN of the coefficients
        self.perturbation = None
        if motion.aerodynamics.perturbation is not None:
            spread = motion.aerodynamics.perturbation / self.scale
            self.perturbation = np.insert(spread, 0, np.nan, axis=1)
        units = {name: channel.unit for name, channel in CHANNELS.items()}
        self.units = units | dict.fromkeys(LENGTHS, "rad") | dict(motion.aerodynamics.units)
        self.names = ["", *self.columns]

    def __call__(self, coefficients: Array, slopes: Array) -> Array:
        """Return values and derivatives, (..., n, rows, 1 + columns), of C (..., n, 6) and slopes (..., n, 6, d)."""
        C = self.turn @ coefficients[..., None]
        S = self.turn @ (slopes * self.scale[:, None, :])
        if "alpha" in self.columns:
            k = self.columns.index("alpha")
            S[..., LIFT, k] -= C[..., DRAG, 0]
            S[..., DRAG, k] += C[..., LIFT, 0]
        return np.concatenate([C, S], axis=-1)

    def magnitudes(self, slopes: Array, values: Array | None = None) -> Array:
        """Return the magnitudes (k, n, rows, 1 + columns) of k errors of slopes (n, 6, d, k).

        Errors of the coefficients are ``values`` (n, 6, k), by default zero.
        """
        if values is None:
            values = np.zeros((*slopes.shape[:2], slopes.shape[-1]))
        return np.abs(self(np.moveaxis(values, -1, 0), np.moveaxis(slopes, -1, 0)))

    def std(self, slopes: Array, values: Array | None = None) -> Array:
        """Return the standard deviation (n, rows, 1 + columns) of independent errors, as of `magnitudes`."""
        return np.sqrt(np.sum(self.magnitudes(slopes, values) ** 2, axis=0))

    def merged_names(self) -> np.ndarray:
        """Return the derivative by alpha_dot or beta_dot that each merges with, (2, rows, 1 + columns)."""
        rows = np.array(ROWS, dtype=object)[:, None]
        merged = []
        for angle_rate, rotation in ROTATION_OF.items():
            partners = [rotation if name == angle_rate else angle_rate for name in self.names]
            merged.append(rows + "_" + np.array(partners, dtype=object))
        return np.stack(merged)

    def table(self, values: Array, columns: dict[str, np.ndarray]) -> pd.DataFrame:
        """Return the table of one point, of values and standard deviations by name (rows * (1 + columns),)."""
        table = pd.DataFrame({"value": values})
        if "std" in columns:
            std = columns.pop("std")
            half = half_width(0.95) * std
            table = table.assign(std=std, lower=values - half, upper=values + half)
        table["coefficient"] = np.repeat(np.array(ROWS, dtype=object), len(self.names))
        table["regressor"] = self.names * len(ROWS)
        table["per"] = [self.units.get(name, "") for name in self.names] * len(ROWS)
        table.index = pd.Index((table["coefficient"] + "_" + table["regressor"]).str.rstrip("_"))
        return table.assign(**columns)


def _turn(alpha: Array) -> Array:
    """Return what turns CX CY CZ Cl Cm Cn into the rows of the table, (n, rows, 6)."""
    sine = np.sin(alpha)
    cosine = np.cos(alpha)
    turn = np.zeros((len(alpha), len(ROWS), 6))
    turn[:, :6] = np.eye(6)
    turn[:, LIFT, 0] = sine
    turn[:, LIFT, 2] = -cosine
    turn[:, DRAG, 0] = -cosine
    turn[:, DRAG, 2] = -sine
    return turn


def _points(
    motion: Motion, point: Any, controls: Mapping[str, ArrayLike] | None
) -> tuple[Array, dict[str, Array], bool]:
    """Return states (n, 13), controls by name (n,), and whether it is a single point."""
    if np.size(point) == 0:
        raise ValueError(
            "Got no flight point, but expected a Trim, a state (13,), or several of them."
        )
    is_single = isinstance(point, Trim) or (np.ndim(point) == 1 and not isinstance(point[0], Trim))
    points = [point] if is_single else list(point)
    given = {name: np.broadcast_to(x, len(points)) for name, x in (controls or {}).items()}
    states = []
    settings = []
    for k, item in enumerate(points):
        inputs = {name: values[k] for name, values in given.items()}
        state, setting = flight_point(motion, item, None if controls is None else inputs)
        states.append(state)
        settings.append(setting)
    by_name = {}
    for name in settings[0]:
        by_name[name] = np.array([setting[name] for setting in settings])
    return np.stack(states), by_name, is_single

"""Stability derivatives: coefficients and their slopes at a flight, with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import CHANNELS, COEFFICIENTS, LENGTHS, rate_factor
from skdgp.dynamics._aerodynamics import Aerodynamics
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._linearize import check_paths, flight_point
from skdgp.dynamics._motion import Instant, Motion, check_settled
from skdgp.dynamics._size_errors import errors_of_sizes
from skdgp.dynamics._trim import Trim
from skdgp.dynamics._unsteady import ROTATION_OF, std_by_method, unsteady_terms

ROWS = (*COEFFICIENTS, "CL", "CD")
NORMAL_95 = 1.959963984540054


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

    Returns
    -------
    DataFrame
        A row for each coefficient (``CL``) and derivative (``CL_alpha``, ``Cm_q``, ``Cn_rudder``),
        with columns ``value``, ``std``, ``lower`` and ``upper`` (95 %), ``coefficient``,
        ``regressor``, and ``per``, the unit of the regressor. Several points have an outer level
        ``point``, and columns ``airspeed``, ``alpha``, ``beta``. ``std`` is the standard deviation
        over functions drawn from the posterior, which :func:`skdgp.dynamics.simulate` flies too. Of
        a model learned from flights its square is the sum of the squares of

        - ``std_random``: errors correlated between samples and between outputs, estimated block by
          block,
        - ``std_method``: difference to the slopes of a polynomial with past regressors as
          instruments, and how far noise of the regressors flattens a slope,
        - ``std_posterior``: the rest.

        A model without a time series has the errors of its means alone as ``std_random``; one
        without a posterior of skdgp has no parts.

        ``std_merged`` is how far derivatives by alpha_dot and beta_dot alone may differ from what
        the model merges with others, see the notes; ``merged`` names the larger one.

        Where sizes of the aircraft have ``deviations``, ``std_aircraft`` is what their errors make
        of the values, and ``aircraft`` names the largest. These are shared. Neither is part of
        ``std``: trim, modes and simulations with the same aircraft hardly depend on them. Compare
        derivatives with other sources by all three.

    Notes
    -----
    A model without alpha_dot and beta_dot gives their effect to the rates, as far as they went
    together in the flights: its Cm_q lies between Cm_q and Cm_q + Cm_alpha_dot (Klein & Morelli
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
    motion = Motion(model, aircraft, thrust=thrust, air=air)
    if added is not None and motion.aerodynamics.narrowing is None:
        raise ValueError(
            "Got rows that are added to a model without its own, but expected one that holds the "
            "rows it was learned from: give a pipeline of identify."
        )
    if added is not None:
        added = _check_added(added, motion.aerodynamics.regressors)
    states, controls, single = _points(motion, point, controls)
    now = motion.at(states, controls)
    check_settled(now)
    X, frame = now.regressors, _Frame(motion, now)
    values = frame(now.coefficients, motion.aerodynamics.gradient(X))
    if not np.isfinite(values).all():
        raise ValueError(
            "Got coefficients or slopes that are not finite: the model is not defined there."
        )
    parts: dict[str, Array] = {}
    if check_paths(n_paths) and motion.aerodynamics.is_uncertain:
        parts = _deviations(motion, now, frame, n_paths, random_state, added)
    tables = [
        frame.table(values[k], {name: part[k] for name, part in parts.items()})
        for k in range(len(states))
    ]
    if aircraft.deviations:
        _add_errors_of_aircraft(tables, motion, now, frame)
    if single:
        return tables[0]
    for k, table in enumerate(tables):
        for place, name in enumerate(("airspeed", "alpha", "beta")):
            table.insert(place, name, float(getattr(now, name)[k]))
    return pd.concat(tables, keys=range(len(tables)), names=["point", None])


def _check_added(added: ArrayLike, names: Sequence[str]) -> Array:
    """Return the regressors of rows that are flown next, (k, d)."""
    rows = np.asarray(added, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != len(names) or not np.isfinite(rows).all():
        raise ValueError(
            f"Got added of shape {rows.shape}, but expected finite regressors of shape "
            f"(k, {len(names)}), in the order {', '.join(names)}."
        )
    return rows


def _deviations(
    motion: Motion,
    now: Instant,
    frame: _Frame,
    n_paths: int,
    random_state: Seed,
    added: ArrayLike | None,
) -> dict[str, Array]:
    """Return the columns of the table that say what deviations are made of, (n, rows, 1 + columns) each."""
    model = motion.aerodynamics
    total = _deviation_of_paths(motion, now, frame, n_paths, random_state)
    if model.function_errors is None:
        return {"std": total, "std_posterior": total}
    errors = model.function_errors()
    of_parts = {"std_random": np.zeros_like(total), "std_method": np.zeros_like(total)}
    if errors is not None:
        for name, (values, slopes) in zip(of_parts, errors.parts(now.regressors), strict=True):
            of_parts[name] = frame.errors(slopes, values)
    # what the errors of the function do not explain
    of_errors = sum(part**2 for part in of_parts.values())
    posterior = np.sqrt(np.maximum(total**2 - of_errors, 0.0))
    if added is not None and model.narrowing is not None:
        factor = _narrowing(frame, model.narrowing(added), now)
        posterior = posterior * factor
        of_parts["std_random"] = of_parts["std_random"] * factor
        of_errors = sum(part**2 for part in of_parts.values())
        total = np.sqrt(posterior**2 + of_errors)
    scatter = std_by_method(errors)
    unsteady = unsteady_terms(motion, now, model.gradient(now.regressors), scatter)
    merged = frame.errors(unsteady.errors, apart=True)
    return {
        "std": total,
        "std_posterior": posterior,
        "std_merged": np.hypot(*merged),
        "merged": np.where(merged.any(axis=0), 1 + merged.argmax(axis=0), 0),
        **of_parts,
    }


def _deviation_of_paths(
    motion: Motion, now: Instant, frame: _Frame, n_paths: int, random_state: Seed
) -> Array:
    """Return the standard deviation (n, rows, 1 + columns) over functions drawn from the posterior."""
    drawn = motion.aerodynamics.sample(n_paths, random_state)
    regressors = np.broadcast_to(now.regressors, (n_paths, *now.regressors.shape))
    values = frame(drawn(regressors), drawn.gradient(regressors))
    return values.std(axis=0, ddof=1)


def _narrowing(frame: _Frame, factor: Array, now: Instant) -> Array:
    """Return the ``factor`` (6, d) of deviations of slopes for every entry of the table, (n, rows, 1 + columns)."""
    n, d = now.regressors.shape
    before = frame.errors(_each_output(np.ones((n, 6, d))))
    after = frame.errors(_each_output(np.broadcast_to(factor, (n, 6, d))))
    ratio = np.ones_like(before)
    np.divide(after, before, out=ratio, where=before > 0)
    return ratio


def _each_output(std: Array) -> Array:
    """Return errors (n, 6, d, 6) of slopes that are independent between outputs, of standard deviations (n, 6, d)."""
    return std[..., None] * np.eye(6)[:, None]


def _add_errors_of_aircraft(
    tables: list[pd.DataFrame], motion: Motion, now: Instant, frame: _Frame
) -> None:
    """Add what errors of the aircraft's sizes make of the values, and the largest of these errors."""
    aircraft, deviations = motion.aircraft, motion.aircraft.deviations or {}
    slopes = motion.aerodynamics.gradient(now.regressors)
    values = np.concatenate([now.coefficients[..., None], slopes], axis=-1)
    errors = errors_of_sizes(deviations, aircraft.inertia, tuple(motion.regressors), values)
    sizes = np.abs([frame(error[..., 0], error[..., 1:]) for error in errors])
    causes = np.array(list(deviations))
    for k, table in enumerate(tables):
        by_cause = sizes[:, k].reshape(len(causes), -1)
        table["std_aircraft"] = np.sqrt(np.sum(by_cause**2, axis=0))
        table["aircraft"] = np.where(by_cause.any(axis=0), causes[by_cause.argmax(axis=0)], "")


class _Frame:
    """Conversion of coefficients and slopes in body axes to rows and columns of the table of derivatives."""

    def __init__(self, motion: Motion, now: Instant):
        # what turns CX CY CZ Cl Cm Cn into the rows, (n, rows, 6)
        self.turn = np.zeros((len(now.alpha), len(ROWS), 6))
        self.turn[:, :6] = np.eye(6)
        sine, cosine = np.sin(now.alpha), np.cos(now.alpha)
        self.turn[:, 6, 0], self.turn[:, 6, 2] = sine, -cosine  # CL
        self.turn[:, 7, 0], self.turn[:, 7, 2] = -cosine, -sine  # CD
        self.columns = list(motion.regressors)
        # slopes by the conventional quantities over slopes by the model's regressors, (n, d)
        self.scale = np.ones((len(now.airspeed), len(self.columns)))
        for k, name in enumerate(self.columns):
            if name in LENGTHS:
                length = getattr(motion.aircraft, LENGTHS[name])
                usual = rate_factor(name, length, now.airspeed)
                self.scale[:, k] = motion.factor(k, now.airspeed) / usual
        units = {name: channel.unit for name, channel in CHANNELS.items()}
        self.units = units | dict.fromkeys(LENGTHS, "rad") | dict(motion.aerodynamics.units)

    def __call__(self, coefficients: Array, slopes: Array) -> Array:
        """Return values and derivatives, (..., n, rows, 1 + columns), of C (..., n, 6) and slopes (..., n, 6, d)."""
        C = self.turn @ coefficients[..., None]
        S = self.turn @ (slopes * self.scale[:, None, :])
        if "alpha" in self.columns:
            lift, drag = ROWS.index("CL"), ROWS.index("CD")
            k = self.columns.index("alpha")
            S[..., lift, k] -= C[..., drag, 0]
            S[..., drag, k] += C[..., lift, 0]
        return np.concatenate([C, S], axis=-1)

    def errors(self, slopes: Array, values: Array | None = None, apart: bool = False) -> Array:
        """Return the standard deviation (n, rows, 1 + columns) of k errors of slopes (n, 6, d, k), or of each.

        Errors of the coefficients are ``values`` (n, 6, k), by default zero.
        """
        if values is None:
            values = np.zeros((*slopes.shape[:2], slopes.shape[-1]))
        parts = np.zeros((slopes.shape[-1], len(slopes), len(ROWS), 1 + len(self.columns)))
        for k in range(len(parts)):
            parts[k] = np.abs(self(values[..., k], slopes[..., k]))
        return parts if apart else np.sqrt(np.sum(parts**2, axis=0))

    def table(self, values: Array, parts: dict[str, Array]) -> pd.DataFrame:
        """Return the table of one point, of values and parts of their deviations (rows, 1 + columns)."""
        names = ["", *self.columns]
        pairs = [(row, name) for row in ROWS for name in names]
        table = pd.DataFrame(
            {"value": values.ravel()}, index=[f"{row}_{name}".rstrip("_") for row, name in pairs]
        )
        columns = {name: part.ravel() for name, part in parts.items()}
        if columns:
            table["std"] = columns.pop("std")
            table["lower"] = table["value"] - NORMAL_95 * table["std"]
            table["upper"] = table["value"] + NORMAL_95 * table["std"]
        table["coefficient"], table["regressor"] = ([pair[k] for pair in pairs] for k in (0, 1))
        table["per"] = [self.units.get(name, "") for _, name in pairs]
        if "merged" in columns:
            rates = np.array(["", *ROTATION_OF])[columns.pop("merged").astype(int)]
            merged = [
                _merged_with(row, name, rate)
                for (row, name), rate in zip(pairs, rates.tolist(), strict=True)
            ]
            table = table.assign(**columns, merged=merged)
        return table


def _merged_with(row: str, regressor: str, rate: str) -> str:
    """Return the derivative of a row that its derivative by a regressor merges with: Cm_alpha_dot of Cm_q."""
    if not rate:
        return ""
    return f"{row}_{ROTATION_OF[rate] if regressor == rate else rate}"


def _points(
    motion: Motion, point: Any, controls: Mapping[str, ArrayLike] | None
) -> tuple[Array, dict[str, Array], bool]:
    """Return states (n, 13), controls by name (n,), and whether it is a single point."""
    is_single = isinstance(point, Trim) or (np.ndim(point) == 1 and not isinstance(point[0], Trim))
    points = [point] if is_single else list(point)
    columns = {
        name: np.broadcast_to(value, len(points)) for name, value in (controls or {}).items()
    }
    flights = [
        flight_point(motion, item, {name: x[k] for name, x in columns.items()} or None)
        for k, item in enumerate(points)
    ]
    states = np.stack([state for state, _ in flights])
    names = flights[0][1]
    return states, {n: np.array([row[n] for _, row in flights]) for n in names}, is_single

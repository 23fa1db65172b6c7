"""Stability derivatives: coefficients and their slopes at a flight, with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import CHANNELS, COEFFICIENTS, LENGTHS, rate_factor
from skdgp.dynamics._aerodynamics import Aerodynamics, as_aerodynamics
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._linearize import check_paths, flight_point, unsteady_terms
from skdgp.dynamics._motion import Instant, Motion
from skdgp.dynamics._sizes import errors_of_sizes
from skdgp.dynamics._trim import Trim

ROWS = (*COEFFICIENTS, "CL", "CD")
LIFT = ROWS.index("CL")
DRAG = ROWS.index("CD")


def stability_derivatives(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    point: Trim | ArrayLike,
    controls: Mapping[str, float] | None = None,
    *,
    n_paths: int = 200,
    random_state: Seed = 0,
    thrust: str | None = "auto",
    air: Any = None,
    perturbation: str | None = "flown",
) -> pd.DataFrame:
    r"""Return the coefficients and their derivatives at a flight, with their standard deviations.

    Derivatives by rates are by the non-dimensional ones, :math:`pb/2V`, :math:`qc/2V`,
    :math:`rb/2V`, :math:`\dot\alpha c/2V`, :math:`\dot\beta b/2V`, whatever regressors the model
    has (Stevens, Lewis & Johnson 2016, section 2.3). Lift and drag are

    .. math:: C_L = C_X \sin\alpha - C_Z \cos\alpha, \quad C_D = -C_X \cos\alpha - C_Z \sin\alpha, \quad
        C_{L_\alpha} = C_{X_\alpha} \sin\alpha - C_{Z_\alpha} \cos\alpha - C_D.

    Other coefficients and rates are in body axes. Raises ValueError if the model is not defined
    there.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    point : Trim or array-like of shape (13,)
        A trim, or a state (`STATE_NAMES`) with its ``controls``.
    controls : mapping of str to float, optional
    n_paths : int
        Number of posterior functions that give the standard deviations, each with a relative error
        of 1 / sqrt(2 n_paths); 0: no deviations. A model without a posterior has none.
    random_state : int, RandomState instance or None
        Of the paths.
    thrust, air
        As for :func:`skdgp.dynamics.simulate`; they matter for regressors that follow from the
        loads.
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
        absent for local slopes. ``std`` is the standard deviation
        over functions drawn from the posterior, which :func:`skdgp.dynamics.simulate` flies too. Of a
        model learned from flights its square is the sum of the squares of

        - ``std_errors``: how far noise of the regressors flattens a slope, errors of slopes by
          instruments, and errors of the log that its flights do not show: times of the channels, position of the
          sensors, scale of the airspeed; without vanes errors of the filter's derivatives,
        - ``std_posterior``: the rest.

        Without a time series ``std_posterior`` is all; a model without a posterior of skdgp has no
        parts.

        ``std_merged`` is the possible difference of derivatives by alpha_dot and beta_dot alone
        from the merged ones of the model, see the notes.

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
    now = motion.at(*flight_point(motion, point, controls))
    frame = _Frame(motion, now)
    terms = _terms(motion.aerodynamics, now.coefficients, now.regressors)
    values = frame(terms)
    if not np.isfinite(values).all():
        raise ValueError(
            "Got coefficients or slopes that are not finite: the model is not defined there."
        )
    columns: dict[str, np.ndarray] = {"value": values}
    perturbation = motion.aerodynamics.perturbation
    if perturbation is not None:
        # of the conventional quantities, NaN of the coefficients
        of_columns = np.append(np.nan, perturbation) / frame.scale
        columns["perturbation"] = np.broadcast_to(of_columns, values.shape)
    if n_paths and motion.aerodynamics.is_uncertain:
        columns |= _standard_deviations(motion, now, frame, n_paths, random_state)
    columns |= _errors_of_sizes(motion, frame, terms)
    return frame.table(columns)


def _terms(model: Aerodynamics, coefficients: Array, X: Array) -> Array:
    """Return coefficients and slopes (..., 6, 1 + d) at regressors (..., d)."""
    return np.concatenate([coefficients[..., None], model.gradient(X)], axis=-1)


def _standard_deviations(
    motion: Motion, now: Instant, frame: _Frame, n_paths: int, random_state: Seed
) -> dict[str, np.ndarray]:
    """Return the standard deviations of functions drawn from the posterior, and their parts, (rows, 1 + columns)."""
    model = motion.aerodynamics
    paths = model.sample(n_paths, random_state)
    X = np.tile(now.regressors, (n_paths, 1))
    terms = _terms(paths, paths(X), X)
    std = frame(terms).std(axis=0, ddof=1)
    if model.learned is None:
        return {"std": std}
    errors = model.learned.function_errors
    std_errors = np.zeros_like(std)
    if errors is not None:
        values = errors.linear(now.regressors[None])[:, 0, :, None]
        slopes = np.moveaxis(errors.slopes(), -1, 0)
        std_errors = np.linalg.norm(frame(np.concatenate([values, slopes], axis=-1)), axis=0)
    # the part that the errors of the function do not explain
    std_posterior = np.sqrt(np.maximum(std**2 - std_errors**2, 0.0))
    K, S, _ = unsteady_terms(motion, now, terms[..., 1:])
    unsteady = np.zeros((2, *terms.shape))
    unsteady[..., 1:] = np.einsum("...ij,...jk->j...ik", K, S)
    merged = np.sqrt(np.square(frame(unsteady)).mean(axis=1))
    return {
        "std": std,
        "std_posterior": std_posterior,
        "std_errors": std_errors,
        "std_merged": np.linalg.norm(merged, axis=0),
    }


def _errors_of_sizes(motion: Motion, frame: _Frame, terms: Array) -> dict[str, np.ndarray]:
    """Return the effect of errors of the aircraft's sizes, and names of the largest."""
    aircraft = motion.aircraft
    factors = {**(aircraft.deviations or {}), **motion.aerodynamics.errors}
    if not factors:
        return {}
    errors = errors_of_sizes(factors, aircraft.inertia, motion.regressors, terms)
    magnitudes = np.abs(frame(errors))
    largest = np.array([*factors], dtype=object)[magnitudes.argmax(axis=0)]
    return {
        "std_aircraft": np.linalg.norm(magnitudes, axis=0),
        "aircraft": np.where(magnitudes.any(axis=0), largest, ""),
    }


class _Frame:
    """Conversion of coefficients and slopes in body axes to rows and columns of the table of derivatives."""

    def __init__(self, motion: Motion, now: Instant):
        # what turns CX CY CZ Cl Cm Cn into the rows, (rows, 6)
        sine, cosine = np.sin(now.alpha), np.cos(now.alpha)
        self.turn = np.vstack([np.eye(6), np.zeros((2, 6))])
        self.turn[LIFT, [0, 2]] = sine, -cosine
        self.turn[DRAG, [0, 2]] = -cosine, -sine
        self.names = ["", *motion.regressors]
        # slopes by the conventional quantities over slopes by the model's regressors, and 1 of coefficients
        lengths = motion.aircraft.lengths
        self.scale = np.append(1.0, motion.factors(now.airspeed))
        for k, name in enumerate(self.names):
            if name in LENGTHS:
                self.scale[k] /= rate_factor(name, lengths[LENGTHS[name]], now.airspeed)
        units = CHANNELS | dict.fromkeys(LENGTHS, "rad") | dict(motion.aerodynamics.units)
        self.units = [units.get(name, "") for name in self.names]

    def __call__(self, terms: Array) -> Array:
        """Return values and derivatives (..., rows, 1 + columns) of coefficients and slopes (..., 6, 1 + d)."""
        rows = self.turn @ (terms * self.scale)
        if "alpha" in self.names:
            k = self.names.index("alpha")
            rows[..., LIFT, k] -= rows[..., DRAG, 0]
            rows[..., DRAG, k] += rows[..., LIFT, 0]
        return rows

    def table(self, columns: dict[str, np.ndarray]) -> pd.DataFrame:
        """Return the table of values and standard deviations by name, (rows, 1 + columns) each."""
        flat = {name: column.ravel() for name, column in columns.items()}
        table = pd.DataFrame({"value": flat.pop("value")})
        if "std" in flat:
            table["std"] = flat.pop("std")
            half = half_width(0.95) * table["std"]
            table["lower"], table["upper"] = table["value"] - half, table["value"] + half
        table["coefficient"] = np.repeat(np.array(ROWS, dtype=object), len(self.names))
        table["regressor"] = self.names * len(ROWS)
        table["per"] = self.units * len(ROWS)
        table.index = pd.Index((table["coefficient"] + "_" + table["regressor"]).str.rstrip("_"))
        return table.assign(**flat)

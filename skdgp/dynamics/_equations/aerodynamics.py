"""Aerodynamics: coefficients as a function of named regressors, from a pipeline or a formula."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.frozen import FrozenEstimator
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.validation import check_is_fitted

from skdgp._flight.channels import COEFFICIENTS

__all__ = ["Aerodynamics", "as_aerodynamics"]

STEP = 1e-4
"""Of central differences, where a model has no slopes of its own: a fraction of what a regressor moves, or itself."""
OWN_NAMES = [f"y{i}" for i in range(len(COEFFICIENTS))]
"""What a regressor calls outputs that had no names."""


class Mixing(NamedTuple):
    """Controls that a model knows as combinations of the surfaces: controls = matrix @ surfaces."""

    surfaces: tuple[str, ...]
    controls: tuple[str, ...]
    matrix: np.ndarray


class Aerodynamics:
    """The six coefficients of an aircraft as a function of named regressors.

    A fitted pipeline, one sample of its posterior and a textbook formula are the same thing to whoever flies them.

    Parameters
    ----------
    function : callable
        Regressors (n, d) to CX CY CZ Cl Cm Cn (n, 6).
    regressors : sequence of str
        What the d columns are: words of the vocabulary (docs/notation.md), with ``_hat`` behind a rate for its
        non-dimensional form, or controls by any name.
    gradient : callable, optional
        Regressors (n, d) to slopes (n, 6, d); by default central differences of fourth order.
    sampler : callable, optional
        (n_paths, random_state) to two callables, regressors (n_paths, n, d) to coefficients (n_paths, n, 6) and to
        slopes (n_paths, n, 6, d): functions drawn from what is believed. Without it the model has no uncertainty.
    covariance : callable, optional
        Regressors (n, d) to the joint covariance (6 n, 6 n) of what is believed, all n of the first coefficient first.
    limits : array-like of shape (2, d), optional
        Smallest and largest value of each regressor that the model was learned from.
    span, chord : float, optional
        Lengths [m] of the non-dimensional rates; by default those of the aircraft that flies.
    mixing : Mixing, optional
        How the model's controls follow from the aircraft's surfaces.

    Examples
    --------
    A textbook glider:

    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics
    >>> def linear(X):
    ...     alpha, beta, q_hat, elevator = X.T
    ...     return np.stack([-0.03 + 0 * alpha, -0.5 * beta, -0.1 - 4 * alpha, -0.03 * beta,
    ...                      0.03 - 0.5 * alpha - 8 * q_hat - 0.6 * elevator, 0.06 * beta], axis=-1)
    >>> glider = Aerodynamics(linear, ["alpha", "beta", "q_hat", "elevator"])
    >>> glider([0.1, 0.0, 0.0, -0.02]).round(3)
    array([-0.03 , -0.   , -0.5  , -0.   , -0.008,  0.   ])
    >>> glider.gradient([0.1, 0.0, 0.0, -0.02])[4].round(6)
    array([-0.5,  0. , -8. , -0.6])
    """

    def __init__(
        self,
        function: Callable,
        regressors: Sequence[str],
        *,
        gradient: Callable | None = None,
        sampler: Callable | None = None,
        covariance: Callable | None = None,
        limits=None,
        span: float | None = None,
        chord: float | None = None,
        mixing: Mixing | None = None,
    ):
        if isinstance(regressors, str) or len(set(regressors)) != len(regressors):
            raise ValueError(f"Got regressors={regressors!r}, but expected a list of names, each once.")
        self.function, self.regressors = function, tuple(str(name) for name in regressors)
        self.limits = None if limits is None else np.asarray(limits, dtype=float)
        if self.limits is not None and self.limits.shape != (2, len(self.regressors)):
            raise ValueError(f"Got limits of shape {self.limits.shape}, but expected (2, {len(self.regressors)}).")
        self.span, self.chord, self.mixing = span, chord, mixing
        self.n_paths: int | None = None
        self._gradient, self._sampler, self._covariance = gradient, sampler, covariance

    def __repr__(self):
        paths = "" if self.n_paths is None else f", {self.n_paths} paths"
        return f"Aerodynamics({', '.join(self.regressors)}{paths})"

    @property
    def is_uncertain(self) -> bool:
        """Whether functions can be drawn from what the model believes."""
        return self._sampler is not None

    def __call__(self, X) -> np.ndarray:
        """Return the coefficients (..., 6) at regressors (..., d)."""
        X = np.asarray(X, dtype=float)
        if self.n_paths is not None:
            return self._each(self.function, X, (6,))
        if X.ndim == 2:
            return self.function(X)
        return self.function(X.reshape(-1, X.shape[-1])).reshape(*X.shape[:-1], 6)

    def gradient(self, X) -> np.ndarray:
        """Return the slopes of the coefficients (..., 6, d) at regressors (..., d)."""
        X = np.asarray(X, dtype=float)
        d = X.shape[-1]
        if self._gradient is None:
            return self._differences(X)
        if self.n_paths is not None:
            return self._each(self._gradient, X, (6, d))
        return self._gradient(X.reshape(-1, d)).reshape(*X.shape[:-1], 6, d)

    def sample(self, n_paths: int, random_state=0) -> Aerodynamics:
        """Return functions drawn from what the model believes, as one model.

        Its regressors have the paths as their first axis, (n_paths, ..., d): each path is asked at its own.

        Raises
        ------
        ValueError
            If the model has no uncertainty.
        """
        if self._sampler is None:
            raise ValueError(
                f"Got a model without posterior samples ({self!r}), but expected one that can draw functions: a "
                "pipeline that ends in DependentGPRegressor, or Aerodynamics(..., sampler=...)."
            )
        values, slopes = self._sampler(n_paths, random_state)
        drawn = copy.copy(self)
        drawn.function, drawn._gradient, drawn._sampler, drawn.n_paths = values, slopes, None, n_paths
        return drawn

    def covariance(self, X) -> np.ndarray:
        """Return the joint covariance of the coefficients at regressors (n, d), (6 n, 6 n), coefficient by coefficient.

        Raises
        ------
        ValueError
            If the model has no uncertainty.
        """
        if self._covariance is None:
            raise ValueError(
                f"Got a model without a posterior covariance ({self!r}), but expected a pipeline that ends in "
                "DependentGPRegressor, or Aerodynamics(..., covariance=...)."
            )
        return self._covariance(np.asarray(X, dtype=float))

    def _each(self, function, X, shape):
        """Return what each path says at its own regressors, (n_paths, ..., *shape)."""
        if X.shape[0] != self.n_paths:
            raise ValueError(
                f"Got regressors of shape {X.shape}, but expected the {self.n_paths} paths as their first axis."
            )
        if X.ndim == 3:
            return function(X)
        return function(X.reshape(self.n_paths, -1, X.shape[-1])).reshape(*X.shape[:-1], *shape)

    def _differences(self, X) -> np.ndarray:
        size = np.ptp(self.limits, axis=0) if self.limits is not None else np.zeros(X.shape[-1])
        slopes = []
        for k in range(X.shape[-1]):
            step = np.zeros(X.shape[-1])
            step[k] = STEP * (size[k] or 1.0)
            near, far = (self(X + m * step) - self(X - m * step) for m in (1, 2))
            slopes.append((8.0 * near - far) / (12.0 * step[k]))
        return np.stack(slopes, axis=-1)


def as_aerodynamics(model) -> Aerodynamics:
    """Return the model as a function of named regressors, without tables in between.

    Parameters
    ----------
    model : Aerodynamics, Pipeline or estimator
        A fitted pipeline with a ``RegressorSelector`` (what stands before it treats measurements, which a simulation
        has no need of; what stands behind it is kept), or a fitted estimator that learned from a table whose columns
        are regressors (``feature_names_in_``); or either in a fitted search or a ``CalibratedRegressor``. It predicts
        all six coefficients, in the order CX CY CZ Cl Cm Cn where it keeps no names of them, as scikit-learn's own.

    Returns
    -------
    Aerodynamics
        Gives the numbers of the pipeline, one row in some tens of microseconds.

    Raises
    ------
    TypeError
        If it is none of these.
    ValueError
        If the regressors have no names, or were scaled before they were chosen, or a coefficient is missing.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from sklearn.linear_model import LinearRegression
    >>> from skdgp.dynamics import as_aerodynamics
    >>> X = pd.DataFrame(np.random.default_rng(0).normal(size=(50, 2)), columns=["alpha", "elevator"])
    >>> model = LinearRegression().fit(X, X.to_numpy() @ np.ones((2, 6)))
    >>> as_aerodynamics(model)([0.1, 0.2]).round(3)
    array([0.3, 0.3, 0.3, 0.3, 0.3, 0.3])
    """
    if isinstance(model, Aerodynamics):
        return model
    if not isinstance(model, BaseEstimator) or not callable(getattr(model, "predict", None)):
        raise TypeError(
            f"Got {type(model).__name__} as the model, but expected a fitted pipeline, an estimator, or "
            "Aerodynamics(function, regressors=[...])."
        )
    check_is_fitted(model)
    steps = _steps_of(model)
    place = max((k for k, step in enumerate(steps) if hasattr(step, "regressors_")), default=-1)
    if place >= 0:
        names = list(steps[place].regressors_)
    elif hasattr(steps[0], "feature_names_in_"):
        names = list(steps[0].feature_names_in_)
    else:
        raise ValueError(
            f"Got a {type(model).__name__} whose regressors have no names: put RegressorSelector([...]) into the "
            "pipeline, fit on a DataFrame, or give Aerodynamics(model.predict, regressors=[...])."
        )
    scaled = [type(step).__name__ for step in steps[: max(place, 0)] if hasattr(step, "scale_")]
    if scaled:
        raise ValueError(
            f"Got {scaled} before the choice of regressors, but expected flight channels in their units there, as a "
            "simulation gives them: put it behind RegressorSelector."
        )
    chain = _Chain([_plain(step) for step in steps[place + 1 : -1]], _nameless(steps[-1]), len(names))
    lengths = next((step for step in reversed(steps[:place]) if hasattr(step, "rates_")), None)
    limits = [getattr(steps[place], name, None) for name in ("data_min_", "data_max_")] if place >= 0 else [None]
    return Aerodynamics(
        chain.mean,
        names,
        gradient=chain.slopes if chain.has_slopes else None,
        sampler=chain.sample if chain.can_sample else None,
        covariance=chain.covariance if chain.can_sample else None,
        limits=None if any(limit is None for limit in limits) else limits,
        span=getattr(lengths, "span", None),
        chord=getattr(lengths, "chord", None),
        mixing=_mixing(steps[: max(place, 0)]),
    )


class _Chain:
    """What stands behind the choice of regressors: scalings and other transforms, and the regressor at the end."""

    def __init__(self, transforms, regressor, n_regressors: int):
        self.regressor = regressor
        self.shift, self.scale, affine = np.zeros(n_regressors), np.ones(n_regressors), 0
        for step in transforms:
            if type(step) is not StandardScaler:
                break
            self.shift = self.shift + (0.0 if step.mean_ is None else step.mean_) * self.scale
            self.scale = self.scale * (1.0 if step.scale_ is None else step.scale_)
            affine += 1
        self.others = transforms[affine:]
        self.order = self._order()
        self.has_slopes = not self.others and hasattr(regressor, "predict_gradient")
        self.can_sample = not self.others and hasattr(regressor, "sample_paths")

    def mean(self, X):
        """Return the coefficients (n, 6) at regressors (n, d)."""
        return self._predicted(X)[:, self.order]

    def slopes(self, X):
        """Return their slopes (n, 6, d)."""
        return self.regressor.predict_gradient((X - self.shift) / self.scale)[:, self.order] / self.scale

    def covariance(self, X):
        """Return the joint posterior covariance (6 n, 6 n)."""
        covariance = self.regressor.predict((X - self.shift) / self.scale, return_cov=True)[1]
        blocks = covariance.reshape(len(covariance) // len(X), len(X), -1, len(X))
        return blocks[self.order][:, :, self.order].reshape(6 * len(X), 6 * len(X))

    def sample(self, n_paths, random_state):
        """Return values and slopes of functions drawn from the posterior."""
        paths, order, shift, scale = (
            self.regressor.sample_paths(n_paths, random_state), self.order, self.shift, self.scale,
        )  # fmt: skip
        return (
            lambda X: paths.each((X - shift) / scale)[..., order],
            lambda X: paths.gradient((X - shift) / scale)[..., order, :] / scale,
        )

    def _predicted(self, X):
        X = (X - self.shift) / self.scale
        for step in self.others:
            X = step.transform(X)
        return self.regressor.predict(X)

    def _order(self):
        names = list(getattr(self.regressor, "output_names_", OWN_NAMES))
        if names == OWN_NAMES:
            shape = np.shape(self._predicted(self.shift[None]))
            if shape != (1, 6):
                raise ValueError(
                    f"Got a model of outputs {shape[1:]}, but expected all six coefficients {', '.join(COEFFICIENTS)}."
                )
            return slice(None)
        lacking = [name for name in COEFFICIENTS if name not in names]
        if lacking:
            raise ValueError(
                f"Got a model of {names}, but flight needs all six coefficients: it lacks {lacking}. Fit it on a table "
                "of all of them (aerodynamic_coefficients gives it)."
            )
        order = [names.index(name) for name in COEFFICIENTS]
        return slice(None) if order == list(range(len(names))) else order


def _steps_of(model) -> list:
    """Return the fitted steps of a model: of the pipeline in a search, frozen, or calibrated as a whole, too."""
    inner = model.estimator if isinstance(model, FrozenEstimator) else getattr(model, "best_estimator_", None)
    if inner is not None:
        return _steps_of(inner)
    if isinstance(model, Pipeline):
        steps = [step for _, step in model.steps if step not in (None, "passthrough")]
        return [*steps[:-1], *_steps_of(steps[-1])]
    if hasattr(model, "std_scale_"):  # deviations are of the outputs, so it may stand around the last step alone
        model = copy.copy(model)
        *before, model.estimator_ = _steps_of(model.estimator_)
        return [*before, model]
    return [model]


def _plain(transform):
    """Return the transform as it takes and gives arrays, whatever `set_output` said."""
    transform = copy.deepcopy(_nameless(transform))
    return transform.set_output(transform="default") if hasattr(transform, "set_output") else transform


def _nameless(step):
    """Return the step as it takes arrays: without names of columns, which it would ask for."""
    if not hasattr(step, "feature_names_in_"):
        return step
    step = copy.copy(step)
    if "feature_names_in_" in vars(step):
        del step.feature_names_in_
    elif hasattr(step, "estimator_"):
        step.estimator_ = _nameless(step.estimator_)
    return step


def _mixing(steps) -> Mixing | None:
    splitter = next((step for step in reversed(steps) if hasattr(step, "mixing_")), None)
    if splitter is None:
        return None
    return Mixing(tuple(splitter.surfaces), tuple(splitter.controls), np.asarray(splitter.mixing_))

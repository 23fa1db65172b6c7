"""Aerodynamics: coefficients as a function of named regressors, from a pipeline or a formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property, partial
from itertools import takewhile
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, RobustScaler, StandardScaler
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.sklearn_compat import unwrap
from skdgp._compute.typing import Array, Predictor
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.tables import check_choice
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._servos import IDEAL, Servos
from skdgp.dynamics._sizes import ScaleFactor

# Names that a regressor gives to outputs without names
NO_NAMES = [f"y{i}" for i in range(len(COEFFICIENTS))]
# Step of the differences of a function without slopes, over the range of a regressor, or absolute without one
STEP = 1e-4
SCALERS = (StandardScaler, MinMaxScaler, MaxAbsScaler, RobustScaler)


class Mixing(NamedTuple):
    """Controls of a model as combinations of the surfaces: controls = matrix @ surfaces."""

    surfaces: tuple[str, ...]
    controls: tuple[str, ...]
    matrix: Array


class Drift(NamedTuple):
    """Errors of the coefficients along a flight: tau^2 exp(-|t - t'| / T), independent of the regressors."""

    variance: Array  # tau^2 of each coefficient, (6,)
    memory: Array  # T [s], (6,)

    def draw(self, time: Array, shape: tuple[int, ...], random_state: Any) -> Array:
        """Return draws (n, *shape, 6) at times (n,) that increase."""
        rng = separate_generator(random_state)
        drawn = rng.standard_normal((len(time), *shape, 6)) * np.sqrt(self.variance)
        correlations = np.exp(-np.diff(time)[:, None] / self.memory)
        for k, r in enumerate(correlations, start=1):
            drawn[k] = r * drawn[k - 1] + np.sqrt(1 - r**2) * drawn[k]
        return drawn


def central_difference(function: Callable[[Array], Array], z: Array, steps: Array) -> Array:
    r"""Return the Jacobian (..., m, n) of a function of vectors (..., n) to (..., m), of fourth order in the steps.

    .. math:: f'(z) \approx \frac{8 (f(z + h) - f(z - h)) - (f(z + 2h) - f(z - 2h))}{12 h}

    ``steps`` h are (n,) or (..., n). The function gets arrays (..., n, n), whose row i has
    component i moved.
    """
    moves = steps[..., None] * np.eye(z.shape[-1])
    z = z[..., None, :]
    near = function(z + moves) - function(z - moves)
    far = function(z + 2.0 * moves) - function(z - 2.0 * moves)
    rows = (8.0 * near - far) / (12.0 * steps[..., None])
    return np.swapaxes(rows, -1, -2)


def separate_generator(random_state: Any, n_words: int = 4) -> np.random.Generator:
    """Return a generator of other numbers than the paths of the same seed have."""
    seeds = check_random_state(random_state).randint(2**31 - 1, size=n_words)
    return np.random.default_rng(seeds)


@dataclass(eq=False, repr=False)
class Aerodynamics:
    """The six coefficients of an aircraft as a function of named regressors.

    Parameters
    ----------
    function : callable
        Regressors (n, d) to CX CY CZ Cl Cm Cn (n, 6).
    regressors : sequence of str
        Names of the d columns (docs/notation.md), with ``_hat`` behind a rate for its
        non-dimensional form, or controls by any name.
    slopes : callable, optional
        Regressors (n, d) to slopes (n, 6, d); by default central differences.
    sampler : callable, optional
        (n_paths, random_state) to two callables, regressors (n_paths, n, d) to coefficients
        (n_paths, n, 6) and to slopes (n_paths, n, 6, d), of functions drawn from the posterior.
        Without a sampler the model has no uncertainty.
    drift : Drift, optional
        Errors along a flight: what regressors and posterior leave unexplained.
    turbulence : Turbulence, optional
        Of the flights that the model was learned from.
    limits : array-like of shape (2, d), optional
        Smallest and largest value of each regressor that the model was learned from.
    flown : mapping of str to tuple of float, optional
        The same of other channels, such as ``phi``, ``airspeed``, ``az``, ``altitude``.
    span, chord : float, optional
        Lengths [m] of the non-dimensional rates; by default the lengths of the aircraft that flies.
    mixing : Mixing, optional
        How the model's controls follow from the aircraft's surfaces.
    units : mapping of str to str, optional
        Units of controls that differ from docs/notation.md.
    errors : mapping of str to ScaleFactor, optional
        Error of the propeller's thrust that the model was learned with.
    servos : Servos, optional
        From the commands of a simulation to the surfaces, which are the regressors; by default ideal.
    learned : Coefficients, optional
        The fit of a regressor with a posterior: its rows, the errors of its function, and slopes
        over a perturbation.
    perturbation : array-like of shape (d,), optional
        Standard deviation of each regressor around the trims that were flown; only with ``learned``.
    n_paths : int, optional
        Number of paths of functions drawn from a posterior: see `sample`.

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

    function: Callable
    regressors: Sequence[str]
    _: KW_ONLY
    slopes: Callable | None = None
    sampler: Callable | None = None
    drift: Drift | None = None
    turbulence: Any = None
    limits: Any = None
    flown: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    span: float | None = None
    chord: float | None = None
    mixing: Mixing | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    errors: Mapping[str, ScaleFactor] = field(default_factory=dict)
    servos: Servos = IDEAL
    learned: Coefficients | None = None
    perturbation: Any = None
    n_paths: int | None = None

    def __post_init__(self) -> None:
        if isinstance(self.regressors, str) or len(set(self.regressors)) != len(self.regressors):
            raise ValueError(
                f"Got regressors={self.regressors!r}, but expected a list of names, each once."
            )
        self.regressors = tuple(map(str, self.regressors))
        self.limits = None if self.limits is None else np.asarray(self.limits, dtype=float)
        if self.limits is not None and self.limits.shape != (2, len(self.regressors)):
            raise ValueError(
                f"Got limits of shape {self.limits.shape}, but expected (2, {len(self.regressors)})."
            )

    def __repr__(self) -> str:
        return f"Aerodynamics({', '.join(self.regressors)})"

    @property
    def is_uncertain(self) -> bool:
        """Whether functions can be drawn from a posterior."""
        return self.sampler is not None

    @property
    def ranges(self) -> Array:
        """Widths of the training ranges (d,), 1 where a regressor has none."""
        if self.limits is None:
            return np.ones(len(self.regressors))
        widths = np.ptp(self.limits, axis=0)
        return np.where(widths > 0, widths, 1.0)

    @property
    def training_ranges(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest value of each regressor that the model was learned from, empty if unknown."""
        if self.limits is None:
            return {}
        return dict(zip(self.regressors, map(tuple, self.limits.T.tolist()), strict=True))

    def lengths(self, aircraft: Aircraft) -> dict[str, float]:
        """Return span and chord of the non-dimensional rates [m], by default of the aircraft that flies."""
        return {"span": self.span or aircraft.span, "chord": self.chord or aircraft.chord}

    def __call__(self, X: ArrayLike) -> Array:
        """Return the coefficients (..., 6) at regressors (..., d)."""
        return self._evaluated(self.function, np.asarray(X, dtype=float), 6)

    def gradient(self, X: ArrayLike) -> Array:
        """Return the slopes of the coefficients (..., 6, d) at regressors (..., d)."""
        X = np.asarray(X, dtype=float)
        if self.slopes is None:
            return central_difference(self, X, STEP * self.ranges)
        return self._evaluated(self.slopes, X, 6, X.shape[-1])

    def over(self, perturbation: str | None) -> Aerodynamics:
        r"""Return the model with slopes over a perturbation, "flown" for that of the training flights.

        Slopes, those of functions drawn from the posterior too, are then
        :math:`E[\partial C / \partial x_k]` for each regressor, normal with the standard deviation
        in ``perturbation``, while the others stay: those of the best linear approximation there
        (statistical linearisation: Gelb 1974, section 6.2). None is the model with local slopes, as
        is a model that knows no perturbation. Raises ValueError for others.
        """
        check_choice("perturbation", perturbation, ("flown", None))
        if perturbation is None or self.perturbation is None or self.learned is None:
            return replace(self, perturbation=None)
        _, slopes = self.learned.mean_function(self.perturbation)
        sampler = partial(self.learned.sample, perturbation=self.perturbation)
        return replace(self, slopes=slopes, sampler=sampler)

    def sample(self, n_paths: int, random_state: Any = 0) -> Aerodynamics:
        """Return functions drawn from the posterior, as one model; raise ValueError without a posterior.

        The paths are the first axis of its regressors, (n_paths, ..., d): each path has regressors
        of its own.
        """
        if self.sampler is None:
            raise ValueError(
                f"Got a model without posterior samples ({self!r}), but expected one that can draw "
                "functions: a pipeline that ends in DependentGPRegressor, or "
                "Aerodynamics(..., sampler=...)."
            )
        values, slopes = self.sampler(n_paths, random_state)
        return replace(self, function=values, slopes=slopes, sampler=None, n_paths=n_paths)

    def _evaluated(self, function: Callable, X: Array, *shape: int) -> Array:
        """Return values (..., *shape) at regressors (..., d) of a function of (n, d), or of paths (n_paths, n, d)."""
        paths = () if self.n_paths is None else (self.n_paths,)
        return function(X.reshape(*paths, -1, X.shape[-1])).reshape(*X.shape[:-1], *shape)


@runtime_checkable
class PosteriorRegressor(Protocol):
    """A fitted regressor with a posterior, such as ``DependentGPRegressor``, which documents these members."""

    output_names_: list[str]
    posterior_: Any
    drift_variance_: Array
    drift_memory_: Array

    def mean_path(self) -> Any:
        """Return the mean as a function, the only one of sample paths."""

    def sample_paths(self, n_paths: int, random_state: Any) -> Any:
        """Return functions drawn from the posterior."""

    def function_errors(self) -> Any:
        """Return the errors of the function that the posterior does not hold, or None."""


@runtime_checkable
class Described(Protocol):
    """A fitted step or pipeline that describes what a simulation needs of it."""

    def in_simulation(self) -> Mapping[str, Any]:
        """Return parameters of `Aerodynamics` that it knows."""


def as_aerodynamics(model: Aerodynamics | BaseEstimator) -> Aerodynamics:
    """Return the model as a function of named regressors, without tables.

    ``model`` is a fitted pipeline with a ``RegressorSelector``, or a fitted estimator that learned
    from a table whose columns are regressors; or either in a fitted search. It
    predicts all six coefficients, in the order CX CY CZ Cl Cm Cn where it keeps no names. Raises
    TypeError for any other model; ValueError if regressors have no names or were scaled before they
    were chosen, or a coefficient is missing.

    Notes
    -----
    A simulation has exact states and no neighbours in time. A transformer says by its method
    ``in_simulation()`` which parameters of `Aerodynamics` it knows: the choice of the regressors
    ``regressors``, ``limits`` and ``flown`` (the last choice counts), others ``span`` and ``chord``
    of non-dimensional rates, ``mixing`` of surfaces to controls, or ``servos`` between commands and
    surfaces, of which the first count. One that treats measurements knows none, or lacks the method, and is left out.

    These stand before the choice of regressors or are it. A step behind it works row by row, by
    ``transform``. The regressor at the end may have a posterior, as ``DependentGPRegressor`` has:
    then slopes, sample paths, errors of the function and a drift in time are its own.

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
    if not (isinstance(model, BaseEstimator) and isinstance(model, Predictor)):
        raise TypeError(
            f"Got {type(model).__name__} as the model, but expected a fitted pipeline, an "
            "estimator, or Aerodynamics(function, regressors=[...])."
        )
    check_is_fitted(model)
    steps = _steps_of(model)
    known: dict[str, Any] = {"servos": IDEAL}
    n_before = 0  # the last choice of regressors counts; without a choice all are behind
    for number, step in enumerate(steps, start=1):
        described = _described(step)
        servos = known["servos"].completed(described.get("servos", IDEAL))
        known |= described | {"servos": servos}
        if "regressors" in described:
            n_before = number
    behind = steps[n_before:]
    scalers = [type(step).__name__ for step in steps[:n_before] if isinstance(step, SCALERS)]
    if scalers:
        raise ValueError(
            f"Got {scalers} before the choice of regressors, but expected flight channels in their units "
            "there, as a simulation gives them: put it behind RegressorSelector."
        )
    names = known.get("regressors", vars(behind[0]).get("feature_names_in_"))
    if names is None:
        raise ValueError(
            f"Got a {type(model).__name__} whose regressors have no names: put RegressorSelector([...]) into the "
            "pipeline, fit on a DataFrame, or give Aerodynamics(model.predict, regressors=[...])."
        )
    known["regressors"] = list(names)
    known |= _described(unwrap(model))
    seconds = known.pop("seconds", None)
    coefficients = Coefficients(behind, len(known["regressors"]), seconds)
    aerodynamics = Aerodynamics(coefficients.mean, **known)
    if coefficients.others or not isinstance(coefficients.regressor, PosteriorRegressor):
        return aerodynamics
    function, slopes = coefficients.mean_function()
    return replace(
        aerodynamics,
        function=function,
        slopes=slopes,
        sampler=coefficients.sample,
        drift=coefficients.drift(),
        learned=coefficients,
        perturbation=flown_perturbation(coefficients.training_rows(), coefficients.seconds),
    )


def _described(step: Any) -> dict[str, Any]:
    """Return what a fitted step or pipeline knows for a simulation."""
    return dict(step.in_simulation()) if isinstance(step, Described) else {}


class Coefficients:
    """Prediction by the steps after the selection of regressors, in units and order of a flight.

    What a regressor with a posterior knows besides its mean is defined for such a regressor alone,
    behind scalers. ``seconds`` is the duration of the flights that it was learned from, if known.
    """

    def __init__(self, steps: list, n_regressors: int, seconds: float | None = None):
        self.seconds = seconds
        *transforms, self.regressor = map(_without_names, steps)
        scalers = list(takewhile(_is_linear, transforms))
        self.others = transforms[len(scalers) :]
        # of the scalers, x = shift + scale z
        ends = np.stack([np.zeros(n_regressors), np.ones(n_regressors)])
        for scaler in reversed(scalers):
            ends = scaler.inverse_transform(ends)
        self.shift, at_one = ends
        self.scale = at_one - self.shift
        self.order = self._order()

    def mean(self, X: Array) -> Array:
        """Return the coefficients (n, 6) at regressors (n, d)."""
        return self._predicted(X)[:, self.order]

    def scaled(self, X: Array) -> Array:
        """Return the inputs of the regressor, or of the first transform that is no scaler."""
        return (X - self.shift) / self.scale

    def _predicted(self, X: Array) -> Array:
        X = self.scaled(X)
        for step in self.others:
            X = step.transform(X)
            X = X if sparse.issparse(X) else np.asarray(X)
        return self.regressor.predict(X)

    def _order(self) -> slice | list[int]:
        """Return the places of the coefficients among the outputs."""
        names = vars(self.regressor).get("output_names_")
        if names is None:
            names = [f"y{i}" for i in range(np.size(self._predicted(self.shift[None])))]
        if names == NO_NAMES:
            names = list(COEFFICIENTS)
        lacking = [name for name in COEFFICIENTS if name not in names]
        if lacking:
            raise ValueError(
                f"Got a model of {names}, but expected all six coefficients, and it lacks {lacking}: fit it on a "
                "table of them (aerodynamic_coefficients gives it)."
            )
        order = [names.index(name) for name in COEFFICIENTS]
        return slice(None) if order == list(range(len(names))) else order

    def mean_function(self, perturbation: Array | None = None) -> tuple[Callable, Callable]:
        """Return the mean (n, 6) and its slopes (n, 6, d), functions of regressors (n, d).

        Slopes are local, or over a perturbation (d,).
        """
        values, slopes = self._functions(self.regressor.mean_path(), perturbation)
        return lambda X: values(X[None])[0], lambda X: slopes(X[None])[0]

    def sample(
        self, n_paths: int, random_state: Any, perturbation: Array | None = None
    ) -> tuple[Callable, Callable]:
        """Return values and slopes of functions drawn from the posterior, slopes as of `mean_function`."""
        return self._functions(self.regressor.sample_paths(n_paths, random_state), perturbation)

    def _functions(self, paths: Any, perturbation: Array | None) -> tuple[Callable, Callable]:
        """Return values and slopes of functions of the posterior, at regressors (n_paths, n, d)."""
        spread = None if perturbation is None else perturbation / np.abs(self.scale)

        def values(X: Array) -> Array:
            return paths.each(self.scaled(X))[..., self.order]

        def slopes(X: Array) -> Array:
            return paths.gradient(self.scaled(X), spread)[..., self.order, :] / self.scale

        return values, slopes

    def training_rows(self) -> Array:
        """Return the regressors (n, d) that the model was learned from."""
        return self.regressor.posterior_.data.X[0] * self.scale + self.shift

    @cached_property
    def function_errors(self) -> Any:
        """The errors of the function that come from the time series, None where none are known."""
        errors = self.regressor.function_errors()
        if errors is None:
            return None
        units = np.ones(errors.weights.shape[-1])
        return errors.in_units(self.shift, self.scale, units).of_outputs(self.order)

    def drift(self) -> Drift | None:
        """Return the drift of the regressor, or None if it has none."""
        variance = self.regressor.drift_variance_
        if not np.any(variance > 0):
            return None
        memory = np.where(variance > 0, self.regressor.drift_memory_, 1.0)
        return Drift(variance[self.order], memory[self.order])


def flown_perturbation(rows: Array, seconds: float | None) -> Array:
    """Return the standard deviations (d,) of regressors (n, d) in recording order around their trims.

    They are about the means of windows of 20 s, in which a trim lasts, while each axis moves in some.
    Without a duration there is one window.
    """
    n_windows = 1 if seconds is None else max(1, round(seconds / 20.0))
    parts = np.array_split(rows, min(n_windows, max(1, len(rows) // 10)))
    deviations = np.concatenate([part - part.mean(axis=0) for part in parts])
    return deviations.std(axis=0)


def _is_linear(step: Any) -> bool:
    """Return whether a step is a scaler that does not clip."""
    return type(step) in SCALERS and not step.get_params().get("clip", False)


def _steps_of(model: BaseEstimator) -> list:
    """Return the fitted steps of a model: of the pipeline in a search, or frozen, too."""
    model = unwrap(model)
    if isinstance(model, Pipeline):
        steps = [step for _, step in model.steps if step not in (None, "passthrough")]
        return [*steps[:-1], *_steps_of(steps[-1])]
    return [model]


def _without_names(step: Any) -> Any:
    """Return the step as if fitted on an array: one that was fitted on a table warns at arrays."""
    twin = object.__new__(type(step))
    twin.__dict__.update(vars(step))
    twin.__dict__.pop("feature_names_in_", None)
    return twin

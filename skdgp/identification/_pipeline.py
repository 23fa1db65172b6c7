"""The identification pipeline, and predictions for whole flights."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.statistics import r2_of_observed
from skdgp._compute.typing import Mask, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, RATES, SENSOR_GUST
from skdgp._flight.findings import Code, with_codes
from skdgp._flight.tables import FlightTable, has_values, with_sensor_position
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import (
    Aircraft,
    ScaleFactor,
    Servos,
    Turbulence,
    aerodynamic_coefficients,
    check_aircraft,
    turbulence_of_flights,
)
from skdgp.estimation import prior_deviations
from skdgp.identification._instruments import by_instruments
from skdgp.identification._log_errors import (
    fit_least_squares,
    learned_errors,
    regression_calibration,
    thrust_errors,
)
from skdgp.inference import (
    FunctionErrors,
    KnownSlopes,
)
from skdgp.metrics import check_scored
from skdgp.model_selection import observed_at, thin_targets
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightCheck,
    FlightPathReconstruction,
    FlightSmoother,
    LagCorrector,
    RateNondimensionalizer,
    RegressorSelector,
)

Step = TypeVar("Step")


# Rows that a model is learned from by default, of exact inference, which takes a minute, and of sparse
# inference: ten minutes at 50 Hz
MOST_EXACT = 755
MOST_SPARSE = 30000


def make_identification_pipeline(
    aircraft: Aircraft,
    *,
    regressors: str | Sequence[str] = "quasi-steady",
    reconstruction: Any = "auto",
    cutoff: float | str | None = "auto",
    mixer: Any = None,
    regressor: Any = None,
    lags: str | dict | None = "auto",
    samples: int | None = None,
    thrust: str | None = "auto",
    control_units: Mapping[str, str] | None = None,
) -> FlightPipeline:
    """Return the scikit-learn pipeline from a raw flight table to the six coefficients.

    ============================ ======================================================================================
    ``flightcheck``              faults of the log and error of its airspeed removed, short gaps bridged
    ``lagcorrector``             lags of air data, surfaces, attitude and GPS removed, where flights show them
    ``flightpathreconstruction`` airspeed, alpha, beta, rates and attitude that fit each other and all sensors
    ``flightsmoother``           sensor noise and vibration removed, rates of change added, without delay
    ``elevonsplitter``           elevons into elevator and aileron; tables that hold these already pass
    ``ratenondimensionalizer``   p b / 2V, q c / 2V, ... with the aircraft's span and chord
    ``regressorselector``        the columns to learn from
    ``standardscaler``           each to mean zero and variance one
    ``dependentgpregressor``     all six coefficients at once
    ============================ ======================================================================================

    The names are the steps', so ``dependentgpregressor__n_latent`` is a parameter for
    ``GridSearchCV``. Fit it on whole flights at their full rate: `identify` fits this pipeline, to
    the coefficients of its flights. In cross-validation hold out flights:
    ``groups=table["flight"]``. Raises TypeError if ``aircraft`` is not an Aircraft.

    Parameters
    ----------
    aircraft : Aircraft
        With span and chord, for non-dimensional rates.
    regressors : {"quasi-steady", "classical", "paper"} or list of str, default="quasi-steady"
        As for :class:`skdgp.preprocessing.RegressorSelector`.
    reconstruction : "auto", transformer, "passthrough" or None, default="auto"
        "auto": ``FlightPathReconstruction(aircraft=aircraft)``, which reconstructs
        the flights if no sensor is missing or contradicts the others, and estimates gusts and lag
        of the servos of flights without vanes.
    cutoff : float, "auto" or None, default="auto"
        As for :class:`skdgp.preprocessing.FlightSmoother`.
    mixer : transformer, optional
        In place of ``ElevonSplitter()``, as the first step: all others need elevator, aileron and rudder.
    regressor : estimator, optional
        By default ``DependentGPRegressor()``. It is cloned. Any regressor of several outputs will
        do.
    lags : "auto", dict or None, default="auto"
        As for :class:`skdgp.preprocessing.LagCorrector`.
    samples : int, optional
        Rows to learn from, spread over the flights: see `FlightPipeline`.
    thrust : {"auto", None}, default="auto"
        As for :func:`skdgp.dynamics.aerodynamic_coefficients`, which gave the coefficients. With
        ``thrust=None`` a named set gets the airspeed unless the throttle stays at zero.
    control_units : mapping of str to str, optional
        Units of controls that differ from docs/notation.md, such as "full throw".

    Returns
    -------
    FlightPipeline
        ``predict(table, return_std=True)`` gives coefficients (n, 6) and their standard deviations.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import Aircraft
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> model = make_identification_pipeline(glider, regressors=["alpha", "q_hat", "elevator"], cutoff=None)
    >>> [name for name, step in model.steps][-1]
    'dependentgpregressor'
    >>> t = np.arange(0, 4, 0.1)
    >>> flight = pd.DataFrame({"time": t, "airspeed": 12.0, "alpha": 0.1 * np.sin(t), "q": 0.1 * np.cos(t),
    ...                        "elevator": 0.02 * np.sin(3 * t), "aileron": 0.0})
    >>> Y = pd.DataFrame({"CZ": -4 * flight.alpha, "Cm": -0.5 * flight.alpha - 0.6 * flight.elevator})
    >>> mean, std = model.fit(flight, Y).predict(flight, return_std=True)
    >>> mean.shape, std.shape
    ((40, 2), (40, 2))
    """
    check_aircraft(aircraft)
    if isinstance(reconstruction, str) and reconstruction == "auto":
        reconstruction = FlightPathReconstruction(aircraft=aircraft, thrust=thrust)
    steps = [
        ("flightcheck", FlightCheck()),
        ("lagcorrector", LagCorrector(lags, aircraft=aircraft)),
        ("flightpathreconstruction", reconstruction),
        ("flightsmoother", FlightSmoother(cutoff=cutoff)),
        ("elevonsplitter", ElevonSplitter()),
        ("ratenondimensionalizer", RateNondimensionalizer(aircraft.span, aircraft.chord)),
        ("regressorselector", RegressorSelector(regressors, engine=thrust is None)),
        ("standardscaler", StandardScaler()),
        ("dependentgpregressor", DependentGPRegressor() if regressor is None else clone(regressor)),
    ]
    if mixer is not None:
        del steps[4]
        steps.insert(0, ("elevonsplitter", mixer))
    return FlightPipeline(
        steps, aircraft=aircraft, samples=samples, thrust=thrust, control_units=control_units
    )


def flight_regressors(pipeline: Pipeline, flight: Any) -> tuple[Matrix, Vector, Any, Any]:
    r"""Return the regressors (n, d) of the last step, how noisy they are (n,), the checked flight, and its path.

    In gusts the aerodynamics feel air that no sensor sees, so the variance of noisy regressors is
    proportional to the variance of the gusts. Where `FlightPathReconstruction` reconstructs
    flights, it estimates :math:`\sigma_g` [m/s in one second] of the flight, and the ratio to the fit is

    .. math:: \frac{\sigma_g^2 + \sigma_0^2}{\sigma_{g,\mathrm{fit}}^2 + \sigma_0^2}, \quad \sigma_0 = 0.1 \mathrm{m/s}

    as ``include_input_noise`` of ``DependentGPRegressor.predict`` takes it. Elsewhere it is 1.
    """
    checked = path = flight
    for _, step in pipeline.steps[:-1]:
        if step not in (None, "passthrough"):
            flight = step.transform(flight)
        if isinstance(step, FlightCheck):
            checked = path = flight
        if isinstance(step, FlightPathReconstruction):
            path = flight
    X = np.asarray(flight)
    reconstruction = reconstruction_of(pipeline)
    if reconstruction is None or "gust" not in path:
        return X, np.ones(len(X)), checked, path
    variance = path["gust"].to_numpy() ** 2 + SENSOR_GUST**2
    return X, variance / (reconstruction.gust_std_**2 + SENSOR_GUST**2), checked, path


def regressor_names(pipeline: Pipeline) -> list[str]:
    """Return the names of the regressors of the last step."""
    _, selector = pipeline.steps[position_of(pipeline, "regressorselector")]
    return [str(name) for name in selector.regressors_]


def position_of(pipeline: Pipeline, name: str) -> int:
    """Return the position of a step that flights need; raise ValueError where it is missing."""
    names = [each for each, _ in pipeline.steps]
    if name not in names:
        raise ValueError(
            f"Got a pipeline of {names}, but expected a step {name!r} as well: give its replacement this "
            "name, 'passthrough' for none."
        )
    return names.index(name)


def step_of(pipeline: Pipeline, kind: type[Step]) -> Step | None:
    """Return the step of a kind, None without one."""
    return next((step for _, step in pipeline.steps if isinstance(step, kind)), None)


def named_regressors(pipeline: Pipeline, regressors: Matrix) -> pd.DataFrame:
    """Return the regressors (n, d) of the last step by name, in their units before the scaler.

    Raises ValueError if the steps behind the selector do not scale each regressor by itself.
    """
    named = _behind_selector(pipeline).inverse_transform(regressors)
    zero, scale = scaling_of(pipeline)
    if named.shape != regressors.shape or not np.allclose(named, zero + scale * regressors):
        kinds = [type(step).__name__ for _, step in _behind_selector(pipeline).steps]
        raise ValueError(
            f"Got {kinds} behind RegressorSelector, but expected steps that scale each regressor by itself, such as "
            "StandardScaler, as errors of the log and slopes have names: use a Pipeline of the same steps, whose "
            "bands are without these errors."
        )
    return pd.DataFrame(named, columns=regressor_names(pipeline))


def scaling_of(pipeline: Pipeline) -> tuple[Vector, Vector]:
    """Return offset and scale (d,) of the steps behind the selector: regressors are offset + scale X."""
    d = len(regressor_names(pipeline))
    zero, one = _behind_selector(pipeline).inverse_transform(np.array([np.zeros(d), np.ones(d)]))
    return zero, one - zero


def _behind_selector(pipeline: Pipeline) -> Pipeline:
    """Return the steps between the choice of regressors and the last step."""
    return pipeline[1 + position_of(pipeline, "regressorselector") : -1]


def reconstruction_of(pipeline: Pipeline) -> FlightPathReconstruction | None:
    """Return the step that reconstructs flights; None where flights pass it unchanged."""
    step = step_of(pipeline, FlightPathReconstruction)
    return step if step is not None and step.used_ else None


def band_of(pipeline: Pipeline) -> float:
    """Return the highest frequency [Hz] of the regressors of a pipeline."""
    step = step_of(pipeline, FlightSmoother)
    return np.inf if step is None else step.band_


class FlightPipeline(Pipeline):
    """Pipeline from flight tables to coefficients, with standard deviations for the gusts of the flight.

    As scikit-learn's ``Pipeline``, and

    - ``fit`` learns from some of the rows (``samples``), which keep the clock of the flights;
    - a :class:`skdgp.DependentGPRegressor` at the end gets ``time`` and ``flight`` of each row, and
      slopes that noise of the regressors does not flatten: of flights without vanes those that the
      motion of the air shows, else those by earlier controls as instruments (docs/theory.md);
    - ``predict(flight, return_std=True)`` includes the noise of the regressors, which is larger in
      rougher air: by the ratio of the variances of the gusts.

    A ``Pipeline`` of the same steps is without these, and its bands lack the errors of the log.

    Parameters
    ----------
    steps : list of (str, estimator)
        Of :func:`make_identification_pipeline`; each may be replaced.
    aircraft : Aircraft, optional
        For errors of the log and turbulence.
    samples : int, optional
        Rows to learn from, spread over those that have a target. By default all, at most 30,000,
        or 755 by exact inference.
    thrust : str or None, default="auto"
        As of :func:`make_identification_pipeline`.
    control_units : mapping of str to str, optional
        Units of controls that differ from docs/notation.md.
    memory, verbose
        As of scikit-learn's ``Pipeline``.

    Attributes
    ----------
    seconds_ : float
        Duration of the flights of the fit [s], without gaps.
    conditions_ : dict of str to float
        Medians of their columns.
    n_observed_, n_learned_ : int
        Rows with a target, and those of them that the last step learns from.
    fit_time_ : float
        Duration of the fit [s].
    turbulence_ : Turbulence or None
        Of the flights of the fit, where they show it.
    least_squares_ : DataFrame (1 + d, P)
        Intercept and slopes of the targets by least squares of the same rows, in units.
    errors_ : dict of str to ScaleFactor
        Error of the propeller's thrust, which flights do not show, and its effect on the coefficients.
    log_errors_ : FunctionErrors or None
        Errors of the log among the errors of the last step's function. Coefficients measured by the same
        sensors have them, too.
    calibration_ : ndarray (1 + d, P) or None
        Intercept and slopes of `regression_calibration`, which ``predict`` adds to the function of the
        last step where there are such slopes. Simulations, derivatives and exports use the function.
    """

    steps: list[tuple[str, Any]]
    # a slice has learned nothing itself
    calibration_: Matrix | None = None
    turbulence_: Turbulence | None = None
    seconds_: float | None = None
    errors_: Mapping[str, ScaleFactor] = {}

    def __init__(
        self,
        steps: list[tuple[str, Any]],
        *,
        aircraft: Aircraft | None = None,
        samples: int | None = None,
        thrust: str | None = "auto",
        control_units: Mapping[str, str] | None = None,
        memory: Any = None,
        verbose: bool = False,
    ) -> None:
        super().__init__(steps, memory=memory, verbose=verbose)
        self.aircraft = aircraft
        self.samples = samples
        self.thrust = thrust
        self.control_units = control_units

    def fit(self, X: Any, y: Any = None, **params: Any) -> FlightPipeline:
        """Fit all steps to flights X at their full rate and coefficients y (n, P), NaN where not to be learned from.

        By default y follows from the checked flights by inverse dynamics of the pipeline's aircraft. Six targets
        without names are CX CY CZ Cl Cm Cn.
        ``params`` are as of scikit-learn's ``Pipeline``.
        """
        if y is None and self.aircraft is None:
            raise ValueError(
                "Got neither coefficients y nor an aircraft, but expected y (n, P), or the aircraft "
                "that they follow from by skdgp.dynamics.aerodynamic_coefficients."
            )
        began = time.monotonic()
        position_of(self, "regressorselector")  # asked for before the flights take their time
        n_first = 1 + position_of(self, "flightcheck")
        first, others = self[:n_first], self[n_first:-1]
        flights = first.fit_transform(X, y)
        self.turbulence_ = turbulence_of_flights(flights, self.aircraft)
        if y is None:
            aircraft: Any = self.aircraft
            checked = FlightTable.of(flights)
            y = aerodynamic_coefficients(checked, aircraft, thrust=self.thrust)
        elif np.shape(y)[1:] == (len(COEFFICIENTS),) and not isinstance(y, pd.DataFrame):
            y = pd.DataFrame(y, columns=[*COEFFICIENTS])
        self.n_observed_ = _n_observed(y)
        measured, y = y, self._thinned(y)
        regressors = np.asarray(others.fit_transform(flights, y))
        # with a ``memory``, clones of the steps were fitted
        self.steps = [*first.steps, *others.steps, self.steps[-1]]
        settled = self._servos_settled(flights)
        measured, y = observed_at(measured, settled), observed_at(y, settled)
        self.n_learned_ = _n_observed(y)
        self._learn_flights(flights)
        name, last = self.steps[-1]
        parameters = {key.removeprefix(f"{name}__"): value for key, value in params.items()}
        named = named_regressors(self, regressors)
        self.least_squares_ = fit_least_squares(named, y)
        self._learn_errors_by_log(flights, named)
        is_dependent = isinstance(last, DependentGPRegressor)
        if is_dependent:
            facts = {
                "time": flights.get("time"),
                "flight": flights.get("flight"),
                "slopes": partial(self._known_slopes, regressors, measured, flights),
                "errors": self.log_errors_,
            }
            parameters = facts | parameters
        last.fit(regressors, y, **parameters)
        self.calibration_ = None
        if is_dependent and last.slopes_ is not None:
            added = last.function_errors().mean_path()
            self.calibration_ = -added.about(np.zeros(regressors.shape[1])).weights[0]
        self.fit_time_ = round(time.monotonic() - began, 3)
        return self

    def _thinned(self, y: Any) -> Any:
        """Return targets y (n, P) of which as many rows as ``samples`` says are observed."""
        last = self.steps[-1][1]
        is_exact = isinstance(last, DependentGPRegressor) and last.inference == "exact"
        most = MOST_EXACT if is_exact else MOST_SPARSE
        return thin_targets(y, most if self.samples is None else self.samples)

    def _servos_settled(self, flights: pd.DataFrame) -> Mask:
        """Return whether deflections of flights are known, (n,): not until servos forget the time before a segment."""
        steps = (step_of(self, LagCorrector), reconstruction_of(self))
        seconds = sum(step.servos_.settling_time for step in steps if step is not None)
        if not seconds:
            return np.ones(len(flights), dtype=bool)
        return FlightTable.of(flights).clock.elapsed > seconds

    def _known_slopes(
        self, X: Matrix, y: Any, flights: pd.DataFrame, predict: Callable[[Matrix], Matrix]
    ) -> KnownSlopes | None:
        """Return slopes that noise of the regressors X (n, d) does not flatten, None where flights do not show them.

        By targets y (n, P) at the full rate: few rows are too few for many instruments.
        Without vanes those that the motion of the air shows, or where gusts are not known by least
        squares with the deviations of small aircraft in general. Else those by instruments of what ``predict`` lacks.
        """
        outputs = list(y.columns) if isinstance(y, pd.DataFrame) else list(COEFFICIENTS)
        names = regressor_names(self)
        _, scale = scaling_of(self)
        reconstruction = reconstruction_of(self)
        if reconstruction is not None and reconstruction.air_motion_ is not None:
            slopes = reconstruction.air_motion_.slopes(outputs, names)
            return KnownSlopes(*slopes).scaled(scale)
        if reconstruction is not None and with_codes(reconstruction.doubts_, Code.GUSTS_UNKNOWN):
            deviations = prior_deviations(outputs, names)
            return KnownSlopes.of_samples(X, y, deviations * scale)
        if "time" not in flights:
            return None
        clock = FlightTable.of(flights).clock
        return by_instruments(pd.DataFrame(X, columns=names), y, predict(X), clock)

    def _learn_errors_by_log(self, flights: pd.DataFrame, regressors: pd.DataFrame) -> None:
        """Learn errors of the function by the log and by the thrust, of coefficients of a known aircraft."""
        self.errors_ = {}
        self.log_errors_: FunctionErrors | None = None
        is_logged = has_values(flights, "time", "airspeed", "density", *RATES)
        outputs = [*self.least_squares_]
        if self.aircraft is None or not is_logged or not {*outputs} <= {*COEFFICIENTS}:
            return
        if self.thrust is not None:
            self.errors_ = thrust_errors(flights, self.aircraft, regressors)
        corrector = step_of(self, LagCorrector)
        check = step_of(self, FlightCheck)
        errors = learned_errors(
            with_sensor_position(flights, self.aircraft),
            self.aircraft,
            regressors,
            self.least_squares_.reindex(columns=COEFFICIENTS, fill_value=0.0),
            None if corrector is None else corrector.lags_,
            Servos() if corrector is None else corrector.servos_,
            0.0 if check is None else check.airspeed_scale_.left(),
        )
        places = [COEFFICIENTS.index(name) for name in outputs]
        self.log_errors_ = self._of_last_step(errors.of_outputs(places))

    def _of_last_step(self, errors: FunctionErrors) -> FunctionErrors:
        """Return errors over regressors in units as those over the regressors of the last step."""
        zero, scale = scaling_of(self)  # X = (x - zero) / scale
        return errors.in_units(-zero / scale, 1 / scale, np.ones(self.least_squares_.shape[1]))

    def _learn_flights(self, flights: pd.DataFrame) -> None:
        """Learn duration and conditions of checked flights."""
        clock = FlightTable.of(flights).clock
        self.seconds_ = float(sum(np.ptp(clock.time[segment]) for segment in clock.segments))
        self.conditions_ = flights.median(numeric_only=True).astype(float).to_dict()

    def in_simulation(self) -> dict[str, Any]:
        """Return what the flights of the fit show for a simulation."""
        return {
            "turbulence": self.turbulence_,
            "seconds": self.seconds_,
            "errors": self.errors_,
            "units": self.control_units or {},
        }

    def predict(self, X: Any, **params: Any) -> Any:
        """Predict the coefficients (n, P) of one or more flights at their full rate.

        ``params`` are for ``predict`` of the last step. ``return_std=True`` returns the
        standard deviation, too, with ``include_noise=True`` of new measurements.
        ``include_input_noise`` replaces the ratio of this flight.
        """
        check_is_fitted(self)
        regressors, noise_ratio, *_ = flight_regressors(self, X)
        return self.predict_rows(regressors, noise_ratio, **params)

    def predict_rows(self, regressors: Matrix, noise_ratio: Vector, **params: Any) -> Any:
        """Predict as `predict` the coefficients (n, P) of logged rows, by `flight_regressors`."""
        if isinstance(self[-1], DependentGPRegressor):
            params = {"include_input_noise": noise_ratio} | params
        predicted = self[-1].predict(regressors, **params)
        if self.calibration_ is None:
            return predicted
        if not self[
            -1
        ].slopes_.includes_noise:  # by instruments, beside samples of the same sensors
            noise_ratio = np.ones(len(regressors))
        added = regression_calibration(self.calibration_, regressors, noise_ratio)
        if isinstance(predicted, tuple):
            return predicted[0] + added, predicted[1]
        return predicted + added

    def score(self, X: pd.DataFrame, y: Any = None, sample_weight: Any = None) -> float:
        """Return the coefficient of determination R^2 of ``predict`` for observed coefficients, averaged.

        Coefficients y (n, 6) are NaN where they were not observed.
        """
        measured, mean = check_scored(y, self.predict(X))
        return r2_of_observed(measured, mean, sample_weight)


def _n_observed(y: Any) -> int:
    """Return the number of rows with any target."""
    targets = pd.DataFrame(np.asarray(y, dtype=float))
    return int(np.isfinite(targets).any(axis=1).sum())

"""The identification pipeline, and predictions for whole flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn import get_config
from sklearn.base import clone
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import check_consistent_length, check_is_fitted

from skdgp._compute.messages import without_warnings
from skdgp._compute.statistics import r2_of_observed
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, HAT, RATES, SENSOR_GUST, VANES
from skdgp._flight.motion_band import vibration_band
from skdgp._flight.smoothing import FittedFilter, smooth
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, Turbulence, band_filter, check_aircraft
from skdgp.estimation import (
    UNKNOWN_SCALE,
    AirspeedScale,
    airspeed_scale,
    without_airspeed_error,
)
from skdgp.identification._calibration import RegressionCalibration
from skdgp.identification._engine import engine_regressors
from skdgp.inference import KnownSlopes
from skdgp.metrics import check_scored
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightCheck,
    FlightPathReconstruction,
    FlightSmoother,
    LagCorrector,
    RateNondimensionalizer,
    RegressorSelector,
    prior_deviations,
)

DIFFERENTIATED = (*VANES, *RATES)


def make_identification_pipeline(
    aircraft: Aircraft,
    *,
    regressors: str | Sequence[str] = "quasi-steady",
    reconstruction: Any = "auto",
    cutoff: float | str | None = "auto",
    mixer: Any = None,
    regressor: Any = None,
    memory: Any = None,
    lags: str | dict | None = "auto",
) -> FlightPipeline:
    """Return the scikit-learn pipeline from a raw flight table to the six coefficients.

    ============================ ======================================================================================
    ``flightcheck``              faults of the log named and removed, short gaps bridged
    ``lagcorrector``             lags of air data, surfaces, attitude and GPS removed, where flights show them
    ``flightpathreconstruction`` airspeed, alpha, beta, rates and attitude that fit each other and all sensors
    ``flightsmoother``           the rest of the sensor noise removed, rates of change added, without delay
    ``elevonsplitter``           elevons into elevator and aileron; tables that hold these already pass
    ``ratenondimensionalizer``   p b / 2V, q c / 2V, ... with the aircraft's span and chord
    ``regressorselector``        the columns to learn from
    ``standardscaler``           each to mean zero and variance one
    ``dependentgpregressor``     all six coefficients at once
    ============================ ======================================================================================

    The names are the steps', so ``dependentgpregressor__n_latent`` is a parameter for
    ``GridSearchCV``. Fit it on whole flights at their full rate, and choose the rows to learn from
    in the targets (:func:`skdgp.model_selection.thin_targets`). In cross-validation hold out
    flights: ``groups=table["flight"]``. Raises TypeError if ``aircraft`` is not an Aircraft.

    Parameters
    ----------
    aircraft : Aircraft
        With span and chord, for non-dimensional rates.
    regressors : {"quasi-steady", "classical", "paper"} or list of str, default="quasi-steady"
        As for :class:`skdgp.preprocessing.RegressorSelector`.
    reconstruction : "auto", transformer or "passthrough", default="auto"
        "auto": ``FlightPathReconstruction(optional=True, aircraft=aircraft)``, which reconstructs
        the flights if no sensor is missing or contradicts the others, and estimates gusts and lag
        of the servos of flights without vanes.
    cutoff : float, "auto" or None, default="auto"
        As for :class:`skdgp.preprocessing.FlightSmoother`.
    mixer : transformer or "passthrough", optional
        By default ``ElevonSplitter()``. "passthrough" for an aircraft that lacks an elevator or an
        aileron.
    regressor : estimator, optional
        By default ``DependentGPRegressor()``. It is cloned. Any regressor of several outputs will
        do.
    memory : str or joblib.Memory, optional
        Where fitted transformers are cached: a grid search over the regressor alone then smooths
        each flight once.
    lags : "auto", dict or None, default="auto"
        As for :class:`skdgp.preprocessing.LagCorrector`.

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
        reconstruction = FlightPathReconstruction(optional=True, aircraft=aircraft)
    # all for a named set, so that a search may choose; of a list its own
    derivatives = list(DIFFERENTIATED)
    if not isinstance(regressors, str):
        named = {str(name).removesuffix(HAT) for name in regressors}
        derivatives = [name for name in DIFFERENTIATED if f"{name}_dot" in named]
    steps = make_pipeline(
        FlightCheck(),
        LagCorrector(lags, aircraft=aircraft),
        FlightPathReconstruction(),
        FlightSmoother(cutoff=cutoff, derivatives=derivatives),
        ElevonSplitter(),
        RateNondimensionalizer(span=aircraft.span, chord=aircraft.chord),
        RegressorSelector(regressors),
        StandardScaler(),
        DependentGPRegressor() if regressor is None else clone(regressor),
    )
    pipeline = FlightPipeline(steps.steps, memory=memory)
    pipeline.set_params(flightpathreconstruction=reconstruction)
    return pipeline if mixer is None else pipeline.set_params(elevonsplitter=mixer)


def flight_regressors(pipeline: Pipeline, flight: pd.DataFrame) -> tuple[Matrix, Vector]:
    r"""Return the regressors (n, d) that a pipeline predicts from, and how much noisier they are than in the fit.

    In gusts the aerodynamics feel air that no sensor sees, so the variance of noisy regressors is
    proportional to the variance of the gusts. Where `FlightPathReconstruction` reconstructs
    flights, it estimates :math:`\sigma_g` [m/s in one second] of the flight, and the ratio of
    variances (n,) is

    .. math:: \frac{\sigma_g^2 + \sigma_0^2}{\sigma_{g,\mathrm{fit}}^2 + \sigma_0^2}, \quad \sigma_0 = 0.1 \mathrm{m/s}

    as ``include_input_noise`` of ``DependentGPRegressor.predict`` takes it. Elsewhere it is 1.

    As in the fit, a `FlightPipeline` removes the error of the airspeed from the flight, and
    frequencies beyond its ``band_`` from the regressors.
    """
    if isinstance(pipeline, FlightPipeline):
        flight = pipeline.corrected(flight)
        regressors, ratio = _regressors_of(pipeline, flight)
        return band_limited(regressors, flight, pipeline.band_), ratio
    return _regressors_of(pipeline, flight)


def _regressors_of(pipeline: Pipeline, flight: pd.DataFrame) -> tuple[Matrix, Vector]:
    """Return the regressors (n, d) by the steps of a pipeline, and the ratio of their variances (n,)."""
    ratio = np.ones(len(flight))
    for _, step in pipeline.steps[:-1]:
        if step in (None, "passthrough"):
            continue
        flight = step.transform(flight)
        if isinstance(step, FlightPathReconstruction) and step.used_ and "gust" in flight:
            variance = flight["gust"].to_numpy() ** 2 + SENSOR_GUST**2
            ratio = variance / (step.gust_std_**2 + SENSOR_GUST**2)
    return np.asarray(flight), ratio


def band_limited(values: Matrix, flights: pd.DataFrame, band: float) -> Matrix:
    """Return columns (n, k) of flights without frequencies beyond ``band`` [Hz]; as they are if it is infinite."""
    if np.isinf(band):
        return values
    time = flights["time"].to_numpy(float)
    cutoff = FittedFilter.up_to(band, values.shape[1])
    return smooth(values, time, flight=flights.get("flight"), cutoff=cutoff)


def regressor_names(pipeline: Pipeline) -> list[str]:
    """Return the names of the regressors of the last step."""
    return [str(name) for name in pipeline["regressorselector"].regressors_]


def reconstruction_of(pipeline: Pipeline) -> FlightPathReconstruction | None:
    """Return the step that reconstructs flights; None where flights pass it unchanged."""
    step = pipeline.named_steps.get("flightpathreconstruction")
    is_used = isinstance(step, FlightPathReconstruction) and step.used_
    return step if is_used else None


def lag_corrector_of(pipeline: Pipeline) -> LagCorrector | None:
    """Return the step that removes lags; None without one."""
    step = pipeline.named_steps.get("lagcorrector")
    return step if isinstance(step, LagCorrector) else None


class LogErrors(NamedTuple):
    """Errors that the flights of a log show, and that are removed from them."""

    airspeed: AirspeedScale = UNKNOWN_SCALE
    #: Highest frequency [Hz] of regressors, where flights vibrate and have vanes
    band: float = np.inf

    @property
    def cutoff(self) -> FittedFilter | str:
        """Cutoff of the coefficients: "auto", by their spectra, or the filter up to the band."""
        return cutoff_of(self.band)


def cutoff_of(band: float) -> FittedFilter | str:
    """Return the cutoff of the coefficients of flights whose regressors end at ``band`` [Hz]."""
    return "auto" if np.isinf(band) else band_filter(band)


class FlightPipeline(Pipeline):
    """Pipeline from flight tables to coefficients, with standard deviations for the gusts of the flight.

    The same as scikit-learn's ``Pipeline``, except that ``predict(flight, return_std=True)``
    includes the noise of the regressors, which is larger in rougher air, see
    :func:`flight_regressors`. Where flights vibrate, or legs of several headings show an error of
    their airspeed, the fit and predictions remove both from the regressors. So does ``transform`` of the
    first steps, such as ``pipeline[:-1]``, which gives the regressors of `predict`.

    Parameters
    ----------
    steps, transform_input, memory, verbose
        As of scikit-learn's ``Pipeline``.

    Attributes
    ----------
    turbulence_ : Turbulence or None
        Of the flights of the fit; None where `Turbulence.from_flight` raises an error for their
        table, which says why.
    control_units_ : dict of str to str
        Units of controls that differ from docs/notation.md, such as "full throw"; given by
        :func:`identify`, empty after another ``fit``.
    seconds_ : float or None
        Duration of the flights of the fit [s], without gaps; None without ``time``.
    band_ : float
        Highest frequency [Hz] of the regressors, where the flights of the fit vibrate and have
        vanes; else infinite.
    coefficient_filter_ : FittedFilter or "auto"
        Smoothing of the coefficients of the fit, with which those of other flights have the same
        noise; given by :func:`identify`, "auto" after another ``fit``.
    airspeed_scale_ : float
        Relative error of the airspeed that is removed from flights; zero where those of the fit
        do not show one.
    calibration_ : RegressionCalibration or None
        Added by ``predict`` to the function of the last step, where its slopes were estimated apart
        from the samples, as in flights without vanes. Simulations, derivatives and exports use the
        function.
    """

    steps: list[tuple[str, Any]]
    control_units_: Mapping[str, str] = MappingProxyType({})
    band_: float = np.inf
    coefficient_filter_: FittedFilter | str = "auto"
    airspeed_scale_: float = 0.0
    calibration_: RegressionCalibration | None = None

    def fit(self, X: pd.DataFrame, y: Any = None, **params: Any) -> FlightPipeline:
        """Fit all steps to flights X at their full rate and coefficients y (n, P), NaN where not to be learned from.

        A :class:`skdgp.DependentGPRegressor` at the end also gets ``time`` and ``flight`` of each
        row, unless metadata routing is enabled: request them there. ``params`` are as of
        scikit-learn's ``Pipeline``.
        """
        if get_config()["enable_metadata_routing"]:
            # scikit-learn's own fit leaves no place for a band
            self._keep_errors(self.errors_of_log(X)._replace(band=np.inf))
            self.calibration_ = None
            self.coefficient_filter_ = "auto"
            self.control_units_ = {}
            X = self.corrected(X)
            super().fit(X, y, **params)
            self._learn_turbulence(X)
        else:
            self.fit_returning_regressors(X, y, **params)
        return self

    def fit_returning_regressors(
        self,
        X: pd.DataFrame,
        y: Any,
        *,
        errors: LogErrors | None = None,
        choose_engine: bool = False,
        coefficient_filter: FittedFilter | str = "auto",
        control_units: Mapping[str, str] = MappingProxyType({}),
        **params: Any,
    ) -> Matrix:
        """Fit with ``params`` of the last step, and return the regressors (n, d) that it learned from.

        ``errors`` of the log are by default those that the flights show. ``choose_engine``: of throttle and airspeed
        the set of regressors gets those of `engine_regressors`. ``coefficient_filter`` is how y was smoothed,
        "auto" if that is unknown, ``control_units`` are those of controls that differ from docs/notation.md.
        """
        self._keep_errors(self.errors_of_log(X) if errors is None else errors)
        self.coefficient_filter_ = coefficient_filter
        self.control_units_ = dict(control_units)
        name, last = self.steps[-1]
        parameters = {key.removeprefix(f"{name}__"): value for key, value in params.items()}
        X = self.corrected(X)
        regressors, without_effect = self._fit_transforms(X, y, choose_engine)
        regressors = band_limited(regressors, X, self.band_)
        of_air = self._slopes_of_air(regressors, y)
        slopes = self._known_slopes(of_air, without_effect)
        last.fit(regressors, y, **slopes | self._clock(X) | parameters)
        self.calibration_ = None
        if of_air is not None:
            residuals = np.asarray(y, dtype=float) - last.predict(regressors)
            self.calibration_ = RegressionCalibration.of_residuals(
                regressors, residuals, without_effect
            )
        self._learn_turbulence(X)
        return regressors

    def errors_of_log(self, X: pd.DataFrame) -> LogErrors:
        """Return the errors that flights X show, without faults of their sensors.

        They are unknown without a step ``flightcheck``.
        """
        if not isinstance(X, pd.DataFrame) or "flightcheck" not in self.named_steps:
            return LogErrors()
        with without_warnings():  # the step itself warns
            checked = FlightCheck().fit_transform(X)
        return LogErrors(airspeed_scale(checked), vibration_band(checked))

    def _keep_errors(self, errors: LogErrors) -> None:
        """Keep the errors that predictions remove."""
        self.airspeed_scale_ = errors.airspeed.removable()
        self.band_ = errors.band

    def corrected(self, X: pd.DataFrame) -> pd.DataFrame:
        """Return flights X without the error of the airspeed."""
        return without_airspeed_error(X, self.airspeed_scale_)

    def __getitem__(self, ind: Any) -> Any:
        """Return a step, or a pipeline of the steps of a slice; the first steps keep the errors of the log."""
        part = super().__getitem__(ind)
        if isinstance(ind, slice) and part.steps[:1] == self.steps[:1]:
            part.airspeed_scale_ = self.airspeed_scale_
            part.band_ = self.band_
            if len(part) == len(self):
                part.calibration_ = self.calibration_
        return part

    def _ends_with_transform(self) -> bool:
        """Return whether the last step transforms."""
        last = self.steps[-1][1]
        return last in (None, "passthrough") or hasattr(last, "transform")

    @available_if(_ends_with_transform)
    def fit_transform(self, X: pd.DataFrame, y: Any = None, **params: Any) -> Any:
        """Fit all steps to flights, and transform these, without the errors of the log that they show."""
        self._keep_errors(self.errors_of_log(X))
        return self._in_band(super().fit_transform(self.corrected(X), y, **params), X)

    @available_if(_ends_with_transform)
    def transform(self, X: pd.DataFrame, **params: Any) -> Any:
        """Transform flights by all steps, without the errors of the log that the fit has found."""
        return self._in_band(super().transform(self.corrected(X), **params), X)

    def _in_band(self, values: Any, X: pd.DataFrame) -> Any:
        """Return regressors of flights X without frequencies beyond ``band_``, and other columns unchanged."""
        if np.isinf(self.band_) or "regressorselector" not in self.named_steps:
            return values
        limited = band_limited(np.asarray(values), X, self.band_)
        if isinstance(values, pd.DataFrame):
            return pd.DataFrame(limited, values.index, values.columns)
        return limited

    def _fit_transforms(
        self, X: pd.DataFrame, y: Any, choose_engine: bool
    ) -> tuple[Matrix, Matrix | None]:
        """Fit all steps but the last; return the regressors (n, d), and which are of no use to an output (P, d).

        The latter is None without a choice of the regressors of an engine.
        """
        place = list(self.named_steps).index("regressorselector")
        before = Pipeline(self.steps[:place], memory=self.memory)
        flights = before.fit_transform(X, y)
        without_effect = None
        if choose_engine:
            choice = engine_regressors(self[place], flights, y)
            self.set_params(regressorselector__regressors=choice.names)
            without_effect = choice.without_effect
        behind = Pipeline(self.steps[place:-1], memory=self.memory)
        regressors = np.asarray(behind.fit_transform(flights, y))
        # with a ``memory``, clones of the steps were fitted
        self.steps = [*before.steps, *behind.steps, self.steps[-1]]
        return regressors, without_effect

    def _known_slopes(
        self, slopes: KnownSlopes | None, without_effect: Matrix | None
    ) -> dict[str, KnownSlopes]:
        """Return the slopes that are known, as a parameter of the last step, if it uses them.

        These are zeros by the choice of the engine's regressors, and those of the motion of the air.
        """
        if not isinstance(self[-1], DependentGPRegressor):
            return {}
        if without_effect is not None and without_effect.any():
            slopes = KnownSlopes.with_zeros(slopes, without_effect)
        return {} if slopes is None else {"slopes": slopes}

    def _slopes_of_air(self, X: Matrix, y: Any) -> KnownSlopes | None:
        """Return the slopes that the motion of the air shows, for a last step that uses them.

        Where gusts are not known, least squares with the deviations of small aircraft in general.
        """
        reconstruction = reconstruction_of(self)
        if reconstruction is None or not isinstance(self[-1], DependentGPRegressor):
            return None
        outputs = list(y.columns) if isinstance(y, pd.DataFrame) else list(COEFFICIENTS)
        names = outputs, self.named_steps["regressorselector"].regressors_
        scaler = self.named_steps.get("standardscaler")
        scale = scaler.scale_ if isinstance(scaler, StandardScaler) else np.ones(X.shape[1])
        if reconstruction.air_motion_ is not None:
            return KnownSlopes(*reconstruction.air_motion_.slopes(*names)).scaled(scale)
        if reconstruction.doubt_ is not None:
            return KnownSlopes.of_samples(X, y, prior_deviations(*names) * scale)
        return None

    def _learn_turbulence(self, X):
        self.seconds_ = None
        if "time" in X:
            steps = np.diff(X["time"].to_numpy(float))
            forward = steps[steps > 0]
            self.seconds_ = float(len(X) * np.median(forward)) if forward.size else None
        self.turbulence_ = None
        rates = self.named_steps.get("ratenondimensionalizer")
        if rates is not None:
            with suppress(TypeError, ValueError):  # short flights, or columns that are missing
                self.turbulence_ = Turbulence.from_flight(X, rates.span)

    def _clock(self, X):
        """Return ``time`` and ``flight`` of the rows as parameters of the last step, if it uses them."""
        is_routed = get_config()["enable_metadata_routing"]
        if is_routed or not isinstance(self[-1], DependentGPRegressor) or "time" not in X:
            return {}
        clock = {"time": X["time"].to_numpy(float)}
        if "flight" in X:
            clock["flight"] = np.asarray(X["flight"])
        return clock

    def predict(self, X: pd.DataFrame, **params: Any) -> Any:
        """Predict the coefficients (n, P) of one or more flights at their full rate.

        ``params`` are for ``predict`` of the last step. ``return_std=True`` returns the
        standard deviation, too, with ``include_noise=True`` of new measurements.
        ``include_input_noise`` replaces the ratio of this flight, unless it is True.
        """
        uncertain = params.get("return_std") or params.get("return_cov")
        by_ratio = uncertain and params.get("include_input_noise", True) is True
        check_is_fitted(self)
        regressors, ratio = flight_regressors(self, X)
        if by_ratio and isinstance(self[-1], DependentGPRegressor):
            params = params | {"include_input_noise": ratio}
        if not uncertain:
            return self.mean_of_rows(regressors, ratio, **params)
        mean, uncertainty = self[-1].predict(regressors, **params)
        return mean + self._added(regressors, ratio), uncertainty

    def score(
        self, X: pd.DataFrame, y: Any = None, sample_weight: Any = None, **params: Any
    ) -> float:
        """Return the coefficient of determination R^2 of ``predict`` for observed coefficients, averaged.

        Coefficients y (n, 6) are NaN where they were not observed.
        """
        measured, mean = check_scored(y, self.predict(X, **params))
        check_consistent_length(measured, sample_weight)
        return r2_of_observed(measured, mean, sample_weight)

    def mean_of_rows(self, regressors: Matrix, noise_ratio: Vector, **params: Any) -> Matrix:
        """Return the mean coefficients (n, P) of logged rows, from the two of `flight_regressors`."""
        mean = self[-1].predict(regressors, **params)
        return np.asarray(mean + self._added(regressors, noise_ratio))

    def _added(self, regressors: Matrix, noise_ratio: Vector) -> Matrix | float:
        """Return what the calibration adds to the function."""
        if self.calibration_ is None:
            return 0.0
        return self.calibration_(regressors, noise_ratio)

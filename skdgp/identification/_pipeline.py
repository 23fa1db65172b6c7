"""The identification pipeline, and predictions for whole flights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from sklearn.base import clone
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp._flight.channels import SENSOR_GUST
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightCheck,
    FlightPathReconstruction,
    FlightSmoother,
    RateNondimensionalizer,
    RegressorSelector,
)

CALIBRATION_ROWS = 1500
DIFFERENTIATED = ("alpha", "beta", "p", "q", "r")


def make_identification_pipeline(
    aircraft: Aircraft,
    *,
    regressors: str | Sequence[str] = "quasi-steady",
    reconstruction="auto",
    cutoff: float | str | dict | None = "auto",
    mixer=None,
    regressor=None,
    memory=None,
) -> Pipeline:
    """Return the scikit-learn pipeline from a raw flight table to the six coefficients.

    ============================ ======================================================================================
    ``flightcheck``              faults of the log named and taken out, short gaps bridged
    ``flightpathreconstruction`` airspeed, alpha, beta, rates and attitude that fit each other and all sensors
    ``flightsmoother``           the rest of the sensor noise out, rates of change in, flight by flight, without delay
    ``elevonsplitter``           elevons into elevator and aileron; tables that hold these already pass
    ``ratenondimensionalizer``   p b / 2V, q c / 2V, ... with the aircraft's span and chord
    ``regressorselector``        the columns that are learned from
    ``standardscaler``           each to mean zero and variance one
    ``dependentgpregressor``     all six coefficients at once
    ============================ ======================================================================================

    The names are those of the steps, so ``dependentgpregressor__n_latent`` is a parameter for ``GridSearchCV``. Fit it
    on whole flights at their full rate, and choose the rows to learn from in the targets
    (:func:`skdgp.model_selection.thin_targets`). In cross-validation hold out flights: ``groups=table["flight"]``.

    Parameters
    ----------
    aircraft : Aircraft
        Its span and chord make rates non-dimensional.
    regressors : {"quasi-steady", "classical", "paper"} or list of str, default="quasi-steady"
        As for :class:`skdgp.preprocessing.RegressorSelector`.
    reconstruction : "auto", transformer or "passthrough", default="auto"
        "auto": ``FlightPathReconstruction(incomplete="pass")``, which reconstructs the flights if they hold all that
        this needs, and else leaves them to the smoother.
    cutoff : float, "auto", dict or None, default="auto"
        As for :class:`skdgp.preprocessing.FlightSmoother`.
    mixer : transformer or "passthrough", optional
        What turns surfaces into controls; by default ``ElevonSplitter()``. "passthrough" for an aircraft that lacks an
        elevator or an aileron.
    regressor : estimator, optional
        By default ``DependentGPRegressor(input_noise="learned")``. It is cloned. Any regressor of several outputs will
        do: a linear model for comparison.
    memory : str or joblib.Memory, optional
        Where fitted transformers are cached: a grid search over the regressor alone then smooths each flight once.

    Returns
    -------
    sklearn.pipeline.Pipeline
        ``predict(table)`` gives (n, 6), ``predict(table, return_std=True)`` also the standard deviations.

    Raises
    ------
    TypeError
        If ``aircraft`` is not an Aircraft.

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
    if not isinstance(aircraft, Aircraft):
        raise TypeError(
            f"Got {type(aircraft).__name__} for aircraft, but expected a skdgp.dynamics.Aircraft: read one with "
            "Aircraft.from_json(path) or Aircraft.from_toml(path)."
        )
    if isinstance(reconstruction, str) and reconstruction == "auto":
        reconstruction = FlightPathReconstruction(incomplete="pass")
    pipeline = make_pipeline(
        FlightCheck(),
        FlightPathReconstruction(),
        FlightSmoother(cutoff=cutoff, derivatives=_derivatives(regressors)),
        ElevonSplitter(),
        RateNondimensionalizer(span=aircraft.span, chord=aircraft.chord),
        RegressorSelector(regressors),
        StandardScaler(),
        DependentGPRegressor(input_noise="learned") if regressor is None else clone(regressor),
        memory=memory,
    )
    pipeline.set_params(flightpathreconstruction=reconstruction)
    return pipeline if mixer is None else pipeline.set_params(elevonsplitter=mixer)


def _derivatives(regressors):
    """Every rate of change of the named sets, so that a search may choose among them; of a list what it names."""
    if isinstance(regressors, str):
        return list(DIFFERENTIATED)
    named = {str(name).removesuffix("_hat") for name in regressors}
    return [name for name in DIFFERENTIATED if f"{name}_dot" in named]


def flight_regressors(pipeline: Pipeline, flight: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    r"""Return the regressors of a flight, (n, d), and how much noisier they are than those of the fit, (n,).

    In gusts the aerodynamics feel air that no sensor sees, so the variance of noisy regressors goes with that of the
    gusts. How gusty a flight is, :math:`\sigma_g` [m/s in one second], its own sensors tell where the pipeline
    reconstructs flight paths, and the variance is

    .. math:: \frac{\sigma_g^2 + \sigma_0^2}{\sigma_{g,\mathrm{fit}}^2 + \sigma_0^2}, \quad \sigma_0 = 0.1 \mathrm{m/s}

    times that of the fit: what ``include_input_noise`` of ``DependentGPRegressor.predict`` takes. Elsewhere it is 1.

    Parameters
    ----------
    pipeline : Pipeline
        Fitted.
    flight : DataFrame (n, ...)
        One or more flights at their full rate.

    Returns
    -------
    regressors : ndarray (n, d)
        What the last step of the pipeline predicts from.
    times : ndarray (n,)
        The factor.
    """
    times = np.ones(len(flight))
    for _, step in pipeline.steps[:-1]:
        if step in (None, "passthrough"):
            continue
        flight = step.transform(flight)
        if isinstance(step, FlightPathReconstruction) and not step.missing_ and "gust" in flight:
            times = (flight["gust"].to_numpy() ** 2 + SENSOR_GUST**2) / (step.gust_std_**2 + SENSOR_GUST**2)
    return np.asarray(flight), times


def predict_flight(pipeline: Pipeline, flight: pd.DataFrame, *, include_noise: bool = False):
    """Predict a flight with all that is known to be uncertain: the function, and the regressors in this flight's air.

    Parameters
    ----------
    pipeline : Pipeline
        Fitted; ends in a :class:`skdgp.DependentGPRegressor`.
    flight : DataFrame (n, ...)
        One or more flights at their full rate.
    include_noise : bool, default=False
        Whether the standard deviation is of a new measurement rather than of the coefficient.

    Returns
    -------
    mean, std : ndarray (n, P)
        See :func:`flight_regressors` for the part of the regressors.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import Aircraft
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> t = np.arange(0, 4, 0.1)
    >>> flight = pd.DataFrame({"time": t, "airspeed": 12.0, "alpha": 0.1 * np.sin(t), "q": 0.1 * np.cos(t)})
    >>> Y = pd.DataFrame({"CZ": -4 * flight.alpha, "Cm": -0.5 * flight.alpha - 0.2 * flight.q})
    >>> model = make_identification_pipeline(glider, regressors=["alpha", "q_hat"], cutoff=None, mixer="passthrough")
    >>> mean, std = predict_flight(model.fit(flight, Y), flight)
    >>> mean.shape, std.shape
    ((40, 2), (40, 2))
    """
    X, times = flight_regressors(pipeline, flight)
    return pipeline[-1].predict(X, return_std=True, include_noise=include_noise, include_input_noise=times)


def calibrate_noise(pipeline: Pipeline, flight: pd.DataFrame, Y: pd.DataFrame) -> np.ndarray:
    r"""Widen the noise of a fitted pipeline to what measurements that it did not learn from show.

    The likelihood sees a few hundred rows. At others of the same flights the residuals may be larger than it believes:
    gusts that no sensor feels differ from minute to minute. With residual e and standard deviation s of the function,
    at regressors as noisy as they are, the noise variance of each output becomes the larger of what it was and what
    makes

    .. math:: \frac{1}{n} \sum \frac{e^2}{s^2 + \sigma^2} = 1.

    The function and its standard deviation stay as they are; only ``include_noise=True`` gives wider bands.

    Parameters
    ----------
    pipeline : Pipeline
        Fitted, ends in a :class:`skdgp.DependentGPRegressor`. Its ``noise_variance_`` is changed.
    flight : DataFrame (n, ...)
        Whole flights at their full rate.
    Y : DataFrame or array (n, P)
        Measured coefficients; NaN where they were learned from, or not observed. At most 1500 rows are used, spread.

    Returns
    -------
    ndarray (P,)
        By what factor the standard deviation of the noise grew, 1 where it did not.

    Examples
    --------
    >>> from skdgp.model_selection import thin_targets
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import Aircraft
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> t = np.arange(0, 40, 0.1)
    >>> flight = pd.DataFrame({"time": t, "airspeed": 12.0, "alpha": 0.1 * np.sin(t), "q": 0.1 * np.cos(t)})
    >>> gusts = np.random.default_rng(0).normal(0, np.where(np.arange(400) % 8 == 4, 0.01, 0.03))
    >>> Y = pd.DataFrame({"CZ": -4 * flight.alpha + gusts})
    >>> model = make_identification_pipeline(glider, regressors=["alpha"], cutoff=None, mixer="passthrough")
    >>> learned = thin_targets(Y, 50)                  # by chance the calm moments
    >>> factor = calibrate_noise(model.fit(flight, learned), flight, Y.mask(learned.notna()))
    >>> bool(2 < factor[0] < 4)
    True
    """
    Y = np.asarray(Y, dtype=float).reshape(len(flight), -1)
    rows = np.flatnonzero(np.isfinite(Y).any(axis=1))
    rows = rows[:: max(1, -(-len(rows) // CALIBRATION_ROWS))]
    regressor = pipeline[-1]
    factor = np.ones(Y.shape[1])
    if len(rows):
        X, times = flight_regressors(pipeline, flight)
        mean, std = regressor.predict(X[rows], return_std=True, include_input_noise=times[rows])
        squares = (Y[rows] - mean.reshape(len(rows), -1)) ** 2
        variances = std.reshape(len(rows), -1) ** 2
        noise = np.array(regressor.noise_variance_)
        for i, (e2, s2) in enumerate(zip(squares.T, variances.T, strict=True)):
            seen = np.isfinite(e2)
            if seen.any():
                factor[i] = np.sqrt(_noise_that_fits(e2[seen], s2[seen], noise[i]) / noise[i])
        regressor.noise_variance_ = noise * factor**2
    return factor


def _noise_that_fits(squares, variances, noise) -> float:
    """Return the noise variance, at least the given one, at which mean(squares / (variances + noise)) is 1 or less."""
    if np.mean(squares / (variances + noise)) <= 1:
        return noise
    upper = squares.mean() + noise
    return brentq(lambda trial: np.mean(squares / (variances + trial)) - 1, noise, upper)

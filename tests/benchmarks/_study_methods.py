"""Methods of the study: what each finds from one log with stated causes of error."""

import warnings
from typing import NamedTuple

import numpy as np
import pandas as pd
from _study_flights import NAMES, ROTATION, SLOPES, TRIM_ALTITUDE
from scipy.ndimage import uniform_filter1d
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from skdgp import DependentGPRegressor
from skdgp._flight.channels import COEFFICIENTS, HAT, RATE_LENGTHS, rate_factor
from skdgp.dynamics import air_velocity, stability_derivatives
from skdgp.dynamics._derivatives import PARTS
from skdgp.identification import FlightPipeline
from skdgp.inference import autocorrelation_time
from skdgp.inference._slopes import _parabola, _Polynomial
from skdgp.preprocessing import RegressorSelector

CONTROLS = NAMES[-4:]
RATE = 40  # Hz, of the logs
EVERY = 10  # rows of the test flight per row that is scored
BINS = 60  # of the noise spectrum, evenly spread over the logarithm of frequency


class Case(NamedTuple):
    """What the training data hold."""

    inputs: str = "measured"
    targets: str = "measured"
    rates: str = "earth"
    slopes: str = "none"
    rows: str = "all"

    @property
    def columns(self):
        return [k for k in range(len(NAMES)) if self.slopes != "none" or k not in SLOPES]

    def table(self, seen):
        """Return regressors and targets of all rows."""
        X = seen.inputs[self.inputs].copy()
        if self.rates == "air":
            X[:, ROTATION] -= seen.log.gust
        if self.slopes == "exact":
            X[:, SLOPES] = seen.log.exact[:, SLOPES]
        Y = seen.targets[self.targets]
        if self.rows == "agitated":
            size = agitation(seen)
            Y = np.where((size > np.median(size))[:, None], Y, np.nan)
        return X[:, self.columns], Y

    @property
    def regressors(self):
        return [NAMES[k] + HAT * (NAMES[k] in RATE_LENGTHS) for k in self.columns]


def agitation(seen):
    """Return how large the roll rate is around each row, (n,): its root mean square over a second."""
    p = seen.log.exact[:, 2]
    return np.sqrt(uniform_filter1d((p - p.mean()) ** 2, RATE))


class Found(NamedTuple):
    """What a method found from one log."""

    function: np.ndarray
    """At the rows that are scored, (n, 6)."""
    function_std: np.ndarray | None
    slopes: np.ndarray
    """At the trim, (6, 11); NaN where the regressor is not in the case."""
    slopes_std: np.ndarray
    slopes_parts: np.ndarray | None = None
    """The `PARTS` of a deviation, (4, 6, 11)."""
    function_random: np.ndarray | None = None
    """Deviation of the function by errors correlated between samples, (n, 6), as ``std_random`` is of slopes."""


def asked_of(subject, case):
    """Return the regressors at which the function is scored."""
    return subject.test.exact[::EVERY, case.columns]


def widened(slopes, case):
    """Return (6, 11) of (6, d)."""
    wide = np.full((len(slopes), len(NAMES)), np.nan)
    wide[:, case.columns] = slopes
    return wide


# -- linear methods ------------------------------------------------------------------------------------


def line(X, Y, subject, case, instruments=None):
    """Return least squares, or two-stage least squares with instruments."""
    scaler = StandardScaler().fit(X)
    A = _with_ones(scaler.transform(X))
    fitted = A
    if instruments is not None:
        B = _with_ones(StandardScaler().fit_transform(instruments))
        fitted = B @ np.linalg.lstsq(B, A, rcond=None)[0]
    weights = np.linalg.lstsq(fitted, Y, rcond=None)[0]
    variance = ((Y - A @ weights) ** 2).sum(axis=0) / (len(Y) - A.shape[1])
    std = np.sqrt(np.outer(variance, np.diag(np.linalg.pinv(fitted.T @ fitted))[1:])) / scaler.scale_
    function = _with_ones(scaler.transform(asked_of(subject, case))) @ weights
    return Found(function, None, widened(weights[1:].T / scaler.scale_, case), widened(std, case))


def _with_ones(X):
    return np.column_stack([np.ones(len(X)), X])


def parabola(X, Y, subject, case):
    """Return least squares with all products of two regressors."""
    scaler, terms = StandardScaler().fit(X), PolynomialFeatures(2)
    weights = np.linalg.lstsq(terms.fit_transform(scaler.transform(X)), Y, rcond=None)[0]
    function = terms.transform(scaler.transform(asked_of(subject, case))) @ weights
    at, step = scaler.transform(subject.trim[None, case.columns]), 1e-4 * np.eye(X.shape[1])
    slopes = (terms.transform(at + step) - terms.transform(at - step)) @ weights / 2e-4
    return Found(function, None, widened(slopes.T / scaler.scale_, case), np.full((6, len(NAMES)), np.nan))


def lagged(values, seconds):
    """Return the columns delayed by 0, 0.1, ... ``seconds``, side by side."""
    shifts = range(0, round(seconds * RATE) + 1, RATE // 10)
    return np.hstack([np.roll(values, k, axis=0) for k in shifts])


def weighted(X, Y, subject, case, spectra):
    """Return least squares in the frequency domain, each frequency weighted by the known noise there.

    Its covariance is the Cramer-Rao bound of the linear function for regressors that are exact.
    """
    scaler = StandardScaler().fit(X)
    A = scaler.transform(X)
    F, G = (np.fft.rfft(part, axis=0)[1:] * np.sqrt(2 / len(part)) for part in (A, Y))
    weights = [F.conj().T / density for density in spectra]
    normal = np.array([(weight @ F).real for weight in weights])
    right = np.array([(weight @ g).real for weight, g in zip(weights, G.T, strict=True)])
    bound = np.linalg.pinv(normal, hermitian=True)
    weights = np.einsum("ijk,ik->ij", bound, right)
    asked = scaler.transform(asked_of(subject, case))
    std = np.sqrt(np.einsum("nj,ijk,nk->ni", asked, bound, asked).clip(0))
    slopes_std = np.sqrt(np.einsum("ijj->ij", bound).clip(0)) / scaler.scale_
    return Found(
        Y.mean(axis=0) + asked @ weights.T, std, widened(weights / scaler.scale_, case), widened(slopes_std, case)
    )


def noise_spectra(subject, logs):
    """Return the spectra (6, n_frequencies) of what exact regressors leave of raw targets: sensors, and unseen rates.

    Averaged over the logs, and over bins of frequency.
    """
    powers = []
    for seen in logs:
        error = seen.targets["raw"] - seen.log.truth - seen.log.gust @ subject.known[:, ROTATION].T
        powers.append(np.abs(np.fft.rfft(error, axis=0)[1:]) ** 2 / len(error))
    power = np.mean(powers, axis=0).T
    frequency = np.log(np.arange(1, power.shape[1] + 1))
    bins = np.minimum((frequency / frequency[-1] * BINS).astype(int), BINS - 1)
    count = np.bincount(bins, minlength=BINS)
    centre = np.bincount(bins, frequency, BINS)[count > 0] / count[count > 0]
    means = (np.bincount(bins, row, BINS)[count > 0] / count[count > 0] for row in power)
    return np.array([np.exp(np.interp(frequency, centre, np.log(mean))) for mean in means])


def process(subject, seen, case, seed, changes, kernel=None, max_iter=60):
    """Return what the default regressor finds; with ``kernel`` at known hyperparameters and known noise."""
    X, Y = case.table(seen)
    options = {name: value for name, value in changes.items() if name == "symmetric"}
    changes = {name: value for name, value in changes.items() if name not in options}
    model = DependentGPRegressor(random_state=seed, max_iter=max_iter, **changes)
    if kernel is not None:
        model.set_params(kernel=kernel, trend="constant", optimizer=None, input_noise=None, inference="sparse")
    pipeline = learned(model, X, Y, case, seen.log.table, **options)
    if kernel is not None:
        error = seen.targets["measured"] - seen.log.truth - seen.log.gust @ subject.known[:, ROTATION].T
        known = error.var(axis=0) * [autocorrelation_time(e) for e in error.T]
        model = pipeline[-1]
        model.posterior_ = model.posterior_.with_noise(known / model.scale_**2)
    random = correlated(X, Y, asked_of(subject, case))
    return known_by(pipeline, subject, case)._replace(function_random=random), pipeline[-1].kernel_


def known_by(pipeline, subject, case):
    """Return what a pipeline from the regressors of a case to coefficients knows."""
    asked = pd.DataFrame(asked_of(subject, case), columns=case.regressors)
    function, std = pipeline.predict(asked, return_std=True, include_input_noise=False)
    slopes, slopes_std, *parts = slopes_of(pipeline, subject, case, ("value", "std", *PARTS))
    return Found(function, std, slopes, slopes_std, np.array(parts))


def correlated(X, Y, asked):
    """Return the deviation (n, 6) of the polynomial of second order by its errors over blocks of the log."""
    scaler = StandardScaler().fit(X)
    z, terms = scaler.transform(X), _parabola(scaler.transform(asked))
    fits = [_Polynomial(_parabola, z[known], y[known]) for y, known in zip(Y.T, np.isfinite(Y).T, strict=True)]
    return np.sqrt(np.transpose([((terms @ fit.errors.T) ** 2).sum(axis=1) for fit in fits]))


def learned(model, X, Y, case, table, **options):
    """Return the pipeline from the regressors of a case to coefficients, learned without a word."""
    steps = [("selector", RegressorSelector(case.regressors)), ("scaler", StandardScaler()), ("model", model)]
    flight = pd.DataFrame(X, columns=case.regressors)
    flight = flight.assign(time=table["time"].to_numpy(), flight=table["flight"].to_numpy())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return FlightPipeline(steps, **options).fit(flight, pd.DataFrame(Y, columns=COEFFICIENTS))


def slopes_of(pipeline, subject, case, columns):
    """Return columns of the table of derivatives at the trim, (6, 11) each."""
    at = dict(zip(NAMES, subject.trim, strict=True))
    rates = [
        at[name] / rate_factor(name, getattr(subject.aircraft, RATE_LENGTHS[name]), subject.speed) for name in "pqr"
    ]
    attitude = [np.cos(at["alpha"] / 2), 0.0, np.sin(at["alpha"] / 2), 0.0]
    velocity = air_velocity(subject.speed, at["alpha"], at["beta"])
    state = np.concatenate([[0.0, 0.0, -TRIM_ALTITUDE], velocity, attitude, rates])
    controls = {name: at[name] for name in CONTROLS}
    table = stability_derivatives(pipeline, subject.aircraft, state, controls, thrust=None)
    table = table[table["coefficient"].isin(COEFFICIENTS) & (table["regressor"] != "")]
    return (widened(table[name].to_numpy().reshape(6, -1), case) for name in columns)

"""Methods of the study: what each finds from one log with stated causes of error."""

import warnings
from typing import NamedTuple

import numpy as np
import pandas as pd
from _study_flights import NAMES, ROTATION, SLOPES, TRIM_ALTITUDE
from scipy.ndimage import uniform_filter1d
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp._flight.channels import COEFFICIENTS, HAT, RATE_LENGTHS, rate_factor
from skdgp.dynamics import air_velocity, stability_derivatives
from skdgp.identification import FlightPipeline
from skdgp.inference import autocorrelation_time
from skdgp.preprocessing import RegressorSelector

CONTROLS = NAMES[-4:]
RATE = 40  # Hz, of the logs
EVERY = 10  # rows of the test flight per row that is scored


class Case(NamedTuple):
    """What the training data hold."""

    inputs: str = "measured"
    targets: str = "measured"
    rates: str = "earth"
    slopes: str = "none"

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
        return X[:, self.columns], seen.targets[self.targets]

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
    slopes_posterior: np.ndarray | None = None
    """The deviation by the posterior alone, (6, 11)."""


def asked_of(subject, case):
    """Return the regressors at which the function is scored."""
    return subject.test.exact[::EVERY, case.columns]


def widened(slopes, case):
    """Return (6, 11) of (6, d)."""
    wide = np.full((len(slopes), len(NAMES)), np.nan)
    wide[:, case.columns] = slopes
    return wide


def line(X, Y, subject, case):
    """Return what least squares finds."""
    scaler = StandardScaler().fit(X)
    A = _with_ones(scaler.transform(X))
    weights = np.linalg.lstsq(A, Y, rcond=None)[0]
    variance = ((Y - A @ weights) ** 2).sum(axis=0) / (len(Y) - A.shape[1])
    std = np.sqrt(np.outer(variance, np.diag(np.linalg.pinv(A.T @ A))[1:])) / scaler.scale_
    function = _with_ones(scaler.transform(asked_of(subject, case))) @ weights
    return Found(function, None, widened(weights[1:].T / scaler.scale_, case), widened(std, case))


def _with_ones(X):
    return np.column_stack([np.ones(len(X)), X])


def process(subject, seen, case, seed, changes, kernel=None, max_iter=60):
    """Return what the default regressor finds; with ``kernel`` at known hyperparameters and known noise."""
    X, Y = case.table(seen)
    options = {name: value for name, value in changes.items() if name == "symmetric"}
    changes = {name: value for name, value in changes.items() if name not in options}
    model = DependentGPRegressor(random_state=seed, max_iter=max_iter, **changes)
    if kernel is not None:
        model.set_params(
            kernel=kernel, trend="constant", optimizer=None, input_noise=None, inference="sparse"
        )
    pipeline = learned(model, X, Y, case, seen.log.table, **options)
    if kernel is not None:
        error = (
            seen.targets["measured"] - seen.log.truth - seen.log.gust @ subject.known[:, ROTATION].T
        )
        known = error.var(axis=0) * [autocorrelation_time(e) for e in error.T]
        model = pipeline[-1]
        model.posterior_ = model.posterior_.with_noise(known / model.scale_**2)
    return known_by(pipeline, subject, case), pipeline[-1].kernel_


def known_by(pipeline, subject, case):
    """Return what a pipeline from the regressors of a case to coefficients knows."""
    asked = pd.DataFrame(asked_of(subject, case), columns=case.regressors)
    function, std = pipeline.predict(asked, return_std=True, include_input_noise=False)
    return Found(
        function, std, *slopes_of(pipeline, subject, case, ("value", "std", "std_posterior"))
    )


def learned(model, X, Y, case, table, **options):
    """Return the pipeline from the regressors of a case to coefficients, learned without a word."""
    steps = [
        ("selector", RegressorSelector(case.regressors)),
        ("scaler", StandardScaler()),
        ("model", model),
    ]
    flight = pd.DataFrame(X, columns=case.regressors)
    flight = flight.assign(time=table["time"].to_numpy(), flight=table["flight"].to_numpy())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return FlightPipeline(steps, **options).fit(flight, pd.DataFrame(Y, columns=COEFFICIENTS))


def slopes_of(pipeline, subject, case, columns):
    """Return columns of the table of derivatives at the trim, (6, 11) each."""
    at = dict(zip(NAMES, subject.trim, strict=True))
    rates = [
        at[name] / rate_factor(name, getattr(subject.aircraft, RATE_LENGTHS[name]), subject.speed)
        for name in "pqr"
    ]
    attitude = [np.cos(at["alpha"] / 2), 0.0, np.sin(at["alpha"] / 2), 0.0]
    velocity = air_velocity(subject.speed, at["alpha"], at["beta"])
    state = np.concatenate([[0.0, 0.0, -TRIM_ALTITUDE], velocity, attitude, rates])
    controls = {name: at[name] for name in CONTROLS}
    table = stability_derivatives(pipeline, subject.aircraft, state, controls, thrust=None)
    table = table[table["coefficient"].isin(COEFFICIENTS) & (table["regressor"] != "")]
    return (widened(table[name].to_numpy().reshape(6, -1), case) for name in columns)

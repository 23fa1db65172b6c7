"""What is compared: regressors made from a flight table in three ways, and methods with the settings they are given."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from _peers import EquationError, ExactLCM, IndependentProcesses, OnTrend, SparseLCM, trees
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.identification import flight_regressors
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightPathReconstruction,
    FlightSmoother,
    RateNondimensionalizer,
    RegressorSelector,
)


def finite_differences(table):
    """Add the slopes of alpha and beta as central differences, flight by flight."""
    names, table = ["alpha", "beta"], table.copy()
    flight = table["flight"] if "flight" in table else np.zeros(len(table))
    for _, part in table.groupby(flight, observed=True):
        slopes = np.gradient(part[names].to_numpy(float), part["time"].to_numpy(float), axis=0)
        table.loc[part.index, [f"{name}_dot" for name in names]] = slopes
    return table


def classical(*first):
    """Return what makes the steps that lead to the scaled classical regressors, for an aircraft."""
    return lambda aircraft: make_pipeline(
        *first,
        ElevonSplitter(),
        RateNondimensionalizer(span=aircraft.span, chord=aircraft.chord),
        RegressorSelector("classical"),
        StandardScaler(),
    )


INPUTS = {
    "filtered": classical(FlightSmoother()),
    "reconstructed": classical(FlightPathReconstruction(), FlightSmoother()),
    "raw": classical(FunctionTransformer(finite_differences)),
    "own": lambda aircraft: make_identification_pipeline(aircraft)[:-1],
}


def regressors(kind, task):
    """Return the scaled regressors (n, d) of the flight to learn from and of the one to predict."""
    steps = INPUTS[kind](task.aircraft)
    return np.asarray(steps.fit_transform(task.train)), np.asarray(steps.transform(task.test))


class Dependent:
    """DependentGPRegressor behind the face of the peers."""

    def __init__(self, **parameters):
        self.regressor = DependentGPRegressor(random_state=0, **parameters)

    def fit(self, X, Y):
        self.regressor.fit(X, Y)
        return self

    def predict(self, X):
        return self.regressor.predict(X)

    def bands(self, X):
        return tuple(
            self.regressor.predict(X, return_std=True, include_noise=noise)[1]
            for noise in (False, True)
        )


class Identification:
    """The whole pipeline, from flight tables, as the command line fits it.

    ``arguments`` are those of ``make_identification_pipeline``, ``parameters`` what its
    ``set_params`` is given, ``samples`` how many are learned from where not all.
    """

    def __init__(self, arguments=None, parameters=None, *, samples=None):
        self.arguments, self.parameters, self.samples = arguments or {}, parameters or {}, samples

    def fit_flight(self, task):
        learned = task.targets if self.samples is None else thin_targets(task.targets, self.samples)
        pipeline = make_identification_pipeline(task.aircraft, **self.arguments)
        seeds = {name: 0 for name in pipeline.get_params() if name.endswith("random_state")}
        self.pipeline = (
            pipeline.set_params(**seeds).set_params(**self.parameters).fit(task.train, learned)
        )
        return self

    def transform(self, table):
        """Return the regressors and, last, how much noisier they are than those of the fit."""
        return np.column_stack(flight_regressors(self.pipeline, table))

    def predict(self, X):
        return self.pipeline[-1].predict(X[:, :-1])

    def bands(self, X):
        words = {"return_std": True, "include_input_noise": X[:, -1]}
        return tuple(
            self.pipeline[-1].predict(X[:, :-1], include_noise=noise, **words)[1]
            for noise in (False, True)
        )


class Method(NamedTuple):
    """A method as a row of the tables: what it is called, what it was given, how it is made."""

    name: str
    settings: str
    make: Callable
    all_samples: bool = False
    gpytorch: bool = False
    ours: bool = False
    whole: bool = False  # takes flight tables rather than regressors


WIDTHS = "RBF with a width for each regressor, started at 3"
STEPWISE = "products up to {} order, forward selection by F-test (5 %) and predicted square error"
LCM = "six RBF kernels of rank 1; GPyTorch's single precision and conjugate gradients; 100 steps of Adam, rate .1"
SPARSE = "six latents, 150 inducing points each, 2000 steps of Adam on batches of 512, rate .02"
BOOSTED = "HistGradientBoostingRegressor, its defaults"

METHODS = {
    "ols": Method("least squares", "linear in the regressors", EquationError),
    "ols_all": Method("least squares", "linear in the regressors", EquationError, all_samples=True),
    "stepwise2": Method(
        "stepwise, second order", STEPWISE.format("second"), lambda: EquationError(2, stepwise=True)
    ),
    "stepwise2_all": Method(
        "stepwise, second order",
        STEPWISE.format("second"),
        lambda: EquationError(2, stepwise=True),
        all_samples=True,
    ),
    "stepwise3": Method(
        "stepwise, third order", STEPWISE.format("third"), lambda: EquationError(3, stepwise=True)
    ),
    "stepwise3_all": Method(
        "stepwise, third order",
        STEPWISE.format("third"),
        lambda: EquationError(3, stepwise=True),
        all_samples=True,
    ),
    "trees": Method(
        "boosted trees", BOOSTED, lambda: OnTrend(trees(), linear=False), all_samples=True
    ),
    "trees_trend": Method(
        "trend + boosted trees", BOOSTED, lambda: OnTrend(trees()), all_samples=True
    ),
    "gp_trend": Method(
        "trend + six scikit-learn GPs",
        f"{WIDTHS}; noise learned",
        lambda: OnTrend(IndependentProcesses()),
    ),
    "svgp_trend": Method(
        "trend + GPyTorch sparse LCM",
        SPARSE,
        lambda: OnTrend(SparseLCM()),
        all_samples=True,
        gpytorch=True,
    ),
    "lcm_trend": Method(
        "trend + GPyTorch LCM",
        f"{LCM}; widths started at 3",
        lambda: OnTrend(ExactLCM(length_scale=3.0)),
        gpytorch=True,
    ),
    "gp": Method(
        "six scikit-learn GPs",
        f"{WIDTHS}; noise learned",
        lambda: OnTrend(IndependentProcesses(), linear=False),
    ),
    "lcm": Method(
        "GPyTorch LCM",
        f"{LCM}; widths started at .69",
        lambda: OnTrend(ExactLCM(), linear=False),
        gpytorch=True,
    ),
    "ours": Method(
        "**skdgp regressor**", "DependentGPRegressor, its defaults", Dependent, ours=True
    ),
    "ours_all": Method(
        "**skdgp regressor, sparse**",
        'DependentGPRegressor(inference="sparse")',
        lambda: Dependent(inference="sparse"),
        all_samples=True,
        ours=True,
    ),
    "pipeline": Method(
        "**skdgp pipeline**",
        "make_identification_pipeline, its defaults",
        Identification,
        all_samples=True,
        ours=True,
        whole=True,
    ),
}
ORDER = (
    "ols",
    "ols_all",
    "stepwise2",
    "stepwise2_all",
    "stepwise3",
    "stepwise3_all",
    "trees",
    "trees_trend",
)
ORDER += ("gp", "gp_trend", "lcm", "lcm_trend", "svgp_trend", "ours", "ours_all", "pipeline")

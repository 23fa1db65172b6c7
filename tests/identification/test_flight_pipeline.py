"""Bands of the flight's own air, by scikit-learn's own calls; least squares beside the model."""

import pickle

import numpy as np
import pandas as pd
import pytest
from made_flights import make_flight
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.decomposition import PCA
from sklearn.linear_model import LinearRegression
from sklearn.preprocessing import RobustScaler, StandardScaler

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification import flight_regressors, identify
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import ElevonSplitter

QUICK = {"n_latent": 1, "max_iter": 4, "input_noise": "learned", "random_state": 0}


def first_rows(table, n):
    """Return the first rows of each flight."""
    return table.groupby("flight", observed=True).head(n).reset_index(drop=True)


@pytest.fixture(scope="module")
def flights(first_minute):
    """Return the example flights, of those to learn from the first 50 s."""
    flights = first_minute()
    flights.train = first_rows(flights.train, 2000)
    return flights


@pytest.fixture(scope="module")
def model(flights, cut_short):
    train = first_rows(flights.train, 400)
    targets = thin_targets(aerodynamic_coefficients(train, flights.aircraft), 60)
    pipeline = make_identification_pipeline(
        flights.aircraft, regressor=DependentGPRegressor(**QUICK)
    )
    with cut_short():
        return pipeline.fit(train, targets)


@pytest.fixture(scope="module")
def few(flights):
    """Return a few seconds of each flight, and some of their coefficients."""
    rows = first_rows(flights.train, 300)
    return rows, thin_targets(aerodynamic_coefficients(rows, flights.aircraft), 100)


@pytest.fixture(scope="module")
def test_flight(flights):
    return flights.test.iloc[:200]


# Columns of the example flights whose sign changes in a mirror at the x-z plane
ODD = [
    "beta",
    "p",
    "r",
    "ay",
    "phi",
    "psi",
    "east",
    "v_east",
    "aileron",
    "rudder",
    "thrust_y",
    "thrust_l",
    "thrust_n",
]


@pytest.mark.slow
def test_a_mirrored_flight_is_the_same_physics(flights, test_flight):
    """The mirrored aircraft on mirrored flights has the mirrored coefficients, with the same deviations.

    After any number of iterations.
    """
    quick = DependentGPRegressor(**QUICK | {"structure": "joint", "max_iter": 2})
    turned = np.diag([1.0, -1.0, 1.0])
    record = flights.aircraft.to_dict()
    record["inertia"] = turned @ record["inertia"] @ turned
    record["propeller"]["rotation"] *= -1
    aircraft = {1: flights.aircraft, -1: Aircraft.from_dict(record)}

    def seen(table, side):
        table = table.assign(**{name: side * table[name] for name in ODD if name in table})
        exchanged = {"elevon_left": "elevon_right", "elevon_right": "elevon_left"}
        return table if side > 0 else table.rename(columns=exchanged)

    found = {}
    for side in (1, -1):
        train = seen(flights.train.iloc[:400], side)
        pipeline = make_identification_pipeline(aircraft[side], regressor=clone(quick))
        pipeline.fit(train, thin_targets(aerodynamic_coefficients(train, aircraft[side]), 60))
        found[side] = pipeline.predict(seen(test_flight.iloc[:200], side), return_std=True)
    mean, std = found[1]
    mirrored, deviation = found[-1]
    assert (np.abs(mean - mirrored * [1, -1, 1, -1, 1, -1]) < 0.05 * std).all()
    assert_allclose(deviation, std, rtol=0.05)


class TestPredict:
    def test_the_band_knows_how_rough_the_air_was(self, model, test_flight):
        """The variance that regressors carry is multiplied by the gusts of the flight over those of the fit."""
        X, ratio, *_ = flight_regressors(model, test_flight)
        reconstruction = model["flightpathreconstruction"]
        gust = reconstruction.transform(test_flight)["gust"]
        fit = reconstruction.gust_std_
        assert_allclose(ratio, (gust**2 + 0.1**2) / (fit**2 + 0.1**2), rtol=1e-9)
        assert not np.allclose(ratio, 1.0, rtol=0.02)  # another flight, other air
        found = model.predict(test_flight, return_std=True)
        expected = model[-1].predict(X, return_std=True, include_input_noise=ratio)
        assert_array_equal(found, expected)

    def test_flights_of_different_rates_last_as_long_as_each_of_them(self, delta):
        levels = {"alpha": (0, 0.1, 0), "airspeed": (20, 0, 0), "p q r": (0, 0, 0)}
        fast = make_flight(levels, 1000, 0.02).assign(flight="fast")
        slow = make_flight(levels, 1100, 0.1).assign(flight="slow")
        flight = pd.concat([fast, slow], ignore_index=True)
        fitted = make_identification_pipeline(
            delta,
            regressors=["alpha"],
            reconstruction="passthrough",
            regressor=LinearRegression(),
        ).fit(flight, pd.DataFrame({"CZ": -4 * flight["alpha"]}))
        assert_allclose(fitted.seconds_, 130, rtol=1e-3)


def test_nothing_is_learned_before_the_servos_forget_what_was_not_logged(flights, few):
    """A hundredth is left of an unknown deflection once the delay and ln 100 time constants passed."""
    rows, _ = few
    pipeline = make_identification_pipeline(
        flights.aircraft,
        reconstruction="passthrough",
        lags={"servos": 0.05, "surfaces": -0.03},
        regressor=DependentGPRegressor(structure="trend", max_iter=2),
    ).fit(rows, aerodynamic_coefficients(rows, flights.aircraft))
    since = rows["time"] - rows.groupby("flight", observed=True)["time"].transform("min")
    assert pipeline.n_learned_ == (since > 0.03 + 0.05 * np.log(100)).sum() < pipeline.n_observed_


def test_logged_rows_are_predicted_as_the_samples_say_in_any_air(flights, test_flight):
    """Their regressors have the noise of those of the fit; the function has steeper slopes."""
    rows = flights.train
    Y = thin_targets(aerodynamic_coefficients(rows, flights.aircraft), 1500)
    regressor = DependentGPRegressor(structure="trend", max_iter=2, random_state=0)
    pipeline = make_identification_pipeline(flights.aircraft, regressor=regressor).fit(rows, Y)
    X, ratio, *_ = flight_regressors(pipeline, test_flight)
    assert not np.allclose(ratio, 1.0, rtol=0.02)
    learned, *_ = flight_regressors(pipeline, rows)
    alone = clone(regressor).fit(learned, Y, time=rows["time"], flight=rows["flight"]).predict(X)
    size = np.std(alone, axis=0)
    assert_allclose(pipeline.predict(test_flight) / size, alone / size, atol=1e-6)
    assert np.abs((pipeline[-1].predict(X) - alone) / size).max() > 0.01


def test_errors_of_slopes_by_instruments_are_of_every_row(flights):
    regressor = DependentGPRegressor(structure="trend", max_iter=2, random_state=0)
    errors = []
    for samples in (100, 4000):
        pipeline = make_identification_pipeline(
            flights.aircraft, regressor=regressor, samples=samples
        )
        errors.append(pipeline.fit(flights.train)[-1].slopes_.errors)
    assert_allclose(*errors, rtol=1e-6)


def test_the_scaler_may_be_left_out_or_another(model, few, test_flight):
    """Least squares beside the model are in units, and the same."""
    rows, targets = few
    learned = []
    for scaler in (StandardScaler(), RobustScaler()):
        pipeline = clone(model).set_params(
            standardscaler=scaler,
            flightpathreconstruction="passthrough",
            dependentgpregressor=DependentGPRegressor(structure="trend", max_iter=2),
        )
        learned.append(pipeline.fit(rows, targets))
    with pytest.raises(ValueError, match=r"\['PCA'\] behind RegressorSelector"):
        clone(learned[0]).set_params(standardscaler=PCA()).fit(rows, targets)
    without = clone(learned[0])
    without.steps = [step for step in without.steps if step[0] != "standardscaler"]
    learned.append(without.fit(rows, targets))
    for pipeline in learned[1:]:
        assert_allclose(pipeline.least_squares_, learned[0].least_squares_, rtol=1e-6, atol=1e-9)
        assert np.isfinite(pipeline.predict(test_flight, return_std=True)[1]).all()


def test_surfaces_of_any_name_are_those_that_they_are_mixed_into(flights, few, test_flight):
    """In every step: lags, reconstruction and errors of the log are of elevator, aileron and rudder."""
    rows, targets = few
    halves = {
        "elevator": {"tail_left": 0.5, "tail_right": 0.5},
        "rudder": {"tail_left": 0.5, "tail_right": -0.5},
    }

    def plain(table):
        return ElevonSplitter().fit_transform(table).drop(columns=["elevon_left", "elevon_right"])

    def tailed(table):
        table = plain(table)
        left, right = (table["elevator"] + side * table["rudder"] for side in (1, -1))
        table = table.assign(tail_left=left, tail_right=right)
        return table.drop(columns=["elevator", "rudder"])

    found = []
    for mixer, seen in ((None, plain), (ElevonSplitter(halves), tailed)):
        regressor = DependentGPRegressor(structure="trend", max_iter=2)
        pipeline = make_identification_pipeline(flights.aircraft, mixer=mixer, regressor=regressor)
        pipeline.fit(seen(rows), targets)
        found.append(pipeline.predict(seen(test_flight), return_std=True))
    assert_allclose(found[1], found[0], rtol=1e-6, atol=1e-9)


def test_the_order_and_number_of_targets_change_no_band(model, few, test_flight):
    rows, targets = few
    names = [*targets]
    quick = clone(model).set_params(
        flightpathreconstruction="passthrough",
        dependentgpregressor=DependentGPRegressor(
            structure="trend", input_noise=None, optimizer=None
        ),
    )

    def predicted(order):
        found = clone(quick).fit(rows, targets[order]).predict(test_flight, return_std=True)
        return [pd.DataFrame(part, columns=order) for part in found]

    mean, std = predicted(names)
    for order in (names[::-1], ["CY", "Cl"]):
        for part, expected in zip(predicted(order), (mean, std), strict=True):
            assert_allclose(part / std[order], expected[order] / std[order], atol=0.05)


def test_coefficients_are_asked_for(model, test_flight):
    with pytest.raises(ValueError, match="Got neither coefficients y nor an aircraft"):
        clone(model).set_params(aircraft=None).fit(test_flight)


@pytest.mark.usefixtures("no_mechanics")
def test_the_fit_of_identify_is_that_of_the_pipeline(flights, test_flight):
    """To the bit, also of a clone and of a saved model."""
    train, aircraft = first_rows(flights.train, 400), flights.aircraft
    regressor = DependentGPRegressor(structure="trend", max_iter=2, random_state=0)
    options = {"regressor": regressor, "samples": 100}
    found = identify(train, aircraft, test=test_flight, horizon=1.0, **options).pipeline
    Y = aerodynamic_coefficients(train, aircraft)
    model = make_identification_pipeline(aircraft, **options)
    saved = pickle.loads(pickle.dumps(found))
    wanted = found.predict(test_flight, return_std=True)
    for other in (clone(model).fit(train, Y), clone(model).fit(train), saved):
        assert_array_equal(other.predict(test_flight, return_std=True), wanted)


@pytest.mark.usefixtures("no_mechanics")
class TestLeastSquares:
    def test_is_that_of_the_same_rows(self, flights):
        """Refitted here by scikit-learn on what the regressor got."""
        train = flights.train.iloc[:500]
        test = flights.test.iloc[:400]
        regressor = DependentGPRegressor(
            structure="trend", max_iter=1, input_noise=None, random_state=0
        )
        result = identify(
            train, flights.aircraft, test=test, samples=120, regressor=regressor, horizon=2.0
        )
        targets = thin_targets(aerodynamic_coefficients(train, flights.aircraft), 120)
        rows = targets.notna().all(axis=1)
        X, Xt = (result.pipeline[:-1].transform(table) for table in (train, test))
        linear = LinearRegression().fit(X[rows], targets[rows])
        (evaluation,) = result.evaluations
        assert_allclose(evaluation.baseline, linear.predict(Xt), rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("missing", ["flightcheck", "regressorselector"])
def test_a_step_that_flights_need_is_asked_for(missing, flights):
    train = flights.train[:200]
    model = make_identification_pipeline(flights.aircraft)
    model.steps = [(name, step) for name, step in model.steps if name != missing]
    with pytest.raises(ValueError, match=f"expected a step '{missing}'"):
        model.fit(train, aerodynamic_coefficients(train, flights.aircraft))


def test_steps_pass_pandas_and_no_polars(flights):
    pytest.importorskip("polars")
    train = flights.train[:200]
    model = make_identification_pipeline(flights.aircraft).set_output(transform="polars")
    with pytest.raises(TypeError, match=r"Got .*polars.* but expected a pandas .*set_output"):
        model.fit(train, aerodynamic_coefficients(train, flights.aircraft))

"""Whether an aircraft has changed since its model was learned."""

import numpy as np
import pandas as pd
import pytest
from made_flights import lasting
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.signal import lsim
from scipy.stats import kstest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp._flight.clock import Clock
from skdgp.identification import Compared, changes_of
from skdgp.preprocessing import RegressorSelector

NAMES = ["alpha", "q_hat", "elevator"]
STEP = 0.05  # s
ALPHA_NOISE = 0.03
# force coefficients of 1 m/s^2: mass over dynamic pressure and wing area of 12 kg, 20 m/s, 1.3 m^2
BY_ACCELERATION = 0.04
SLOPES = np.array([[0.3, 0.0, -4.0, 0.0, -0.5, 0.0], [0.0] * 6, [0.0] * 4 + [-0.6, 0.0]])


def short_period(elevator):
    """Return alpha, q and elevator (n, 3) of the motion that an elevator (n,) excites."""
    system = [[-2.0, 1.0], [-20.0, -3.0]], [[0.0], [-20.0]], np.eye(2), np.zeros((2, 1))
    _, response, _ = lsim(system, elevator, STEP * np.arange(len(elevator)), interp=False)
    return np.column_stack([response, elevator])


def flown(seed, size, n=1500):
    """Return the regressors of a short period that steps of the elevator excite, and of slow changes."""
    rng = default_rng(seed)
    motion = short_period(np.repeat(rng.normal(size=n // 15), 15))
    motion = motion / motion.std(axis=0) + 0.3 * lasting(rng, (n, 3), 100)
    return pd.DataFrame(0.1 * size * motion, columns=NAMES)


def flight(seed, noise, size=1.0):
    """Return regressors and coefficients of a flight with errors that last."""
    X = flown(seed, size)
    return X, X.to_numpy() @ SLOPES + noise * lasting(default_rng(100 + seed), (len(X), 6), 5)


def learned(X, Y):
    """Return a pipeline that knows an aircraft by a flight."""
    regressor = DependentGPRegressor(
        structure="trend", input_noise=None, max_iter=5, random_state=0
    )
    pipeline = make_pipeline(RegressorSelector([*X]), StandardScaler(), regressor)
    return pipeline.fit(X, Y, dependentgpregressor__time=STEP * X.index.to_numpy())


@pytest.fixture(scope="module")
def model():
    return learned(*flight(0, 0.02))


def residuals(model, X, Y):
    """Return scaled regressors of a flight, what a model does not explain, and forces by acceleration."""
    unexplained = Y - model.predict(X)
    regressors = np.asarray(model[:-1].transform(X))
    clock = Clock.of(STEP * np.arange(len(X)))
    return Compared(regressors, unexplained, np.full(len(X), BY_ACCELERATION), clock)


def residuals_of(model, flights):
    return {name: residuals(model, *flight) for name, flight in flights.items()}


def changes(model, flights, change=0.0):
    """Return the changes that flights show whose alpha by Cm is changed."""
    unexplained = residuals_of(model, flights)
    for name, (X, _) in flights.items():
        unexplained[name].residuals[:, 4] += change * X["alpha"]
    return changes_of(model, unexplained)


def several(make, *arguments):
    """Return flights by their seeds."""
    return {str(seed): make(seed, *arguments) for seed in range(1, 9)}


def alarms(result, coefficient="whole"):
    """Return the fraction of the flights for which a coefficient, or all together, have changed."""
    return (result.p_values[coefficient] < 0.05).mean()


def most_alarms(result):
    """Return the largest fraction over the coefficients."""
    return (result.p_values < 0.05).mean().max()


def p_value(model, flight, change=0.0):
    """Return the p-value of Cm of one flight, whose alpha by Cm may be changed."""
    return changes(model, {"one": flight}, change).p_values.loc["one", "Cm"]


def test_flights_of_the_same_aircraft_in_other_gusts_raise_few_alarms(model):
    flights = {
        str(seed): flight(seed, noise) for seed, noise in enumerate([0.01, 0.02, 0.04] * 10, 1)
    }
    assert most_alarms(changes(model, flights)) < 0.2


@pytest.mark.slow
def test_p_values_of_unchanged_aircraft_are_no_smaller_than_uniform():
    """Each of its own model, as all flights share the error of one."""
    rows = []
    for seed in range(9):
        unseen = {"unseen": flight(100 + seed, [0.01, 0.02, 0.04][seed % 3])}
        rows.append(changes(learned(*flight(50 + seed, 0.02)), unseen).p_values.loc["unseen"])
    p_values = pd.DataFrame(rows).drop(columns="whole")
    for coefficient in p_values:
        assert kstest(p_values[coefficient], "uniform", alternative="greater").pvalue > 0.001


def test_a_change_is_found_in_its_coefficient_and_its_size_is_within_its_band(model):
    result = changes(model, {"iced": flight(100, 0.02)}, change=0.2)
    p_values = result.p_values.loc["iced"]
    assert p_values["Cm"] < 0.01
    assert p_values["whole"] < 0.05
    row = result.derivatives.loc[("iced", "Cm_alpha")]
    assert_allclose(row["change"], 0.2, rtol=0, atol=3 * row["std"])
    (finding,) = result.findings
    assert (finding.code.name, finding.flight) == ("CHANGED", "iced")
    assert finding.numbers["p"] == p_values["whole"]
    assert finding.numbers["likely"]["Cm_alpha"] == (row["change"], row["std"])
    unchanged = changes(model, {"same": flight(100, 0.02)})
    (finding,) = unchanged.findings
    assert finding.code.name == "NO_CHANGE"
    row = unchanged.derivatives.loc[("same", "Cm_elevator")]
    assert_allclose(row["value"], SLOPES[2, 4], rtol=0.1)
    hidden = 1.96 * row["std"] / abs(row["value"])  # half of the 95 % band
    assert_allclose(finding.numbers["hidden"]["Cm_elevator"], hidden, rtol=1e-3)


def test_a_change_that_lasts_as_long_as_slow_motion_is_found(model):
    """A less effective elevator in a flight whose elevator hardly moves but for its trim."""

    def slow(seed, change):
        X, Y = flight(seed, 0.02)
        elevator = 0.1 * np.sin(np.arange(len(X)) / 200) + 0.02 * X["elevator"]
        Y += np.outer(elevator - X["elevator"], SLOPES[2])
        Y[:, 4] += change * elevator
        return X.assign(elevator=elevator), Y

    assert alarms(changes(model, several(slow, 0.0)), "Cm") < 0.2
    assert (changes(model, several(slow, 0.2)).p_values["Cm"] < 0.01).all()


def with_noise_of_alpha(seed, of_q):
    """Return a gentle flight whose alpha is measured with the noise ALPHA_NOISE, as large as its motion.

    A part of this noise, ``of_q``, is also in q.
    """
    X, Y = flight(seed, 0.02, 0.3)
    noise = ALPHA_NOISE * default_rng(1000 + seed).normal(size=len(X))
    return X.assign(alpha=X["alpha"] + noise, q_hat=X["q_hat"] + of_q * noise), Y


@pytest.mark.parametrize("of_q", [0.0, -0.3])
def test_slopes_that_noise_flattens_are_no_change_and_a_change_is_found(model, of_q):
    """Least squares has less than three quarters of CZ_alpha."""
    flights = several(with_noise_of_alpha, of_q)
    assert alarms(changes(model, flights)) < 0.2
    flattened = []
    for X, Y in flights.values():
        by_all = LinearRegression().fit(X, Y[:, 2]).coef_[0]
        flattened.append(by_all - SLOPES[0, 2])
    found = changes(model, flights).derivatives.xs("CZ_alpha", level="derivative")
    assert min(flattened) > 1.0
    assert (found["change"].abs() < 3 * found["std"]).all()
    assert found["std"].max() < min(flattened) / 2
    other = changes(model, flights, change=0.5)
    assert alarms(other, "Cm") > 0.8
    change = other.derivatives.xs("Cm_alpha", level="derivative")["change"]
    assert_allclose(change.mean(), 0.5, rtol=0.2)


def test_an_effect_that_no_regressor_holds_widens_what_instruments_tell():
    """A flow that follows the elevator 0.2 s later is neither noise nor a slope."""

    def unsteady(seed):
        X, Y = flight(seed, 0.002)
        return X, Y + 0.1 * np.roll(X["elevator"], 4)[:, None]

    model = learned(*flight(0, 0.002))
    steady = changes(model, several(flight, 0.002)).derivatives["std"]
    found = changes(model, several(unsteady)).derivatives["std"]
    assert (found / steady).xs("Cm_alpha", level="derivative").mean() > 1.8


def test_a_flight_without_controls_tells_nothing():
    X, Y = flight(0, 0.02)
    pipeline = learned(X[NAMES[:2]], Y)
    result = changes(pipeline, {"one": (X[NAMES[:2]], Y)})
    assert result.p_values.isna().all(axis=None)
    assert result.derivatives.isna().all(axis=None)


@pytest.mark.filterwarnings("ignore:.*(never change|are constant)")
def test_a_control_that_first_moves_in_the_later_flight_is_no_change():
    X, Y = flight(0, 0.02)
    held = 0.02
    Y[:, 4] -= SLOPES[2, 4] * (X["elevator"] - held)
    X["elevator"] = held
    pipeline = learned(X, Y)
    same = changes(pipeline, {"same": flight(1, 0.02)})
    assert same.p_values.loc["same", "Cm"] > 0.01
    row = same.derivatives.loc[("same", "Cm_elevator")]
    assert abs(row["change"]) < row["std"] / 3
    X, Y = flight(1, 0.02)
    Y[:, 4] += SLOPES[2, 4] * (0.1 - X["elevator"])
    assert p_value(pipeline, (X.assign(elevator=0.1), Y)) > 0.01
    assert p_value(pipeline, flight(1, 0.02), change=0.2) < 0.01


@pytest.mark.filterwarnings("ignore:.*(never change|are constant)")
def test_an_unknown_effect_of_a_control_on_one_force_is_no_factor_of_all():
    """A gentle flight in which the elevator, held in the fit, is elsewhere and changes the lift by 12 %."""

    def held(seed, elevator, size):
        X, Y = flight(seed, 0.02)
        changed = (size * X).assign(elevator=elevator)
        Y += (changed.assign(elevator=0.0) - X).to_numpy() @ SLOPES
        Y[:, 2] -= 0.8 + elevator
        return changed, Y

    result = changes(learned(*held(0, 0.0, 1.0)), {"trimmed": held(1, 0.1, 0.02)})
    assert result.p_values.loc["trimmed", "forces"] > 0.2
    assert result.derivatives.loc[("trimmed", "forces"), "std"] > 0.1


def test_a_short_flight_tells_nothing(model):
    X, Y = flight(7, 0.02)
    result = changes(model, {"short": (X[:25], Y[:25])}, change=1.0)
    assert result.p_values.isna().all(axis=None)
    assert [found.code.name for found in result.findings] == ["CHANGE_UNKNOWN"]


def flight_with_one_pulse(seed, change=0.0):
    """Return a flight of 160 rows whose elevator moves once, for 6 rows."""
    rng = default_rng(seed)
    motion = short_period(0.1 * np.isin(np.arange(160), range(70, 76)))
    motion[:, :2] += 0.03 * lasting(rng, (160, 2), 100)
    Y = motion @ SLOPES + 0.02 * lasting(rng, (160, 6), 5)
    Y[:, 4] += change * motion[:, 2]
    return pd.DataFrame(motion, columns=NAMES), Y


def test_constant_errors_of_sensors_are_no_change():
    """An offset of the vane moves the prediction, one of the accelerometer the measurement."""
    model = learned(*flight(0, 0.005))
    flights = {}
    for seed in range(1, 13):
        rng = default_rng(2000 + seed)
        X, Y = flight(seed, 0.005)
        X["alpha"] += 0.005 * rng.choice([-1, 1])
        Y[:, :3] += 0.05 * BY_ACCELERATION * rng.choice([-1, 1], size=3)
        flights[str(seed)] = X, Y
    assert most_alarms(changes(model, flights)) < 0.2
    assert p_value(model, flights["1"], change=0.2) < 0.01


def test_more_drag_alone_is_found(model):
    """A pod or a damaged surface changes no derivative."""
    X, Y = flight(100, 0.02)
    Y[:, 0] -= 0.02
    result = changes(model, {"pod": (X, Y)})
    assert result.p_values.loc["pod", "whole"] < 0.01
    row = result.derivatives.loc[("pod", "CX")]
    assert_allclose(row["change"], -0.02, rtol=0, atol=3 * row["std"])


@pytest.mark.parametrize(("factor", "drift"), [(0.9, 0.0), (1.1, 0.0), (1.1, 0.1)])
def test_one_factor_of_all_forces_is_found_with_its_size(model, factor, drift):
    """A wrong mass, wing area or airspeed; noise would hide it in the weights of each coefficient.

    Where CY drifts, its errors are unknown, and CZ tells the factor.
    """
    flights = several(flight, 0.04)
    unexplained = residuals_of(model, flights)
    for name, (X, _) in flights.items():
        unexplained[name].residuals[:, :3] += (factor - 1) * model.predict(X)[:, :3]
        unexplained[name].residuals[:, 1] += np.linspace(0.0, drift, len(X))
    result = changes_of(model, unexplained)
    assert alarms(result, "forces") > 0.8
    row = result.derivatives.xs("forces", level="derivative")
    assert_allclose(row["change"].mean(), factor - 1, rtol=0, atol=0.02)
    assert "CHANGED" in {finding.code.name for finding in result.findings}


def test_a_control_that_moves_once_in_a_short_flight_is_a_change_only_if_its_effect_is(model):
    assert most_alarms(changes(model, several(flight_with_one_pulse))) < 0.2
    other = changes(model, several(flight_with_one_pulse, 1.0))
    assert alarms(other, "Cm") > 0.5
    found = other.derivatives.xs("Cm_elevator", level="derivative")["change"]
    assert_allclose(found.mean(), 1.0, rtol=0, atol=0.1)
    assert alarms(changes(model, several(flight_with_one_pulse, 2.0)), "Cm") == 1.0

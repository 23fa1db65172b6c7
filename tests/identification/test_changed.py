"""Whether an aircraft has changed since its model was learned."""

import numpy as np
import pandas as pd
import pytest
from made_flights import lasting
from numpy.random import default_rng
from scipy.stats import kstest
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import Bunch

from skdgp import DependentGPRegressor
from skdgp.identification import Compared, changes_of
from skdgp.inference import attenuation, errors_of_slopes
from skdgp.preprocessing import FlightPathReconstruction, RegressorSelector

NAMES = ["alpha", "q_hat", "elevator"]
ALPHA_NOISE = 0.03
# force coefficients of 1 m/s^2: mass over dynamic pressure and wing area of 12 kg, 20 m/s, 1.3 m^2
BY_ACCELERATION = 0.04
SLOPES = np.array([[0.3, 0.0, -4.0, 0.0, -0.5, 0.0], [0.0] * 6, [0.0] * 4 + [-0.6, 0.0]])


def flight(seed, noise):
    """Return regressors and coefficients of a flight with errors that last."""
    rng = default_rng(seed)
    X = pd.DataFrame(0.1 * lasting(rng, (1500, 3), 15), columns=NAMES)
    return X, X.to_numpy() @ SLOPES + noise * lasting(rng, (1500, 6), 5)


def learned(X, Y, noise=None):
    """Return a pipeline that knows an aircraft by a flight, whose regressors have some noise."""
    if noise is not None:
        noise = noise / StandardScaler().fit(X).scale_
    regressor = DependentGPRegressor(
        structure="trend", input_noise=noise, max_iter=5, random_state=0
    )
    pipeline = make_pipeline(RegressorSelector([*X]), StandardScaler(), regressor)
    return pipeline.fit(X, Y, dependentgpregressor__time=0.05 * X.index.to_numpy())


@pytest.fixture(scope="module")
def model():
    return learned(*flight(0, 0.02))


def residuals(model, X, Y):
    """Return scaled regressors of a flight, what a model does not explain, and forces by acceleration."""
    unexplained = Y - model.predict(X)
    regressors = np.asarray(model[:-1].transform(X))
    return Compared(regressors, unexplained, np.full(len(X), BY_ACCELERATION))


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
    assert abs(row["change"] - 0.2) < 3 * row["std"]
    (finding,) = result.findings
    assert (finding.code.name, finding.flight) == ("CHANGED", "iced")
    assert finding.numbers["p"] == p_values["whole"]
    assert finding.numbers["likely"]["Cm_alpha"] == (row["change"], row["std"])
    unchanged = changes(model, {"same": flight(100, 0.02)})
    (finding,) = unchanged.findings
    assert finding.code.name == "NO_CHANGE"
    row = unchanged.derivatives.loc[("same", "Cm_elevator")]
    assert row["value"] == pytest.approx(SLOPES[2, 4], rel=0.1)
    hidden = 1.96 * row["std"] / abs(row["value"])  # half of the 95 % band
    assert finding.numbers["hidden"]["Cm_elevator"] == pytest.approx(hidden, rel=1e-3)


def test_a_change_that_lasts_as_long_as_slow_motion_is_found(model):
    """A less effective elevator in a flight whose elevator hardly moves but for its trim."""

    def slow(seed, change):
        X, Y = flight(seed, 0.02)
        elevator = 0.1 * np.sin(np.arange(len(X)) / 200) + 0.02 * X["elevator"]
        Y += np.outer(elevator - X["elevator"], SLOPES[2])
        Y[:, 4] += change * elevator
        return X.assign(elevator=elevator), Y

    assert alarms(changes(model, several(slow, 0.0)), "Cm") < 0.2
    other = changes(model, several(slow, 0.2))
    assert (other.p_values["Cm"] < 0.01).all()


def with_noise_of_alpha(seed, size, of_q=0.0):
    """Return a flight with motion of a ``size`` whose alpha is measured with the noise ALPHA_NOISE.

    A part of this noise, ``of_q``, is also in q.
    """
    true, Y = flight(seed, 0.0)
    rng = default_rng(1000 + seed)
    X = size * true
    measured = X.copy()
    noise = ALPHA_NOISE * rng.normal(size=len(X))
    measured["alpha"] += noise
    measured["q_hat"] += of_q * noise
    Y = X.to_numpy() @ SLOPES + 0.02 * lasting(rng, Y.shape, 5)
    return measured, Y


def test_slopes_that_noise_flattens_in_a_gentle_flight_are_no_change():
    """Least squares returns lambda b, lambda = var x / (var x + s^2) (Fuller 1987, section 1.1)."""
    pipeline = learned(*with_noise_of_alpha(0, 1.0), np.array([ALPHA_NOISE, 0.0, 0.0]))
    size = 0.3
    result = changes(pipeline, several(with_noise_of_alpha, size))
    assert alarms(result) < 0.2

    motion = 0.1
    in_fit = 1 / (1 + (ALPHA_NOISE / motion) ** 2)
    in_gentle = 1 / (1 + (ALPHA_NOISE / (size * motion)) ** 2)
    expected = SLOPES[0, 2] * (in_gentle - in_fit)
    rows = result.derivatives.xs("CZ_alpha", level="derivative")
    assert rows["change"].mean() == pytest.approx(expected, rel=0.2)
    # the fit knows a slope that is flattened, too
    assert in_fit * abs(expected) < rows["std"].mean() < 1.5 * abs(expected)

    assert p_value(pipeline, with_noise_of_alpha(20, 1.0), change=0.2) < 0.01


def test_noise_that_regressors_share_makes_no_change_of_a_gentle_flight():
    """Its covariance with q biases the slope by q too, and the less an aircraft moves, the more."""
    of_q = -0.3
    noise = np.array([ALPHA_NOISE, 0.3 * ALPHA_NOISE, 0.0])
    pipeline = learned(*with_noise_of_alpha(0, 1.0, of_q), noise)
    assert alarms(changes(pipeline, several(with_noise_of_alpha, 0.3, of_q))) < 0.2
    assert p_value(pipeline, with_noise_of_alpha(20, 1.0, of_q), change=0.2) < 0.01


def test_slopes_that_rougher_air_flattens_are_no_change():
    """By noise of the regressors over that in the fit, or by rates of the air that no sensor sees."""
    model = learned(*flight(0, 0.02), np.array([ALPHA_NOISE / 3, 0.0, 0.0]))
    noise = np.diag([ALPHA_NOISE / model[1].scale_[0], 0.0, 0.0]) ** 2
    slopes = model[-1].predict_gradient(np.zeros((1, 3)))[0]
    steady, rough, rates = residuals_of(model, several(with_noise_of_alpha, 0.5)), {}, {}
    for name, compared in steady.items():
        rough[name] = compared._replace(noise_ratio=9.0)
        errors = np.stack([attenuation(compared.regressors, noise, slope) for slope in slopes])
        rates[name] = compared._replace(by_air=errors_of_slopes(errors, np.zeros(3)))
    assert alarms(changes_of(model, steady)) > 0.8
    assert alarms(changes_of(model, rough)) < 0.2
    assert alarms(changes_of(model, rates)) < 0.2


def test_noise_of_lateral_regressors_hardly_widens_a_symmetric_slope():
    """Only a covariance with the noise of q biases it, and a mirrored flight changes its sign."""
    std = []
    for surface in ("elevator", "rudder"):
        names = ["alpha", "q_hat", surface]
        (X, Y), (gentle, later) = flight(0, 0.02), with_noise_of_alpha(1, 0.3)
        pipeline = learned(X.set_axis(names, axis=1), Y, np.array([0.0, 0.05, 0.05]))
        found = changes(pipeline, {"one": (gentle.set_axis(names, axis=1), later)})
        std.append(found.derivatives.xs("Cm_q", level="derivative")["std"].item())
    assert std[1] < 0.7 * std[0]


def test_errors_of_angles_that_a_filter_states_make_no_change_of_a_gentle_flight(model):
    """Residuals do not show them, where the filter derived the angles from the same forces."""
    reconstruction = FlightPathReconstruction()
    reconstruction.used_ = True
    air = pd.DataFrame({"alpha": [0.0], "alpha_std": [ALPHA_NOISE]})
    reconstruction.air_motion_ = Bunch(air=air)
    filtered = Pipeline([("flightpathreconstruction", reconstruction), *model.steps])
    unexplained = residuals_of(model, several(with_noise_of_alpha, 0.3))
    assert alarms(changes_of(model, unexplained)) > 0.8
    assert alarms(changes_of(filtered, unexplained)) < 0.2


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
    X, Y = flight(seed, 0.02)
    X = X[:160]
    Y = Y[:160]
    pulse = np.zeros(len(X))
    pulse[70:76] = 0.1
    Y = Y + np.outer(pulse - X["elevator"], SLOPES[2])
    Y[:, 4] += change * pulse
    return X.assign(elevator=pulse), Y


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
    assert row["change"] == pytest.approx(-0.02, abs=3 * row["std"])


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
    assert row["change"].mean() == pytest.approx(factor - 1, abs=0.02)
    assert "CHANGED" in {finding.code.name for finding in result.findings}


def test_a_control_that_moves_once_in_a_short_flight_is_no_change(model):
    """The fit leaves no residual where a single block determines a weight, so blocks show no error."""
    assert most_alarms(changes(model, several(flight_with_one_pulse))) < 0.2
    assert p_value(model, flight_with_one_pulse(21, change=1.0)) < 0.01

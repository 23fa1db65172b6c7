"""Training data of a model for other air: mirrored flights, and targets without the effect of past gusts."""

import pickle

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.calibration import CalibratedRegressor
from skdgp.dynamics import Aircraft
from skdgp.identification import FlightPipeline, default_regressor
from skdgp.identification._other_air import mirrored, without_gusts
from skdgp.preprocessing import RegressorSelector

RATE, DAMPING, ROLL = 40.0, -0.5, 0.2
NAMES = ["alpha", "beta", "p_hat", "elevator", "aileron"]


def rolling_flight(seed, gust=0.07, seconds=240.0, noise=0.0):
    """Return a flight that rolls by its aileron and by rolling gusts of 0.5 s memory, and its Cl.

    Cl = DAMPING (p - p_gust) + ROLL aileron turns the aircraft by 6 rad/s^2 for each unit. The autopilot answers the
    roll rate.
    """
    rng = np.random.default_rng(seed)
    n, fine = int(seconds * RATE), 4
    step, memory = 1 / (RATE * fine), 0.5
    wish = np.repeat(rng.choice([-1.0, 0.0, 0.0, 1.0], int(seconds) + 1), int(RATE) * fine)
    p, p_gust, rows = 0.0, 0.0, np.empty((n, 3))
    decay, kick = np.exp(-step / memory), gust * np.sqrt(-np.expm1(-2 * step / memory))
    drawn = rng.standard_normal(n * fine)
    for k in range(n * fine):
        aileron = wish[k] - 0.2 * p
        load = DAMPING * (p - p_gust) + ROLL * aileron
        if k % fine == 0:
            rows[k // fine] = p, aileron, load
        p, p_gust = p + step * 6 * load, decay * p_gust + kick * drawn[k]
    table = pd.DataFrame(rows[:, :2], columns=["p_hat", "aileron"]).assign(time=np.arange(n) / RATE)
    return table, pd.DataFrame({"Cl": rows[:, 2] + noise * rng.standard_normal(n)})


def pipeline_of(names, last, **options):
    return FlightPipeline(make_pipeline(RegressorSelector(names), StandardScaler(), last).steps, **options)


def slopes(pipeline):
    return pipeline[-1].coef_ / pipeline[-2].scale_


class TestGusts:
    def test_the_damping_of_an_aircraft_in_rolling_gusts_is_that_of_the_aircraft(self):
        found = {gusty: [] for gusty in (False, True)}
        for seed in range(4):
            table, Cl = rolling_flight(seed)
            for gusty, values in found.items():
                pipeline = pipeline_of(["p_hat", "aileron"], LinearRegression(), gusty=gusty)
                values.append(slopes(pipeline.fit(table, Cl))[0])
        assert np.abs(np.mean(found[False], axis=0)[0] / DAMPING - 1) > 0.14
        np.testing.assert_allclose(np.mean(found[True], axis=0), [DAMPING, ROLL], rtol=0.03)

    def test_calm_air_and_white_noise_change_nothing(self):
        table, Cl = rolling_flight(0, gust=0.0, noise=0.1)
        X, time = table[["p_hat", "aileron"]].to_numpy(), table["time"].to_numpy()
        change = without_gusts(X, Cl.to_numpy(), time, None) - Cl.to_numpy()
        assert change.std() < 0.05 * 0.1

    def test_nothing_is_predicted_from_another_flight(self):
        table, Cl = rolling_flight(0, seconds=20)
        X, Y, time = table[["p_hat", "aileron"]].to_numpy(), Cl.to_numpy(), table["time"].to_numpy()
        flight = (time >= 10).astype(int)
        found = without_gusts(X, Y, time, flight)
        unchanged = np.flatnonzero((found == Y).all(axis=1))
        np.testing.assert_array_equal(unchanged, [0, 1, 400, 401])  # nothing 0.05 s before

    def test_targets_that_are_not_observed_stay_so(self):
        table, Cl = rolling_flight(0, seconds=20)
        Y = Cl.to_numpy().copy()
        Y[100:200] = np.nan
        found = without_gusts(table[["p_hat", "aileron"]].to_numpy(), Y, table["time"].to_numpy(), None)
        np.testing.assert_array_equal(np.isnan(found), np.isnan(Y))

    def test_bands_are_those_of_measured_targets(self):
        table, Cl = rolling_flight(0, seconds=20)
        slopes, last = [], DependentGPRegressor(structure="trend", inference="sparse", max_iter=5, random_state=0)
        for gusty in (False, True):
            pipeline = pipeline_of(["p_hat", "aileron"], clone(last), gusty=gusty).fit(table, Cl)
            error = Cl.to_numpy() - pipeline.predict(table).reshape(-1, 1)
            np.testing.assert_allclose(pipeline[-1].noise_variance_, error.var(), rtol=0.15)
            slopes.append(pipeline[-1].predict_gradient(np.zeros((1, 2)), return_std=True)[1][0, 0, 0])
        assert 0.4 * slopes[0] < slopes[1] < 1.2 * slopes[0]

    def test_thin_targets_are_refused(self):
        table, Cl = rolling_flight(0, seconds=20)
        Cl[table["time"] > 5] = np.nan
        with pytest.raises(ValueError, match="do not thin them"):
            pipeline_of(["p_hat", "aileron"], LinearRegression(), gusty=True).fit(table, Cl)


def symmetric_flight(seed, n=400):
    rng = np.random.default_rng(seed)
    table = pd.DataFrame(rng.normal(0.1, 0.3, (n, 5)), columns=NAMES).assign(time=np.arange(n) / RATE)
    side = -0.6 * table.beta + 0.2 * table.alpha * table.beta
    roll = 0.02 - 0.1 * table.beta - 0.4 * table.p_hat + 0.2 * table.aileron
    lift = -0.2 - 5 * table.alpha + 0.3 * table.elevator
    Y = pd.DataFrame({"CY": side, "CZ": lift, "Cl": roll})
    return table, Y + rng.normal(0, 0.05, Y.shape)


class TestSymmetry:
    def test_a_sample_and_its_image_show_no_misfit(self):
        """Near the plane of symmetry a sample is the nearest neighbour of its image, with the same noise."""
        table, Y = symmetric_flight(0, 2000)
        lateral = ["beta", "p_hat", "aileron"]
        table.loc[table.index % 20 > 0, lateral] *= 0.001  # mostly straight flight
        table["flight"] = "first"
        last = DependentGPRegressor(structure="trend", inference="sparse", n_inducing=5, max_iter=5, random_state=0)
        model = pipeline_of(NAMES, last, symmetric=True).fit(table, Y[["CZ"]])[-1]
        assert model.misfit_variance_[0] < 0.05 * model.noise_variance_[0]

    def test_the_mirror_of_the_mirror_is_the_flight(self):
        table, Y = symmetric_flight(0)
        image = mirrored(table[NAMES], Y)
        X, again = mirrored(*image)
        pd.testing.assert_frame_equal(X, table[NAMES])
        pd.testing.assert_frame_equal(again, Y)
        assert (image[0].beta == -table.beta).all()
        assert (image[0].alpha == table.alpha).all()
        assert (image[1].CZ == Y.CZ).all()

    def test_lateral_coefficients_do_not_depend_on_longitudinal_regressors(self):
        table, Y = symmetric_flight(0)
        found = slopes(pipeline_of(NAMES, LinearRegression(), symmetric=True).fit(table, Y))
        np.testing.assert_allclose(found[[0, 2]][:, [0, 3]], 0, atol=1e-12)
        np.testing.assert_allclose(found[1][[1, 2, 4]], 0, atol=1e-12)
        np.testing.assert_allclose(found[2][[1, 2, 4]], [-0.1, -0.4, 0.2], atol=0.03)

    def test_a_constant_asymmetry_stays(self):
        table, Y = symmetric_flight(0)
        pipeline = pipeline_of(NAMES, LinearRegression(), symmetric=True).fit(table, Y)
        level = table.head(1).assign(**dict.fromkeys(("beta", "p_hat", "aileron"), 0.0))
        np.testing.assert_allclose(pipeline.predict(level)[0, 2], 0.02, atol=0.01)

    def test_bands_count_each_sample_once(self):
        table, Y = symmetric_flight(0, n=150)
        std, random = [], []
        for symmetric in (False, True):
            last = DependentGPRegressor(structure="trend", max_iter=8, random_state=0)
            pipeline = pipeline_of(NAMES, last, symmetric=symmetric).fit(table, Y)
            std.append(pipeline[-1].predict_gradient(np.zeros((1, 5)), return_std=True)[1][0, 1, [0, 3]])
            random.append(pickle.loads(pickle.dumps(pipeline[-1])).slope_errors(np.zeros((1, 5))))
        np.testing.assert_allclose(std[1], std[0], rtol=0.1)
        np.testing.assert_allclose(random[1].random, random[0].random, rtol=1e-6, atol=1e-12)  # of the measured samples
        assert random[0].n_samples == random[1].n_samples

    def test_single_elevons_are_refused(self):
        table, Y = symmetric_flight(0)
        table = table.rename(columns={"elevator": "elevon_left", "aileron": "elevon_right"})
        pipeline = pipeline_of(["alpha", "elevon_left", "elevon_right"], LinearRegression(), symmetric=True)
        with pytest.raises(ValueError, match=r"put ElevonSplitter\(\) before"):
            pipeline.fit(table, Y)


class TestPipeline:
    def test_options_are_parameters(self):
        glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
        pipeline = clone(make_identification_pipeline(glider, symmetric=True, gusty=True))
        assert pipeline.get_params()["symmetric"]
        assert pipeline.get_params()["gusty"]

    def test_only_the_default_regressor_of_gusty_flights_has_a_prior_on_widths_and_shares_latents(self):
        glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
        cases = (True, None), (False, None), (True, DependentGPRegressor())
        found = [make_identification_pipeline(glider, gusty=gusty, regressor=own)[-1] for gusty, own in cases]
        assert [(one.length_scale_prior, one.n_latent) for one in found] == [("auto", 2), (None, None), (None, None)]

    @pytest.mark.parametrize("calibrated", [False, True])
    def test_setting_gusty_changes_the_prior_of_the_default_regressor_too(self, calibrated):
        glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
        last = CalibratedRegressor(default_regressor()) if calibrated else None
        pipeline = make_identification_pipeline(glider, regressor=last)
        prefix = "calibratedregressor__estimator__" if calibrated else "dependentgpregressor__"

        def prior():
            return tuple(pipeline.get_params()[prefix + name] for name in ("length_scale_prior", "n_latent"))

        assert clone(pipeline.set_params(gusty=True)).get_params()["gusty"]
        assert prior() == ("auto", 2)
        pipeline.set_params(gusty=False)
        assert prior() == (None, None)
        pipeline.set_params(**{"gusty": True, prefix + "n_latent": None, prefix + "length_scale_prior": (2.0, 0.5)})
        assert prior() == ((2.0, 0.5), None)
        pipeline.set_params(gusty=False)
        assert prior() == ((2.0, 0.5), None)
        own = DependentGPRegressor()
        pipeline.set_params(**{"gusty": True, prefix.split("__")[0]: own})
        assert (own.length_scale_prior, own.n_latent) == (None, None)

    def test_targets_without_names_are_the_six_coefficients(self):
        table, Y = symmetric_flight(0)
        with pytest.raises(ValueError, match="or the six coefficients: give a DataFrame"):
            pipeline_of(NAMES, LinearRegression(), gusty=True).fit(table, Y.to_numpy())

    def test_a_clock_is_needed(self):
        table, Y = symmetric_flight(0)
        with pytest.raises(ValueError, match="and the column time: add them"):
            pipeline_of(NAMES, LinearRegression(), gusty=True).fit(table[NAMES], Y)

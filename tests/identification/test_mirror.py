"""Flights of a symmetric aircraft as seen in a mirror, which it also learns from."""

import pickle

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.identification import FlightPipeline
from skdgp.preprocessing import RegressorSelector

RATE = 40.0
NAMES = ["alpha", "beta", "p_hat", "elevator", "aileron"]


def pipeline_of(names, last, **options):
    return FlightPipeline(
        make_pipeline(RegressorSelector(names), StandardScaler(), last).steps, **options
    )


def slopes(pipeline):
    return pipeline[-1].coef_ / pipeline[-2].scale_


def symmetric_flight(seed, n=400):
    rng = np.random.default_rng(seed)
    table = pd.DataFrame(rng.normal(0.1, 0.3, (n, 5)), columns=NAMES).assign(
        time=np.arange(n) / RATE
    )
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
        last = DependentGPRegressor(
            structure="trend", inference="sparse", n_inducing=5, max_iter=5, random_state=0
        )
        model = pipeline_of(NAMES, last, symmetric=True).fit(table, Y[["CZ"]])[-1]
        assert model.misfit_variance_[0] < 0.05 * model.noise_variance_[0]

    def test_lateral_coefficients_do_not_depend_on_longitudinal_regressors(self):
        table, Y = symmetric_flight(0)
        found = slopes(pipeline_of(NAMES, LinearRegression(), symmetric=True).fit(table, Y))
        np.testing.assert_allclose(found[[0, 2]][:, [0, 3]], 0, atol=1e-12)
        np.testing.assert_allclose(found[1][[1, 2, 4]], 0, atol=1e-12)
        np.testing.assert_allclose(found[2][[1, 2, 4]], [-0.1, -0.4, 0.2], atol=0.03)

    def test_bands_count_each_sample_once(self):
        table, Y = symmetric_flight(0, n=150)
        std, random = [], []
        for symmetric in (False, True):
            last = DependentGPRegressor(
                structure="trend", input_noise=None, max_iter=8, random_state=0
            )
            pipeline = pipeline_of(NAMES, last, symmetric=symmetric).fit(table, Y)
            std.append(
                pipeline[-1].predict_gradient(np.zeros((1, 5)), return_std=True)[1][0, 1, [0, 3]]
            )
            random.append(pickle.loads(pickle.dumps(pipeline[-1])).slope_errors(np.zeros((1, 5))))
        np.testing.assert_allclose(std[1], std[0], rtol=0.02)
        np.testing.assert_allclose(
            random[1].random, random[0].random, rtol=1e-6, atol=1e-12
        )  # of the measured samples
        assert random[0].n_samples == random[1].n_samples

    def test_errors_of_slopes_are_of_measured_samples_in_an_average_too(self):
        table, Y = symmetric_flight(0, n=60)
        model = DependentGPRegressor(n_latent=0, max_iter=3, random_state=0)
        found = [
            pipeline_of(NAMES, clone(model), symmetric=s).fit(table, Y)[-1] for s in (False, True)
        ]
        assert len(found[1].weights_) == 3
        assert len({each.slope_errors(np.zeros((1, 5))).n_samples for each in found}) == 1
        further = pickle.loads(pickle.dumps(found[1])).partial_fit(
            table[NAMES].to_numpy()[:3], Y.to_numpy()[:3]
        )
        np.testing.assert_array_equal(
            further.posterior_.measured[0], found[1].posterior_.measured[0]
        )

    def test_single_elevons_are_refused(self):
        table, Y = symmetric_flight(0)
        table = table.rename(columns={"elevator": "elevon_left", "aileron": "elevon_right"})
        pipeline = pipeline_of(
            ["alpha", "elevon_left", "elevon_right"], LinearRegression(), symmetric=True
        )
        with pytest.raises(ValueError, match=r"put ElevonSplitter\(\) before"):
            pipeline.fit(table, Y)


class TestPipeline:
    def test_targets_without_names_are_the_six_coefficients(self):
        table, Y = symmetric_flight(0)
        with pytest.raises(ValueError, match="or the six coefficients: give a DataFrame"):
            pipeline_of(NAMES, LinearRegression(), symmetric=True).fit(table, Y.to_numpy())

    def test_a_clock_is_needed(self):
        table, Y = symmetric_flight(0)
        with pytest.raises(ValueError, match="and the column time: add them"):
            pipeline_of(NAMES, LinearRegression(), symmetric=True).fit(table[NAMES], Y)

"""The portable model predicts what the pipeline predicts, for every kind of posterior."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import (
    MaxAbsScaler,
    MinMaxScaler,
    RobustScaler,
    StandardScaler,
)

from skdgp import DependentGPRegressor
from skdgp.dynamics import as_aerodynamics
from skdgp.export import portable_model
from skdgp.preprocessing import RegressorSelector


def test_equals_the_pipeline(kind, fitted, portable, flight):
    for noise in (True, 2.0, False):
        options = {"include_input_noise": noise}
        mean, std = fitted(kind).pipeline.predict(flight, return_std=True, **options)
        ours, deviation = portable.predict(flight, return_std=True, **options)
        np.testing.assert_allclose(ours, mean, rtol=0, atol=1e-10 * np.abs(mean).max())
        assert (np.abs(deviation - std) <= np.maximum(1e-9 * std, portable.rounding(flight))).all()
    np.testing.assert_allclose(portable.predict(flight), ours, rtol=0, atol=1e-14)


def test_slopes_are_those_of_the_simulation(kind, fitted, portable, flight):
    aerodynamics = as_aerodynamics(fitted(kind).pipeline)
    X = portable.regressor_values(flight)
    slopes = aerodynamics.gradient(X)
    assert portable.regressor_names == aerodynamics.regressors
    np.testing.assert_allclose(
        portable.predict_gradient(X), slopes, rtol=1e-9, atol=1e-10 * np.abs(slopes).max()
    )


def test_noise_of_each_row(portable_of, flight):
    """Rougher air is a factor for each row; exact rows have the deviation of the function alone."""
    noisy, factors = portable_of("noisy"), np.arange(30.0)
    exact, fit, rough = (noisy.predict(flight, True, by)[1] for by in (False, True, factors))
    assert (fit > exact).all()
    np.testing.assert_allclose(
        rough**2 - exact**2, factors[:, None] * (fit**2 - exact**2), rtol=1e-6, atol=1e-18
    )


def test_noise_is_that_of_the_regressor(kind, fitted, portable):
    regressor = fitted(kind).pipeline[-1]
    np.testing.assert_allclose(portable.noise_variance, regressor.noise_variance_)
    units = np.multiply.outer(portable.scale, portable.scale)
    np.testing.assert_allclose(portable.input_covariance, regressor.input_covariance_ * units)


def test_limits_are_those_of_the_flights(portable):
    low, high = portable.limits
    assert (low < high).all()
    assert portable.inside(portable.samples).all()
    assert not portable.inside(high[None] + 1.0)


def test_formulas_of_the_regressors(portable_of, flight):
    model = portable_of("trend")
    by_name = dict(zip(model.regressor_names, model.regressors, strict=True))
    assert by_name["q_hat"].columns == ("q", "airspeed")
    assert by_name["aileron"].columns == ("elevon_left", "elevon_right")
    np.testing.assert_allclose(
        by_name["q_hat"].values(flight), flight.q * 0.5 / (2 * flight.airspeed)
    )
    np.testing.assert_allclose(
        by_name["aileron"].values(flight), (flight.elevon_left - flight.elevon_right) / 2
    )
    direct = flight.drop(columns=["elevon_left", "elevon_right"]).assign(elevator=0.1, aileron=0.0)
    assert model.predict(direct).shape == (30, 6)
    with pytest.raises(ValueError, match=r"without \['q'\], but the regressor q_hat is computed"):
        model.predict(flight.drop(columns="q"))
    with pytest.raises(ValueError, match=r"shape \(3, 2\), but expected \(n, 6\): alpha, beta"):
        model.predict(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="not finite"):
        model.predict(flight.assign(alpha=np.nan))


def test_the_hash_is_of_names_and_numbers(portable_of):
    model = portable_of("average")
    assert replace(model).content_hash == model.content_hash
    assert replace(model, center=model.center + 1e-15).content_hash != model.content_hash
    assert replace(model, outputs=model.outputs[::-1]).content_hash != model.content_hash


START = DependentGPRegressor(optimizer=None)
OF_ALPHA = RegressorSelector(["alpha"])


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([OF_ALPHA, LinearRegression()], "LinearRegression at the end"),
        (
            [MinMaxScaler().set_output(transform="pandas"), OF_ALPHA, START],
            "'MinMaxScaler'. before the choice of regressors",
        ),
        ([OF_ALPHA, MinMaxScaler(clip=True), START], "Scaler behind the choice of regressors"),
    ],
)
def test_what_has_no_form_is_refused(steps, words, flight, portable_of):
    Y = np.sin(np.outer(10 * flight["alpha"], np.arange(1, 7)))
    model = make_pipeline(*steps).fit(flight[["alpha", "time"]], Y)
    with pytest.raises(ValueError, match=words):
        portable_model(model, portable_of("trend").aircraft)


def test_names_that_other_programs_cannot_write_are_refused(flight, portable_of):
    table = flight[["alpha"]].set_axis(["flap angle"], axis=1)
    Y = np.sin(np.outer(10 * flight["alpha"], np.arange(1, 7)))
    trend = DependentGPRegressor(structure="trend", max_iter=1)
    model = make_pipeline(RegressorSelector(["flap angle"]), trend).fit(table, Y)
    with pytest.raises(ValueError, match=r"\['flap angle'\], but exports need names of letters"):
        portable_model(model, portable_of("trend").aircraft)


def test_no_pipeline_is_refused(portable_of):
    with pytest.raises(TypeError, match="Got LinearRegression to export, but expected a fitted"):
        portable_model(LinearRegression(), portable_of("trend").aircraft)


def test_any_scaling_is_exported(flight, portable_of):
    scalers = (
        MinMaxScaler((-1, 2)),
        RobustScaler(with_centering=False),
        StandardScaler(with_std=False),
        MaxAbsScaler(),
    )
    model = make_pipeline(RegressorSelector(["alpha", "beta"]), *scalers, START)
    model.fit(flight, np.sin(np.outer(10 * flight["alpha"] - flight["beta"], np.arange(1, 7))))
    portable = portable_model(model, portable_of("trend").aircraft)
    np.testing.assert_allclose(
        portable.predict(flight), model.predict(flight), rtol=1e-9, atol=1e-9
    )

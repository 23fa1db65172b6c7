"""The portable model says what the pipeline says, for every kind of posterior."""

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import (
    MaxAbsScaler,
    MinMaxScaler,
    PolynomialFeatures,
    RobustScaler,
    StandardScaler,
)

from skdgp import DependentGPRegressor
from skdgp.dynamics import as_aerodynamics
from skdgp.export import portable_model
from skdgp.preprocessing import RegressorSelector


@pytest.mark.parametrize("input_noise", [True, 2.0, False])
def test_equals_the_pipeline(kind, model, portable, flight, input_noise):
    words = {"include_input_noise": input_noise}
    mean, std = model.pipeline.predict(
        flight, return_std=True, **({} if kind.startswith("calibrated") else words)
    )
    ours, deviation = portable.predict(
        flight, return_std=True, **({} if kind.startswith("calibrated") else words)
    )
    np.testing.assert_allclose(ours, mean, rtol=1e-12, atol=1e-12 * np.abs(mean).max())
    assert (np.abs(deviation - std) <= np.maximum(1e-9 * std, portable.rounding(flight))).all()
    np.testing.assert_allclose(portable.predict(flight), ours, rtol=1e-9, atol=1e-10)


def test_noise_of_each_row(portable_of, flight):
    """Rougher air is a factor for each row; exact rows have the deviation of the function alone."""
    noisy, factors = portable_of("noisy"), np.arange(30.0)
    exact, fit, rough = (
        noisy.predict(flight, True, factor)[1] for factor in (False, True, factors)
    )
    assert (fit > exact).all()
    np.testing.assert_allclose(
        rough**2 - exact**2, factors[:, None] * (fit**2 - exact**2), rtol=1e-6, atol=1e-18
    )


def test_slopes_are_those_of_the_simulation(model, portable, flight):
    aerodynamics = as_aerodynamics(model.pipeline)
    X = portable.regressor_values(flight)
    slopes = aerodynamics.gradient(X)
    assert portable.regressor_names == aerodynamics.regressors
    np.testing.assert_allclose(
        portable.predict_gradient(X), slopes, rtol=1e-9, atol=1e-11 * np.abs(slopes).max()
    )


def test_noise_and_drift_are_those_of_the_regressor(model, portable):
    last, scale = model.pipeline[-1], getattr(model.pipeline[-1], "std_scale_", 1.0)
    regressor = getattr(last, "estimator_", last)
    np.testing.assert_allclose(portable.noise_variance, regressor.noise_variance_ * scale**2)
    np.testing.assert_allclose(portable.drift_variance, last.drift_variance_)
    units = np.multiply.outer(portable.scale, portable.scale)
    np.testing.assert_allclose(portable.input_covariance, regressor.input_covariance_ * units)


def test_the_envelope_is_what_was_flown(kind, portable):
    low, high = portable.envelope.low, portable.envelope.high
    assert (low < high).all()
    samples = portable.envelope.samples
    assert portable.envelope.inside(samples).all()
    assert not portable.envelope.inside(high[None] + 1.0)
    assert len(samples) > 0


def test_each_regressor_says_its_formula(exact, flight):
    by_name = dict(zip(exact.regressor_names, exact.regressors, strict=True))
    assert by_name["q_hat"].columns == ("q", "airspeed")
    assert by_name["aileron"].columns == ("elevon_left", "elevon_right")
    np.testing.assert_allclose(
        by_name["q_hat"].values(flight), flight.q * 0.25 / (2 * flight.airspeed)
    )
    np.testing.assert_allclose(
        by_name["aileron"].values(flight), (flight.elevon_left - flight.elevon_right) / 2
    )
    direct = flight.drop(columns=["elevon_left", "elevon_right"]).assign(elevator=0.1, aileron=0.0)
    assert exact.predict(direct).shape == (30, 6)
    with pytest.raises(
        ValueError, match=r"without \['q'\], but the regressor q_hat is computed from"
    ):
        exact.predict(flight.drop(columns="q"))
    with pytest.raises(
        ValueError, match=r"shape \(3, 2\), but expected \(n, 5\): alpha, beta, q_hat"
    ):
        exact.predict(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="not finite"):
        exact.predict(flight.assign(alpha=np.nan))


def test_the_hash_is_of_the_numbers(exact):
    again = portable_model_of(exact)
    assert again.content_hash == exact.content_hash
    assert portable_model_of(exact, center=exact.center + 1e-15).content_hash != exact.content_hash


def portable_model_of(model, **changes):
    return type(model)(
        **{name: getattr(model, name) for name in model.__dataclass_fields__} | changes
    )


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([RegressorSelector(["alpha"]), LinearRegression()], "LinearRegression at the end"),
        ([DependentGPRegressor(optimizer=None)], "without RegressorSelector"),
        (
            [
                MinMaxScaler().set_output(transform="pandas"),
                RegressorSelector(["alpha"]),
                DependentGPRegressor(optimizer=None),
            ],
            "'MinMaxScaler'. before RegressorSelector",
        ),
        (
            [
                RegressorSelector(["alpha"]),
                MinMaxScaler(clip=True),
                DependentGPRegressor(optimizer=None),
            ],
            "Scaler behind",
        ),
        (
            [
                RegressorSelector(["alpha"]),
                DependentGPRegressor(optimizer=None, trend=PolynomialFeatures(2)),
            ],
            "kernels .'BasisTrend'.",
        ),
    ],
)
def test_what_has_no_form_is_refused(steps, words, flight, exact):
    model = make_pipeline(*steps).fit(
        flight[["alpha", "time"]], np.sin(10 * flight[["alpha"]].to_numpy())
    )
    with pytest.raises(ValueError, match=words):
        portable_model(model, exact.aircraft)


def test_any_scaling_is_exported(flight, exact):
    scalers = (
        MinMaxScaler((-1, 2)),
        RobustScaler(with_centering=False),
        StandardScaler(with_std=False),
        MaxAbsScaler(),
    )
    model = make_pipeline(
        RegressorSelector(["alpha", "beta"]), *scalers, DependentGPRegressor(optimizer=None)
    )
    model.fit(flight, np.sin(np.outer(10 * flight["alpha"] - flight["beta"], np.arange(1, 7))))
    portable = portable_model(model, exact.aircraft)
    np.testing.assert_allclose(
        portable.predict(flight), model.predict(flight), rtol=1e-9, atol=1e-9
    )


def test_no_pipeline_is_refused(exact):
    with pytest.raises(
        TypeError, match="Got LinearRegression to export, but expected a fitted pipeline"
    ):
        portable_model(LinearRegression(), exact.aircraft)

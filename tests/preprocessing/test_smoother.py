"""The flight smoother on tables: which columns, which rates, and the whole way to regressors."""

import numpy as np
import pandas as pd
import pytest
from sklearn.pipeline import make_pipeline

from skdgp._flight.smoothing import differentiate, noise_level, smooth
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightSmoother,
    RateNondimensionalizer,
    RegressorSelector,
)


def flights(n=1200, names=("one", "two")):
    rng = np.random.default_rng(5)
    parts = []
    for k, name in enumerate(names):
        t = 0.025 * np.arange(n)
        truth = {
            "alpha": 0.1 * np.sin(t + k),
            "beta": 0.05 * np.cos(1.3 * t),
            "q": 0.2 * np.cos(t),
            "p": 0 * t,
        }
        table = {key: value + rng.normal(0, 0.005, n) for key, value in truth.items()}
        psi = np.angle(np.exp(1j * (3.0 + 0.3 * t))) + rng.normal(0, 0.01, n)
        rest = {
            "r": 0.1 * np.sin(t),
            "airspeed": 30 + rng.normal(0, 0.3, n),
            "psi": psi,
            "elevator": 0.1 * np.sin(2 * t),
        }
        parts.append(pd.DataFrame({"time": t, "flight": name, **table, **rest}))
    return pd.concat(parts, ignore_index=True)


def test_is_the_signal_module_per_flight():
    table = flights()
    out = FlightSmoother(derivatives=["alpha", "p"], joint=False).fit_transform(table)
    clock = {"time": table.time, "flight": table.flight}
    np.testing.assert_allclose(out.alpha, smooth(table.alpha, **clock), atol=1e-15)
    np.testing.assert_allclose(out.p_dot, differentiate(table.p, **clock), atol=1e-12)
    assert "beta_dot" not in out


def test_automatic_columns_are_the_measured_ones():
    smoother = FlightSmoother().fit(flights())
    assert smoother.columns_ == ["airspeed", "alpha", "beta", "p", "q", "r"]
    assert smoother.derivatives_ == ["alpha", "beta"]


def test_vanes_are_smoothed_in_company():
    table = flights()
    clock = {"time": table.time, "flight": table.flight}
    channels = table[["alpha", "beta", "airspeed", "p", "q", "r"]]
    out = FlightSmoother(derivatives=["alpha", "beta", "p"]).fit_transform(table)
    vanes = smooth(channels, **clock, joint=True)[:, :2]
    np.testing.assert_allclose(out[["alpha", "beta"]], vanes, atol=1e-15)
    np.testing.assert_allclose(
        out.beta_dot, differentiate(channels, **clock, joint=True)[:, 1], atol=1e-12
    )
    np.testing.assert_allclose(
        out[["q", "airspeed"]], smooth(table[["q", "airspeed"]], **clock), atol=1e-12
    )
    np.testing.assert_allclose(out.p_dot, differentiate(table.p, **clock), atol=1e-12)


def test_a_cutoff_of_its_own_leaves_the_company():
    table = flights()
    out = FlightSmoother(cutoff=2.0).fit_transform(table)
    clock = {"time": table.time, "flight": table.flight}
    np.testing.assert_allclose(out.alpha, smooth(table.alpha, cutoff=2.0, **clock))
    np.testing.assert_allclose(out.alpha_dot, differentiate(table.alpha, cutoff=2.0, **clock))


def test_heading_passes_through_pi():
    table = flights()
    out = FlightSmoother(columns=["psi"], derivatives=["psi"]).fit_transform(table)
    assert np.abs(np.angle(np.exp(1j * (out.psi - 3.0 - 0.3 * table.time)))).max() < 0.02
    assert np.abs(out.psi_dot - 0.3).max() < 0.15
    assert np.abs(out.psi - table.psi).max() < 0.1


def test_misspelt_columns():
    table = flights()
    with pytest.raises(ValueError, match=r"'time' \(nearest: 'times'\)"):
        FlightSmoother().fit(table.rename(columns={"time": "times"}))
    with pytest.raises(ValueError, match=r"'aplha' \(nearest: 'alpha'\)"):
        FlightSmoother(columns=["aplha"]).fit(table)


@pytest.mark.shared
def test_shared_flight(shared_data):
    table = pd.read_parquet(shared_data / "flights" / "viggen_uav_train_latlon.parquet")
    steps = make_pipeline(
        FlightSmoother(),
        ElevonSplitter(),
        RateNondimensionalizer(span=2.8, chord=1.2),
        RegressorSelector("classical"),
    )
    out = steps.fit_transform(table)
    assert out.shape == (14_400, 11)
    assert np.isfinite(out.to_numpy()).all()
    names = ["airspeed", "alpha", "beta", "r"]
    noise = noise_level(table[names], table.time, flight=table.get("flight"))
    sheet = [0.3, np.deg2rad(0.3), np.deg2rad(0.3), 0.002]  # of the sensors
    np.testing.assert_allclose(noise, sheet, rtol=0.1)


@pytest.mark.parametrize("name", ["alpha", "beta", "p", "r"])
def test_degrees_are_refused_in_fit_and_transform(name):
    table = flights()
    table[name] = np.linspace(-1.0, 1.0, len(table))  # rad
    wrong = table.assign(**{name: np.rad2deg(table[name])})
    smoother = FlightSmoother().fit(table)
    with pytest.raises(ValueError, match=f"numpy.deg2rad.flight..{name}"):
        FlightSmoother().fit(wrong)
    with pytest.raises(ValueError, match=f"numpy.deg2rad.flight..{name}"):
        smoother.transform(wrong)


def test_a_missing_column_is_named_once_with_its_flight():
    table = flights(names=("one", "two"))
    smoother = FlightSmoother().fit(table)
    second = table[table.flight == "two"].drop(columns="beta")
    with pytest.raises(
        ValueError, match=r"The flight 'two' lacks the columns 'beta'\. Rename"
    ) as error:
        smoother.transform(second)
    assert str(error.value).count("'beta'") == 1
    assert "alpha" not in str(error.value)

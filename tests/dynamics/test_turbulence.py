"""Turbulence: estimated from winds and flights, flown by paths; gusts by Dryden's spectra."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import WIND
from made_flights import GLIDER, LINEAR_GLIDER, TURBULENCE
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline

from skdgp.dynamics import (
    Aerodynamics,
    Air,
    SimulationWarning,
    Turbulence,
    air_data,
    as_aerodynamics,
    dryden_gusts,
    simulate,
)
from skdgp.identification import make_identification_pipeline

SPAN, SPEED, STEP = GLIDER.span, 25.0, 0.05


def times(turbulence, factor):
    return turbulence._replace(intensity=factor * turbulence.intensity)


def flights(turbulence, n_flights, duration, noise, seed, heading=0.0):
    """Straight level flights over the ground at 25 m/s, in gusts and a wind along the way."""
    rng = default_rng(seed)
    n = round(duration / STEP)
    gusts = gusts_of(turbulence, n, rng, n_flights).velocity
    tables = []
    for k in range(n_flights):
        velocity = [SPEED, 0.0, 0.0] - gusts[:, k] + rng.normal(0, noise, (n, 3))
        air = dict(zip(("airspeed", "alpha", "beta"), air_data(velocity), strict=True))
        tables.append(pd.DataFrame({"time": STEP * np.arange(n), "flight": f"flight {k}", **air}))
    speed = SPEED + 3.0
    return pd.concat(tables, ignore_index=True).assign(
        v_north=speed * np.cos(heading), v_east=speed * np.sin(heading), v_down=0.0,
        phi=0.0, theta=0.0, psi=heading,
    )  # fmt: skip


def gusts_of(turbulence, n, rng, n_flights=1, **options):
    """Return gusts of n samples of flights side by side."""
    scales = [np.tile(scale, (n_flights, 1)) for scale in (turbulence.length, turbulence.intensity)]
    return dryden_gusts(n, STEP, SPEED, *scales, SPAN, rng, **options)


def gusty_wind(longer=1.0):
    """Return a table of gusts of 20 s, or longer by a factor."""
    gusts = gusts_of(TURBULENCE, 400, default_rng(0)).velocity[:, 0]
    return pd.DataFrame(gusts, columns=WIND).assign(time=longer * STEP * np.arange(400))


WEAK = Turbulence(np.full(3, 0.2), TURBULENCE.length)


class TestFromFlight:
    @pytest.mark.parametrize(
        ("turbulence", "n_flights", "noise", "heading"),
        [(TURBULENCE, 4, 0.2, 0.0), (TURBULENCE, 4, 0.1, 2.0), (WEAK, 1, 0.5, 0.0)],
    )
    def test_finds_intensity_and_length(self, turbulence, n_flights, noise, heading):
        """Those of u and v are one, in any direction; weak gusts in noise are no noise."""
        flown = flights(turbulence, n_flights, 300.0, noise, n_flights // 4, heading)
        found = Turbulence.from_flight(flown, SPAN)
        assert found.intensity[0] == found.intensity[1]
        assert_allclose(found.intensity, turbulence.intensity, rtol=0.1)
        assert_allclose(found.length, turbulence.length, rtol=0.25)

    def test_calm_air_is_calm(self):
        found = Turbulence.from_flight(
            flights(times(TURBULENCE, 1e-6), 1, 300.0, 0.2, seed=2), SPAN
        )
        assert (found.intensity < 0.25 * 0.2).all()


NAMES = LINEAR_GLIDER.names[:5]


def test_a_pipeline_knows_its_turbulence():
    table = flights(TURBULENCE, 2, 35.0, 0.2, seed=1).assign(p=0.1, q=0.1, r=0.1)
    pipeline = make_identification_pipeline(
        GLIDER, regressors=NAMES, reconstruction="passthrough", cutoff=None,
        regressor=LinearRegression(),
    )  # fmt: skip
    fitted = pipeline.fit(table, np.zeros((len(table), 6)))
    found = as_aerodynamics(fitted).turbulence
    assert_allclose(found.length, Turbulence.from_flight(table, SPAN).length, rtol=1e-9)
    assert clone(fitted).turbulence_ is None
    assert as_aerodynamics(Pipeline(fitted.steps)).turbulence is None


def coefficients(X):
    return LINEAR_GLIDER.level + X @ LINEAR_GLIDER.slopes[:, :5].T


def learned(**known):
    """One aircraft for all paths: what spreads is the air."""
    one = coefficients, None
    return Aerodynamics(coefficients, NAMES, sampler=lambda n_paths, random_state: one, **known)


START = {"airspeed": 12.0, "alpha": 0.05, "altitude": 100.0}
WIND_OF_A_SECOND = pd.DataFrame({"time": [0.0, 1.0], **dict.fromkeys(WIND, 0.0)})
OPTIONS = {"duration": 1.0, "dt": 0.05, "thrust": None, "n_paths": 40}


def flown(model, **options):
    return simulate(model, GLIDER, controls={}, **{"x0": START} | OPTIONS | options)


class TestSimulate:
    def test_gusts_last_as_long_as_those_of_the_turbulence(self):
        """Correlations over a second by Dryden's spectra; the span, 0.2 s long, adds little."""
        paths = flown(learned(), air=Air(gusts=TURBULENCE), n_paths=400)
        T = TURBULENCE.length / START["airspeed"]
        expected = np.exp(-1 / T) * [1.0, 1 - 0.5 / T[1], 1 - 0.5 / T[2]]
        first, last = (paths[np.isclose(paths["time"], time)][WIND] for time in (0.0, 1.0))
        found = [np.corrcoef(first[name], last[name])[0, 1] for name in WIND]
        assert_allclose(found, expected, atol=0.08)
        assert_allclose(last.std(), TURBULENCE.intensity, rtol=0.15)

    def test_a_wind_has_gusts_of_its_own(self):
        """By itself a table decides the intensity, whatever the model was learned in."""
        known = learned(turbulence=times(TURBULENCE, 9.0))
        wind = gusty_wind(SPEED / START["airspeed"])
        by_table = flown(known, air=wind)
        asked = flown(known, air=Air(wind, TURBULENCE))
        assert_allclose(by_table["p"].std(), asked["p"].std(), rtol=0.4)
        held = flown(known, air=wind.assign(wind_north=3.0, wind_east=0.0, wind_down=0.0))
        assert held.query("time == 1.0")["p"].std() < 1e-6  # no gusts

    def test_what_is_not_said_is_as_in_the_training_flights(self):
        known = learned(turbulence=TURBULENCE)
        for wind in (None, [0.0, 0.0, 0.0], WIND_OF_A_SECOND):
            paths, drawn = flown(known, air=wind), flown(known, air=Air(wind, TURBULENCE))
            assert_allclose(paths["p"], drawn["p"], atol=1e-12)

    def test_paths_without_gusts_as_these_are_unknown_are_said(self):
        calm = flown(learned(turbulence=TURBULENCE), air=Air(gusts=None))
        with pytest.warns(SimulationWarning, match="does not know the turbulence"):
            unknown = flown(learned())
        assert_allclose(calm["p"], unknown["p"], atol=1e-12)

    def test_the_mean_meets_the_gusts_of_a_turbulence(self):
        options = {"air": Air(gusts=TURBULENCE), "duration": 20.0}
        one = flown(learned(), **options, n_paths=1)
        for start in (START, pd.DataFrame([START, START])):
            mean = flown(learned(), **options, x0=start, n_paths=None)
            if isinstance(start, dict):
                assert_allclose(mean[[*WIND, "p"]], one[[*WIND, "p"]], atol=1e-9)
            east = mean.groupby("flight", observed=True)["wind_east"]
            assert (east.std() > 0.3 * TURBULENCE.intensity[1]).all()

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"gusts": "as flown"}, "expected 'auto'"),
            ({"drift": 3}, "Got drift=3, but expected True or False"),
            ({"gusts": times(TURBULENCE, -1.0)}, "three intensities >= 0"),
            ({"gusts": TURBULENCE._replace(length=np.zeros(3))}, "lengths > 0"),
            ({"gusts": Turbulence(1.0, 100.0)}, "three intensities"),
        ],
    )
    def test_what_is_no_air_is_said(self, options, message):
        with pytest.raises(ValueError, match=message):
            Air(**options)

    def test_what_cannot_be_flown_is_said(self):
        with pytest.raises(ValueError, match=r"as the air, but expected Air\(gusts=...\)"):
            flown(learned(), air=TURBULENCE)


@pytest.mark.parametrize(("change", "span", "match"), [
    (lambda table: table.groupby("flight").head(200), SPAN, "a flight of 30 s"),

    (lambda table: table[::300], SPAN, "in the air"),
    (lambda table: table.drop(columns="v_down"), SPAN, "v_down"),

])  # fmt: skip
def test_flights_that_show_no_turbulence_are_refused(change, span, match):
    with pytest.raises(ValueError, match=match):
        Turbulence.from_flight(change(flights(TURBULENCE, 1, 200.0, 0.2, seed=3)), span)


def test_low_altitude_is_that_of_the_standard():
    """MIL-F-8785C, 3.7.3.4, in feet, at 50 m in a wind of 7 m/s."""
    h = 50.0 / 0.3048
    found = Turbulence.low_altitude(50.0, 7.0)
    longer = h / (0.177 + 0.000823 * h) ** 1.2
    assert_allclose(found.length / 0.3048, [longer, longer, h])
    stronger = 0.1 * 7.0 / (0.177 + 0.000823 * h) ** 0.4
    assert_allclose(found.intensity, [stronger, stronger, 0.7])


@pytest.mark.parametrize(("height", "wind", "match"), [
    (0.0, 5.0, "Got height=0"),
    (304.9, 5.0, "at most 304.8 m"),
    (100.0, -1.0, "wind_at_6m=-1"),

])  # fmt: skip
def test_heights_and_winds_of_no_turbulence(height, wind, match):
    with pytest.raises(ValueError, match=match):
        Turbulence.low_altitude(height, wind)

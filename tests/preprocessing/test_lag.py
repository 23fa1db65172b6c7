"""Lags that are put in are found, with the uncertainty they have, and taken out."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import RATES, SURFACES
from log_errors import elsewhere, placed
from made_flights import make_flight, rms
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from skdgp.dynamics import Aircraft, Servos
from skdgp.preprocessing import LagCorrector

STEP = 0.025


def corrected(table, lags="auto"):
    return LagCorrector(lags).fit_transform(table)


def lags_of(table):
    return LagCorrector().fit(table).lags_


def late(table, **lags):
    """Return the table with groups of channels late by so many seconds."""
    return corrected(table, {group: -lag for group, lag in lags.items()})


def linear_aircraft(seed, air=0.0, surfaces=0.0, servos=0.0, seconds=60.0, width=6):
    """Return a log of an aircraft whose accelerations are linear in vanes, surfaces and rates.

    Sensors are late, and surfaces are the commands of servos with a first-order lag. Inputs are noise,
    smoothed over ``width`` samples.
    """
    names = {"p q r alpha beta elevator aileron rudder": (0, 1, 0)}
    waves = make_flight(names, round(seconds / STEP) + 160, STEP, width=width, seed=seed)
    time, p, q, r, alpha, beta, elevator, aileron, rudder = waves.to_numpy().T
    forces = {"ax": 0.1 * alpha**2, "ay": -4 * beta + rudder, "az": -9.8 - 9 * alpha - elevator}
    table = pd.DataFrame({"time": time, **forces})
    accelerations = [3 * aileron - p + beta, 2 * elevator - q - alpha, rudder - r + beta]
    table[RATES] = cumulative_trapezoid(accelerations, time, initial=0).T
    deflections = CubicSpline(time, waves[SURFACES])
    table[SURFACES] = deflections(time - surfaces) + servos * deflections(time - surfaces, 1)
    vanes = CubicSpline(time, 0.1 * waves[["alpha", "beta"]])
    noise = default_rng(seed).normal(0, 0.02, (2, time.size))
    table[["alpha", "beta"]] = vanes(time - air) + noise.T
    return table[80:-80].reset_index(drop=True)


def found_in(table):
    """Return the lags by group; without an attitude the reconstruction, which takes seconds, is left out."""
    return lags_of(table.drop(columns="phi", errors="ignore"))


def tells_nothing(table):
    lags = lags_of(table)
    return set(lags.remark) == {"not shown by these flights"} and (lags.applied == 0.0).all()


class TestEstimate:
    def test_clean_flights_have_no_lags_to_remove(self, latlon):
        lags = found_in(latlon)
        assert_allclose(lags.lag[["air", "surfaces"]], 0.0, atol=0.01)
        assert (lags.applied == 0).all()

    @pytest.mark.parametrize(("air", "surfaces"), [(0.08, 0.05), (0.08, -0.05), (-0.08, 0.0)])
    def test_lags_put_in_together_are_found(self, latlon, air, surfaces):
        lags = found_in(late(latlon, air=air, surfaces=surfaces))
        # those that are early may as well follow by a lag of servos
        assert_allclose(lags.lag["surfaces"] - lags.lag["servos"], surfaces, rtol=0, atol=0.01)
        assert_allclose(lags.lag["air"], air, rtol=0, atol=0.01)

    def test_the_standard_deviation_is_that_of_the_errors(self):
        """Over logs of one aircraft, with noisy vanes; Student's quantile of few pieces is three times the usual."""
        errors = []
        for seed in range(16):
            found = found_in(linear_aircraft(seed, air=0.06, seconds=40)).loc["air"]
            errors.append((found["lag"] - 0.06) / found["std"])
        assert 0.3 < rms(errors) < 1.7

    @pytest.mark.parametrize(("servos", "delay"), [(0.1, 0.0), (0.04, 0.03)])
    def test_commands_are_told_from_deflections_by_lag_and_delay(self, servos, delay):
        truth = linear_aircraft(2, width=2, seconds=40)
        table = linear_aircraft(2, servos=servos, surfaces=-delay, width=2, seconds=40)
        rng = default_rng(2)
        for name in RATES:
            table[name] += rng.normal(0, 0.002 * np.std(table[name]), len(table))
        corrector = LagCorrector()
        out = corrector.fit_transform(table)
        assert_allclose(corrector.lags_.applied["servos"], servos, rtol=0, atol=0.01)
        assert_allclose(corrector.lags_.applied["surfaces"], -delay, rtol=0, atol=0.01)
        assert_allclose(corrector.servos_.lag, servos, rtol=0, atol=0.01)
        assert_allclose(corrector.servos_.delay, delay, rtol=0, atol=0.01)
        assert 0.0 < corrector.servos_.delay_std < corrector.servos_.lag_std < 0.02
        # the time of both together is known better than the lag
        std = corrector.lags_["std"]["surfaces"]
        together = corrector.servos_.lag + corrector.servos_.delay
        assert abs(together - servos - delay) < 2 * std < 2 * corrector.servos_.lag_std
        error = (out.elevator - truth.elevator)[40:-40].std()
        assert error < 0.2 * (table.elevator - truth.elevator)[40:-40].std()

    @pytest.mark.parametrize("seed", [0, 1])
    def test_noise_of_rates_makes_surfaces_no_later(self, seed):
        """Turns w' = -a w + b d, whose damping least squares of noisy rates would make too small."""
        step = 0.005
        names = {"elevator aileron": (0, 0.05, 0)}
        commands = make_flight(names, 12000, step, width=60, seed=seed)[["elevator", "aileron"]]
        turn = lfilter([0, 100 * step], [1, 5 * step - 1], commands, axis=0)
        late = 3  # samples
        table = make_flight({"ax ay az p q r": (0, 0, 0.005)}, 3000, 4 * step)
        noise = default_rng(seed).normal(0, 0.1 * np.std(turn, axis=0), (3000, 2))
        table[["p", "q"]] += np.roll(turn, late, axis=0)[::4] + noise
        table[["elevator", "aileron"]] = commands.to_numpy()[::4]
        lags = found_in(table)
        # of the difference equation half a step
        right = -(late + 0.5) * step
        assert_allclose(lags.lag["surfaces"] - lags.lag["servos"], right, rtol=0, atol=0.004)

    @pytest.mark.parametrize(
        ("servos", "delay", "removed", "n_flights"),
        [(0.06, 0.0125, 0.0, 1), (0.06, 0.05, 0.043, 3)],
    )
    def test_without_vanes_a_delay_shorter_than_a_step_is_left_to_the_filter(
        self, latlon, servos, delay, removed, n_flights
    ):
        flight = latlon.drop(columns=["alpha", "beta"])
        time = flight["time"].to_numpy()
        for name in ("elevon_left", "elevon_right"):
            deflection = CubicSpline(time, flight[name])
            later = np.minimum(time + delay, time[-1])
            flight[name] = deflection(later) + servos * deflection(later, 1)
        flights = [flight.assign(flight=number) for number in range(n_flights)]
        corrector = LagCorrector()
        out = corrector.fit_transform(pd.concat(flights, ignore_index=True))
        applied = corrector.lags_.applied
        assert_allclose(applied["surfaces"], -removed, rtol=0, atol=0.01)
        in_lag = 0.01 if removed else 0.0
        assert delay + applied["surfaces"] - in_lag < 2 * out["servo_delay_std"][0]
        assert applied["servos"] == 0.0
        if removed:  # but for two standard deviations, at most 10 ms
            left = applied["surfaces"] - corrector.lags_.lag["surfaces"]
            assert_allclose(left, min(2 * corrector.servos_.delay_std, 0.01), rtol=0, atol=1e-6)
        # slow inputs tell the sum
        found = corrector.servos_
        assert_allclose(found.lag + found.delay, servos + delay, rtol=0, atol=0.02)

    def test_attitude_and_gps_are_found_by_kinematics(self, latlon):
        spoilt = late(latlon[:1400], attitude=0.06, gps=-0.05)
        lags = lags_of(spoilt.assign(time=spoilt["time"] + 5000.0))  # of a clock started long ago
        assert_allclose(lags.lag["attitude"], 0.06, rtol=0, atol=0.005)
        assert_allclose(lags.lag["gps"], -0.05, rtol=0, atol=0.005)
        assert (lags.applied == lags.lag)[["attitude", "gps"]].all()

    def test_sensors_ahead_of_the_centre_of_gravity_are_not_late(self, latlon):
        """Wherever their position is stated: a lag of GPS would be their rotation."""
        flight = latlon[:1200]
        place = (0.5, 0.0, 0.0)
        ahead = Aircraft.estimate(mass=45.0, span=2.8, sensor_position=place)
        flight = elsewhere(flight, place)
        of_aircraft = LagCorrector(aircraft=ahead).fit(flight).lags_
        assert_frame_equal(of_aircraft, lags_of(placed(flight, place)))
        assert of_aircraft.applied["gps"] == 0.0

    def test_channels_that_have_nothing_to_do_with_each_other_tell_nothing(self):
        table = linear_aircraft(0)
        noise = default_rng(9).normal(size=(len(table), 5))
        table[["alpha", "beta", "elevator", "aileron", "rudder"]] = noise
        assert tells_nothing(table)

    def test_an_error_of_the_model_that_changes_is_no_lag(self):
        """A flight whose servos have another lag, of another sign, in each piece."""
        lags = [0.08, -0.08, 0.06, -0.05, 0.07, -0.1, 0.05, -0.06]
        parts = [linear_aircraft(k, surfaces=lag, seconds=21) for k, lag in enumerate(lags)]
        flights = pd.concat([part.assign(flight=k) for k, part in enumerate(parts)])
        assert found_in(flights.reset_index(drop=True)).applied["surfaces"] == 0

    @pytest.mark.parametrize("lag", [0.0, 0.1, 0.5])
    @pytest.mark.parametrize("begin", [6.0, 30.0])
    def test_vanes_of_a_record_of_12_s_by_the_motion(self, latlon, lag, begin):
        """alpha follows q + az / V, so a record of few manoeuvres shows its lag, and none where none is."""
        record = late(latlon, air=lag)
        elapsed = record["time"] - record["time"].iloc[0]
        lags = found_in(record[(elapsed > begin) & (elapsed < begin + 12.0)].reset_index(drop=True))
        assert_allclose(lags.lag["air"], lag, rtol=0, atol=0.02)
        assert lags["std"]["air"] < 0.02
        assert (lags.applied["air"] == 0.0) == (lag == 0.0)

    @pytest.mark.parametrize("lag", [{"air": -0.35}, {"surfaces": -0.5}, {"surfaces": 0.8}])
    def test_a_lag_beyond_those_that_are_tried_is_unknown(self, lag):
        assert lags_of(linear_aircraft(2, **lag))["std"][list(lag)].isna().all()

    def test_a_flight_too_short_tells_nothing(self):
        assert tells_nothing(linear_aircraft(0, seconds=9, air=0.05))

    @pytest.mark.filterwarnings("error")
    def test_a_vane_that_never_moves_says_nothing(self):
        table = linear_aircraft(0, air=0.06)
        missing = table.drop(columns="beta")
        assert_frame_equal(lags_of(table.assign(beta=0.02)), lags_of(missing))
        assert_allclose(lags_of(missing).lag["air"], 0.06, rtol=0, atol=0.01)

    def test_a_log_slower_than_the_band_tells_nothing(self):
        assert tells_nothing(linear_aircraft(0)[::27])  # 1.5 Hz

    def test_flights_without_inertial_sensors_tell_nothing(self):
        table = linear_aircraft(0).drop(columns="q")
        assert_frame_equal(corrected(table), table)


class TestTransform:
    def test_clean_flights_pass_unchanged(self, latlon):
        assert_frame_equal(corrected(latlon[:1600]), latlon[:1600])

    @pytest.mark.parametrize(("surfaces", "lag", "delay"), [(-0.06, 0.005, 0.06), (0.03, 0.0, 0.0)])
    def test_surfaces_that_are_late_are_no_servos_that_lead(self, surfaces, lag, delay):
        lags = {"surfaces": surfaces} | ({"servos": lag} if lag else {})
        given = LagCorrector(lags).fit(linear_aircraft(0))
        assert given.servos_ == Servos(lag=lag, delay=delay)
        assert "servo_delay_std" not in given.get_feature_names_out()

    @pytest.mark.parametrize("lag", [0.0675, -0.0675])
    def test_a_line_is_shifted_exactly(self, lag):
        time = np.arange(0, 20, STEP)
        table = pd.DataFrame({"time": time, "alpha": 0.01 * time - 0.1})
        out = corrected(table, {"alpha": lag})
        inside = (time + lag >= time[0]) & (time + lag <= time[-1])
        expected = 0.01 * (time + lag) - 0.1
        assert_allclose(out.alpha[inside], expected[inside], atol=1e-12)

    def test_never_across_a_gap_or_into_another_flight(self):
        time = np.r_[0:50, 100:150, 0:50] * STEP
        table = pd.DataFrame(
            {"time": time, "flight": ["a"] * 100 + ["b"] * 50, "alpha": np.repeat([1.0, 2, 3], 50)}
        )
        for lag in (0.3, -0.3):
            assert_allclose(corrected(table, {"alpha": lag}).alpha, table.alpha)

    def test_what_was_not_sampled_stays_so(self):
        time = np.arange(0, 10, STEP)
        table = pd.DataFrame({"time": time, "alpha": np.sin(time - 0.1)})
        table.loc[table.index % 4 != 0, "alpha"] = np.nan
        table.loc[100:200, "alpha"] = np.nan
        out = corrected(table, {"alpha": 0.1})
        assert out.alpha.isna().equals(table.alpha.isna())
        commands = table.rename(columns={"alpha": "elevator"})
        assert corrected(commands, {"servos": 0.1}).elevator.isna().equals(table.alpha.isna())
        known = out.alpha.notna() & ~table.index.isin([*range(92, 100), *range(390, 400)])
        assert_allclose(out.alpha[known], np.sin(time)[known], atol=1e-3)

    @pytest.mark.parametrize(
        ("lags", "words"),
        [
            ({"vane": 0.1}, "a lag of 'vane', but"),
            ({"air": np.nan}, "expected a finite number"),
            ({"servos": -0.1}, "expected a number >= 0"),
        ],
    )
    def test_lags_that_cannot_be(self, lags, words):
        with pytest.raises(ValueError, match=words):
            LagCorrector(lags).fit(linear_aircraft(0, seconds=2))

    def test_attitude_and_position_are_unknown_beyond_the_end_however_named(self, latlon):
        for name, lags in (("psi", {"psi": 0.1}), ("psi", {"attitude": 0.1})):
            assert np.isnan(corrected(latlon, lags)[name].iloc[-1])
        assert np.isfinite(corrected(latlon, {"alpha": 0.1})["alpha"].iloc[-1])


@pytest.mark.parametrize("rate_limit", [2.0, 20.0])
def test_a_limit_of_the_rate_of_servos_is_found_where_flights_reach_it(rate_limit):
    """Turns w' = -a w + b d, behind servos of 40 ms that move steps of many sizes at up to some 5 rad/s."""
    rng = default_rng(0)
    step = 0.004
    n = 20000
    held = (rng.uniform(0.15, 0.8, (2, n // 37)) / step).astype(int)
    sizes = 0.08 * rng.normal(size=held.shape)
    commands = np.column_stack([np.repeat(*each)[:n] for each in zip(sizes, held, strict=True)])
    delta = np.zeros((n, 2))
    for k in range(n - 1):
        rate = np.clip((commands[k] - delta[k]) / 0.04, -rate_limit, rate_limit)
        delta[k + 1] = delta[k] + step * rate
    turn = lfilter([0, 100 * step], [1, 10 * step - 1], delta, axis=0)
    table = make_flight({"ax ay az p q r": (0, 0, 0.005)}, n // 5, 5 * step)
    table[["p", "q"]] += turn[::5]
    table[["aileron", "elevator"]] = commands[::5]
    if rate_limit == 20.0:
        assert LagCorrector().fit(table).servos_.rate_limit == np.inf
        return
    with pytest.warns(UserWarning, match="reach a limit of their rate"):
        corrector = LagCorrector().fit(table)
    assert_allclose(corrector.servos_.rate_limit, rate_limit, rtol=0.3)
    found = corrector.transform(table)["aileron"]
    truth = delta[::5, 0]
    assert np.std(found - truth) < 0.4 * np.std(table["aileron"] - truth)

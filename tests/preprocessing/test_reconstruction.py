"""Flight-path reconstruction: its equations, what it recovers, and what it says when it cannot."""

import pickle
import tracemalloc
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from flight_columns import AIR, EULER, FORCES, POSITION, RATES, VELOCITY, WIND
from log_errors import elsewhere, late, with_channels
from made_flights import GLIDER, flight_of_motion, lasting, rms, wrapped
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sklearn.pipeline import make_pipeline

from skdgp._flight.findings import Code
from skdgp.dynamics import Servos
from skdgp.estimation import PATH_CHANNELS, air_columns, estimate_path, flights_of
from skdgp.preprocessing import (
    FlightDataWarning,
    FlightPathReconstruction,
    FlightSmoother,
    LagCorrector,
)

# White noise of the sensors, standard deviation
SHEET = {
    **dict.fromkeys(FORCES, 0.05),
    **dict.fromkeys(RATES, 0.002),
    **dict.fromkeys([*EULER, "alpha", "beta"], 0.005),
    **dict.fromkeys(VELOCITY, 0.1),
    "airspeed": 0.3,
}
MEAN_WIND = [3.0, -2.0, 0.0]


def motion(t, turn, loop):
    """Return attitude and airspeed vector (n, 3), body axes, as functions of time."""
    moving = turn != 0.0
    rolling = loop == 0.0
    psi = turn * t + 0.1 * moving * np.sin(0.9 * t)
    theta = 0.15 * np.sin(0.7 * t)
    phi = 0.4 * rolling * np.sin(0.5 * t)
    attitude = Rotation.from_euler("ZYX", np.column_stack([psi, theta, phi]))
    attitude *= Rotation.from_euler("Y", (loop * t)[:, None])
    turned = [0.02 * np.sin(t), 0.05 * np.sin(0.8 * t), -0.08 - 0.04 * np.sin(2 * t)]
    ahead = Rotation.from_rotvec(np.transpose(turned)).as_matrix()[:, :, 0] * [1, 1, -1]
    return attitude, (25 + 3 * moving * np.sin(0.3 * t))[:, None] * ahead


def flown(seconds=30.0, rate=25.0, *, gusts=0.0, seed=0, turn=0.3, loop=0.0):
    """A flight whose attitude and motion are given functions of time, with noise of the sensors.

    Heading turns at ``turn`` (0: straight at constant speed), or the nose is carried through the
    vertical at ``loop`` [rad/s]; gusts are a random walk [m/s in one second].
    """
    rng = default_rng(seed)
    clock = np.arange(0, seconds, 1 / rate)

    def attitude(t):
        return motion(t, turn, loop)[0]

    def velocity(t):
        turned, through_air = motion(t, turn, loop)
        return turned.apply(through_air) + MEAN_WIND

    walk = gusts / np.sqrt(rate) * np.cumsum(rng.standard_normal((len(clock), 3)), axis=0)
    wind = MEAN_WIND + walk - walk.mean(axis=0)
    truth = flight_of_motion(clock, attitude, velocity, wind).drop(columns="time")
    truth[WIND] = wind
    table = truth.add_suffix("_true").assign(time=clock, flight="one")
    for name, std in SHEET.items():
        table[name] = truth[name] + rng.normal(0, std, len(clock))
    return table


def fitted(table, **options):
    return FlightPathReconstruction(**options).fit(table)


def path_of(table):
    return FlightPathReconstruction().fit_transform(table)


@cache
def reconstructed(**options):
    """Return a flight, the reconstruction fitted to it, and what it gives; not to be changed."""
    table = flown(**options)
    reconstruction = fitted(table)
    return table, reconstruction, reconstruction.transform(table)


def true(table, names):
    """Return channels without noise, (n, k)."""
    return table[[f"{name}_true" for name in names]]


def error(table, out, name):
    """Root mean square."""
    gap = out[name] - table[f"{name}_true"]
    if name in ("phi", "psi"):
        gap = wrapped(gap)
    return rms(gap)


def assert_near(table, out, limits):
    for name, limit in limits.items():
        assert error(table, out, name) < limit, name


def shares(share):
    """Return limits of the errors of air data: a share of the noise of the vanes."""
    return {name: share * SHEET[name] for name in AIR}


class TestRecovery:
    def test_in_calm_air_the_vanes_noise_all_but_vanishes(self):
        table, reconstruction, out = reconstructed()
        assert_near(table, out, shares(0.15) | {"airspeed": 0.1 * SHEET["airspeed"]})
        assert_near(table, out, dict.fromkeys(EULER, 0.2 * 0.005) | dict.fromkeys(WIND, 0.05))
        sheet = {"airspeed": 0.3, "alpha": 0.005, "v_down": 0.1, "tilt": 0.005}
        found = [reconstruction.noise_std_[name] for name in sheet]
        assert_allclose(found, [*sheet.values()], rtol=0.06)

    @pytest.mark.parametrize("gusts", [0.1, 0.5])
    def test_gusts_are_followed(self, gusts):
        table, _, out = reconstructed(gusts=gusts)
        assert_near(table, out, shares(0.65))

    def test_injected_errors_are_found_and_removed(self):
        biases = dict(zip([*FORCES, *RATES], (0.15, -0.1, 0.2, 0.01, -0.008, 0.012), strict=True))
        table = flown()
        for name, bias in biases.items():
            table[name] += bias
        reconstruction = fitted(table)
        found = reconstruction.calibration_.set_index("constant")
        for name, bias in biases.items():
            estimate, std = found.loc[f"{name}_bias", ["estimate", "std"]]
            assert_allclose(estimate, bias, rtol=0, atol=4 * std)
        assert reconstruction.servos_ == Servos()  # without an aircraft it is not estimated
        out = reconstruction.transform(table)
        assert_near(table, out, {"airspeed": 0.06, "alpha": 0.002, "ax": 0.06, "r": 0.0022})

    def test_through_the_vertical(self):
        table = flown(20.0, loop=0.5, turn=0.0)
        assert np.abs(table.theta_true).max() > 1.5
        out = path_of(table)
        truth = Rotation.from_euler("ZYX", table[["psi_true", "theta_true", "phi_true"]])
        found = Rotation.from_euler("ZYX", out[["psi", "theta", "phi"]])
        assert (truth.inv() * found).magnitude().max() < 0.006
        assert error(table, out, "alpha") < 0.0015

    @pytest.mark.filterwarnings("ignore:Sensors contradict")
    def test_forces_are_moved_to_the_centre_of_gravity(self):
        """Sensors two metres ahead; their acceleration is that of the true rotation."""
        table = flown(20.0)
        arm = (2.0, 0.1, -0.2)
        spin = CubicSpline(table["time"], true(table, RATES))(table["time"], 1)
        far = elsewhere(table, arm, spin)
        reconstruction = fitted(far, aircraft=replace(GLIDER, sensor_position=arm))
        out = reconstruction.transform(far)
        assert_near(table, out, shares(0.2) | dict.fromkeys(FORCES, 0.08))
        assert_allclose(out[POSITION], 0.0)
        assert list(reconstruction.get_feature_names_out()) == list(out.columns)
        wrong = path_of(far)
        for name in FORCES:
            assert error(table, wrong, name) > 1.8 * error(table, out, name)

    def test_slow_and_silent_sensors(self):
        table = flown(20.0)
        slow = table.copy()
        row = np.arange(len(table))
        slow.loc[row % 5 != 0, VELOCITY] = np.nan  # GPS at 5 Hz
        slow.loc[row % 3 != 0, ["alpha"]] = np.nan
        slow.loc[(row > 300) & (row < 350), [*EULER, "airspeed"]] = np.nan
        slow.loc[row % 50 == 7, ["p", "ax"]] = np.nan
        out = path_of(slow)
        assert out[[*AIR, "p", "ax", "psi", "wind_down"]].notna().all(axis=None)
        assert_near(table, out, shares(0.3))

    def test_a_gap_is_not_bridged(self):
        table = flown(24.0)
        parts = table[(table.time < 10) | (table.time > 14)].reset_index(drop=True)
        assert_near(parts, path_of(parts), shares(0.25))

    def test_without_vanes(self):
        table = flown(40.0)
        out = path_of(table.drop(columns=["alpha", "beta"]))
        assert_near(table, out, {"alpha": 0.003, "beta": 0.003})
        assert {"alpha", "beta", "alpha_dot", "beta_dot"} <= set(out)


class TestHonesty:
    def test_parts_of_a_long_flight_bound_the_memory_and_leave_no_seam(self):
        """Paths differ by little of their error where parts of 250 rows meet."""
        table = flown(40.0, gusts=0.5, seed=2)
        reconstruction = fitted(table[:250])
        found = []
        peaks = []
        for max_rows in (1000, 250):
            reconstruction.set_params(max_rows=max_rows)
            tracemalloc.start()
            found.append(reconstruction.transform(table))
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
        assert peaks[1] < peaks[0] / 2
        whole, parts = found
        for name in AIR:
            assert (parts[name] - whole[name]).std() < 0.1 * error(table, whole, name)

    def test_doubt_of_paths_that_did_not_converge_travels_with_the_model(self, monkeypatch):
        flights = [flown(10.0).assign(flight=name) for name in ("a", "b")]
        estimates = iter([True, False])

        def ended(*arguments, **options):
            return estimate_path(*arguments, **options)._replace(converged=next(estimates))

        monkeypatch.setattr("skdgp.preprocessing._flight_path.estimate_path", ended)
        with pytest.warns(UserWarning, match="did not converge: b"):
            reconstruction = fitted(pd.concat(flights, ignore_index=True))
        (doubt,) = pickle.loads(pickle.dumps(reconstruction)).doubts_
        assert doubt.code.name == "PATHS_NOT_CONVERGED"
        assert doubt.numbers["flights"] == ["b"]

    def test_gusts_without_vanes_and_aircraft_are_not_known(self):
        (doubt,) = fitted(flown(10.0).drop(columns=["alpha", "beta"])).doubts_
        assert doubt.code.name == "GUSTS_UNKNOWN"
        assert doubt.numbers["cause"].code.name == "NO_AIRCRAFT"

    def test_flights_are_not_mixed(self):
        one, reconstruction, alone = reconstructed()
        two = flown(6.0, seed=1, gusts=0.3).assign(flight="two")
        both = reconstruction.transform(pd.concat([one, two], ignore_index=True))
        apart = pd.concat([alone, reconstruction.transform(two)], ignore_index=True)
        assert_frame_equal(both, apart)

    def test_rates_of_change(self):
        table, _, out = reconstructed()
        for name in ("alpha", "beta"):
            truth = CubicSpline(table.time, table[f"{name}_true"])(table.time, 1)
            assert np.std(out[f"{name}_dot"] - truth) < 0.12 * truth.std()  # gyros as they are


class TestIncomplete:
    def test_flights_of_fit_that_lack_a_sensor_pass_as_they_are(self):
        flight = flown(20).drop(columns="phi")
        reconstruction = fitted(flight)
        assert reconstruction.missing_ == ["phi"]
        assert_frame_equal(reconstruction.transform(flight), flight)

    def test_a_later_flight_that_lacks_one_is_smoothed_and_said(self):
        flight = flown(20)
        reconstruction = fitted(flight)
        with pytest.warns(
            FlightDataWarning, match=r"Got flights without \['phi'\], which those of the fit had"
        ):
            out = reconstruction.transform(flight.drop(columns="phi"))
        assert error(flight, out, "alpha") < 0.7 * error(flight, flight, "alpha")
        assert "alpha_dot" in out
        assert "gust" not in out

    def test_a_sensor_silent_in_one_of_the_flights_is_missing(self):
        second = flown(20).assign(flight="two", p=np.nan)
        both = pd.concat([flown(20), second], ignore_index=True)
        assert fitted(both).missing_ == ["p"]


def wandering(table, names, std):
    """The table with errors of exponential correlation over 5 s."""
    errors = std * lasting(default_rng(5), (len(table), len(names)), 5.0 * 25.0)
    return table.assign(**(table[names] + errors))


@pytest.mark.filterwarnings("ignore:Sensors contradict")
class TestInconsistent:
    """Whether the reconstruction is used: the truth, which the check does not see, says whether that is right."""

    @pytest.mark.parametrize(
        ("damage", "sensor", "is_smoothed"),
        [
            (lambda table: wandering(table, EULER, 0.05), "gyro", False),
            (lambda table: wandering(table, VELOCITY, 2.0), "accelerometer", False),
            (
                lambda table: with_channels(table, AIR, true(table, AIR)),
                "alpha",
                True,
            ),
        ],
        ids=["attitude wanders", "velocity wanders", "air data without noise"],
    )
    def test_contradictions_are_named_and_the_flights_pass(self, damage, sensor, is_smoothed):
        table = damage(flown(20.0, gusts=0.1, seed=2))
        reconstruction = fitted(table)
        assert not reconstruction.used_
        found = {
            found.channel: found.numbers["is_smoothed"] for found in reconstruction.contradictions_
        }
        assert found[sensor] == is_smoothed
        assert sensor in reconstruction.finding_.clause
        assert_frame_equal(reconstruction.transform(table), table)
        assert "gust" not in reconstruction.get_feature_names_out()
        reconstruction.used_ = True  # all the same
        path = reconstruction.transform(table)
        smooth = FlightSmoother().fit_transform(table)
        assert error(table, path, "alpha") > error(table, smooth, "alpha")

    def test_inertial_sensors_elsewhere_are_told(self):
        """In the nose of a long aircraft; the path follows a part of what they read, so they seem nearer."""
        moved = elsewhere(flown(20.0, gusts=0.1), (30.0, 0.0, 0.0))
        (doubt,) = fitted(moved).doubts_
        arm = doubt.numbers["arm"]
        assert 3.0 < arm["x"] < 30.0
        assert abs(arm["y"]) + abs(arm["z"]) < arm["x"] / 2
        (doubt,) = fitted(wandering(flown(20.0), EULER, 0.05)).doubts_
        assert doubt.code is Code.SENSORS_DISAGREE
        assert doubt.numbers["arm"] is None

    def test_flights_do_not_fly_backwards(self):
        table = flown(20.0).drop(columns=["alpha", "beta"])
        table[["v_north", "v_east"]] *= -1.0
        with pytest.raises(ValueError, match="fly backwards"):
            FlightPathReconstruction().fit_transform(table)

    def test_it_is_used_after_correction_of_lags(self):
        table, _, best = reconstructed(seconds=20.0, gusts=0.3)
        delayed = late(late(table, 0.2, EULER), 0.3, VELOCITY)
        steps = make_pipeline(LagCorrector(), FlightPathReconstruction())
        out = steps.fit_transform(delayed)
        assert steps[-1].used_
        assert_near(table, out, {name: 1.1 * error(table, best, name) for name in AIR})

    def test_one_filtered_sensor_of_air_data_does_not_decide(self):
        table = flown(25.0, gusts=0.1)
        mean = table["airspeed"].rolling(9, center=True, min_periods=1).mean()
        filtered = table.assign(airspeed=mean)
        reconstruction = fitted(filtered)
        assert reconstruction.used_
        assert [found.channel for found in reconstruction.contradictions_] == ["airspeed"]
        filtered = filtered.assign(alpha=table["alpha_true"])
        assert not fitted(filtered).used_

    def test_without_a_vane_there_is_no_choice(self):
        table = wandering(flown(20.0), EULER, 0.05).drop(columns="beta")
        reconstruction = fitted(table)
        assert reconstruction.used_
        assert "gyro" in [found.channel for found in reconstruction.contradictions_]


def test_gusts_are_told():
    """A piece of half a second has the gusts of the fit."""
    reconstruction = fitted(flown(40, gusts=0.4))
    fit = reconstruction.gust_std_
    assert_allclose(fit, 0.4, rtol=0.3)

    def gust(table):
        return reconstruction.transform(table)["gust"].iloc[0]

    assert_allclose(gust(flown(40, gusts=0.8, seed=1)), 0.8, rtol=0.3)
    assert gust(flown(40, gusts=0.0, seed=1)) < 0.1
    assert_allclose(gust(flown(40, gusts=0.4, seed=1)[:13]), fit, rtol=0.2)


class TestBadInput:
    @pytest.mark.parametrize("rows", [1, 2])
    def test_very_short_flights(self, rows):
        out = path_of(flown(1.0)[:rows])
        out = out.drop(columns=["alpha_dot", "beta_dot"] if rows == 1 else [])
        assert np.isfinite(out.select_dtypes("number")).all(axis=None)


def test_heading_between_thinned_rows_does_not_cross_zero_at_pi():
    table = flown(seconds=2.0, rate=100.0)
    psi = np.pi + table["time"] - table["time"].mean()
    air = table.assign(**dict.fromkeys(WIND, 0.0))
    air["psi"] = (psi + np.pi) % (2 * np.pi) - np.pi
    thinned = air[[*AIR, *PATH_CHANNELS[:-1], *WIND]]
    thinned.iloc[1::2] = np.nan
    columns = air_columns(thinned, flights_of(table)[0].sensors)
    assert_allclose(np.cos(columns["psi"] - psi), 1.0, atol=1e-4)

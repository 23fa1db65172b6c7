"""Faults of logs: each is found, named and taken out, and nothing else is."""

import warnings

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from scipy.ndimage import gaussian_filter1d
from sklearn.pipeline import make_pipeline

from skdgp._flight.faults import find_faults, without_faults
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification._prepare import usable_flights
from skdgp.io import FlightReadError, read_flight
from skdgp.preprocessing import (
    FlightCheck,
    FlightDataWarning,
    FlightSmoother,
    RegressorSelector,
    inspect_flight,
)

STEP = 0.025
GLIDER = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)


def log(seconds=60.0, seed=0, name="sortie"):
    """Return a flight of noisy sensors and a pilot's controls."""
    rng = default_rng(seed)
    time = STEP * np.arange(round(seconds / STEP))
    levels = {"airspeed": (30, 2, 0.3), "alpha": (0.06, 0.03, 0.005), "beta": (0, 0.03, 0.005)}
    levels |= {
        **dict.fromkeys("pqr", (0, 0.2, 0.002)),
        **dict.fromkeys(("ax", "ay"), (0, 1, 0.05)),
        "az": (-9.8, 2, 0.05),
    }
    levels |= dict.fromkeys(("v_north", "v_east", "v_down"), (10, 5, 0.1))
    table = pd.DataFrame({"time": time, "flight": name})
    for column, (mean, spread, noise) in levels.items():
        wave = gaussian_filter1d(rng.normal(size=time.size), 20)
        table[column] = mean + spread * wave / wave.std() + rng.normal(0, noise, time.size)
    return table.assign(density=1.2, elevator=np.where(time % 10 < 1, 0.1, 0.0), throttle=0.6)


def faults(table):
    found = inspect_flight(table)
    return list(zip(found.channel, found.kind, strict=True))


def held(table, channel, first, last):
    """Return the table with one channel's value repeated at rows first + 1 to last."""
    table = table.copy()
    table.loc[first:last, channel] = table.loc[first, channel]
    return table


def test_a_channel_that_is_stuck_again_and_again_is_one_line_with_its_worst():
    table = held(held(held(log(), "alpha", 400, 480), "alpha", 800, 950), "alpha", 1500, 1560)
    match = r"sortie: 3 times, the longest: alpha is stuck at .* \(20.025 to 23.75 s, 150 samples\)"
    with pytest.warns(FlightDataWarning, match=match):
        FlightCheck().fit_transform(table)


class TestCleanLogs:
    def test_a_pilot_who_holds_the_stick_is_no_fault(self):
        assert faults(log()) == []

    def test_a_sensor_slower_than_the_table_is_not_stuck(self):
        table = log()
        for channel in ("v_north", "v_east", "v_down"):
            table[channel] = table[channel][::8].reindex(table.index).ffill()
        assert faults(table) == []
        table["v_north"] = table["v_north"][::8].reindex(table.index)
        assert faults(table) == []

    @pytest.mark.parametrize("quantum", [0.01, 0.1, 1.0])
    def test_a_coarse_sensor_is_not_stuck(self, quantum):
        table = log()
        assert faults(table.assign(airspeed=quantum * (table.airspeed / quantum).round())) == []

    def test_a_channel_without_noise_is_not_stuck_at_its_extremes(self):
        table = log()
        assert (
            faults(table.assign(airspeed=(30 + np.sin(0.1 * table.time)).astype(np.float32))) == []
        )

    def test_a_filtered_heading_on_a_grid_is_not_stuck_where_it_turns_back(self):
        table = log()
        turns = np.abs(np.cos(0.4 * table.time)) < 0.2
        noise = np.convolve(default_rng(0).normal(size=len(table)), np.ones(5) / 5, "same")
        heading = 0.3 + 0.02 * np.sin(0.4 * table.time) + 0.002 * noise * ~turns
        assert faults(table.assign(psi=1e-4 * (heading / 1e-4).round())) == []

    def test_degrees_are_left_to_those_who_name_the_unit(self):
        assert faults(log().assign(alpha=np.rad2deg(log().alpha))) == []

    def test_the_example_flights_have_none(self):
        flights = load_example_flights()
        assert faults(flights.train) == faults(flights.test) == []

    def test_the_shared_flights_have_none(self, shared_data):
        paths = sorted(
            [
                *(shared_data / "flights").glob("*.parquet"),
                *(shared_data / "ampyx_ap2").glob("*.parquet"),
            ]
        )
        assert len(paths) == 6
        for path in paths:
            assert faults(pd.read_parquet(path)) == [], path.name


def spoilt(channel, rows, value):
    def spoil(table):
        table = table.copy()
        table.loc[rows, channel] = value
        return table

    return spoil


FAULTS = [
    ("alpha", "stuck", lambda t: held(t, "alpha", 400, 480), range(401, 481)),
    ("airspeed", "stuck", lambda t: held(t, "airspeed", 2000, 2399), range(2001, 2400)),
    ("q", "stuck", lambda t: held(t, "q", 700, 716), range(701, 717)),
    ("alpha", "impossible", spoilt("alpha", [500, 501], -999.0), [500, 501]),
    ("throttle", "impossible", spoilt("throttle", [500], 1e30), [500]),
    ("q", "spike", spoilt("q", [900, 901], 7.0), [900, 901]),
    ("beta", "missing", spoilt("beta", range(1000, 1100), np.nan), range(1000, 1100)),
]


@pytest.mark.parametrize(
    ("channel", "kind", "spoil", "rows"), FAULTS, ids=[f"{c}-{k}" for c, k, *_ in FAULTS]
)
class TestFaults:
    def test_is_found_with_its_seconds_and_nothing_else(self, channel, kind, spoil, rows):
        found = inspect_flight(spoil(log()))
        assert found[["flight", "channel", "kind", "n_samples"]].values.tolist() == [
            ["sortie", channel, kind, len(rows)]
        ]
        assert_allclose(found[["start", "end"]].to_numpy()[0], [STEP * rows[0], STEP * rows[-1]])

    def test_is_taken_out_and_told_once(self, channel, kind, spoil, rows):
        clean, table = log(), spoil(log())
        with pytest.warns(
            FlightDataWarning, match=f"flight sortie: {channel} .* to .* s, {len(rows)} samples"
        ) as said:
            FlightCheck().fit_transform(table)
        assert len(said) == 1
        out = without_faults(table, find_faults(table))
        gone = np.zeros(len(table), bool)
        gone[list(rows)] = True
        assert out[channel].isna().to_numpy().tolist() == gone.tolist()
        assert_frame_equal(out[~gone], clean[~gone])


def test_a_slow_sensor_that_sticks_is_found():
    table = log()
    table["v_north"] = table["v_north"][::8].reindex(table.index).ffill()
    assert faults(held(table, "v_north", 800, 1000)) == [("v_north", "stuck")]


def test_a_dead_sensor_among_living_ones():
    assert faults(log().assign(ay=0.0)) == [("ay", "constant")]
    assert faults(log().assign(ax=0.0, ay=0.0, az=-9.8)) == []  # a simulation may be so


class TestBridging:
    def test_short_gaps_are_interpolated_and_long_ones_stay(self):
        table = log()
        table.loc[500:507, "alpha"] = np.nan  # 9 steps between the samples around: 0.225 s
        table.loc[900:909, "alpha"] = np.nan  # 0.275 s
        with pytest.warns(FlightDataWarning, match="alpha has no value 2 times"):
            out = FlightCheck().fit_transform(table)
        assert out.index[out.alpha.isna()].tolist() == list(range(900, 910))
        line = np.interp(table.time[500:508], table.time[[499, 508]], table.alpha[[499, 508]])
        assert_allclose(out.alpha[500:508], line)

    def test_not_across_a_gap_in_time_nor_into_another_flight(self):
        table = pd.concat([log(), log(seed=1, name="next")], ignore_index=True)
        table.loc[[2399, 2400], "alpha"] = np.nan
        with pytest.warns(FlightDataWarning):
            out = FlightCheck().fit_transform(table)
        assert out.alpha.isna().sum() == 2


class TestClock:
    def test_rows_in_disorder_are_refused(self, tmp_path):
        table = log().sample(frac=1.0, random_state=0)
        with pytest.raises(ValueError, match="expected time to increase strictly within a flight"):
            FlightCheck().fit(table)
        table.to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(FlightReadError, match="sort by time"):
            read_flight(tmp_path / "a.csv")

    def test_a_jump_forward_is_listed_and_silent(self):
        table = log()
        table.loc[1000:, "time"] += 5.0
        assert faults(table) == [("time", "gap")]
        assert_frame_equal(FlightCheck().fit_transform(table), table)


class TestDownstream:
    steps = make_pipeline(
        FlightCheck(), FlightSmoother(cutoff=4.0), RegressorSelector(["alpha", "q", "elevator"])
    )

    def test_what_is_bridged_is_regressed_on(self):
        table = spoilt("alpha", [700, 701], -999.0)(log())
        with pytest.warns(FlightDataWarning, match="alpha has impossible values, such as -999"):
            assert self.steps.fit_transform(table).alpha.abs().max() < 0.2

    def test_what_is_not_is_refused_with_a_remedy_that_works(self):
        table = held(log(), "alpha", 700, 800)
        with (
            pytest.warns(FlightDataWarning),
            pytest.raises(
                ValueError, match=r"100 of 2400 rows .*'alpha': 100.*as FlightCheck gives it"
            ),
        ):
            self.steps.fit_transform(table)
        with pytest.warns(FlightDataWarning):
            table = FlightCheck().fit_transform(table)
        assert len(self.steps.fit_transform(table[np.isfinite(table.alpha)])) == 2300

    def test_targets_are_not_observed_where_sensors_were_faulty(self):
        table = log()
        expected = aerodynamic_coefficients(table, GLIDER, thrust=None)
        with pytest.warns(
            FlightDataWarning, match=r"q is stuck .* coefficients are not known there"
        ):
            Y = aerodynamic_coefficients(held(table, "q", 700, 800), GLIDER, thrust=None)
        assert Y.index[Y.isna().any(axis=1)].tolist() == list(range(701, 801))
        far = np.abs(np.arange(len(table)) - 750) > 400
        assert_allclose(Y[far], expected[far], atol=0.01 * expected.std().max())
        assert (
            aerodynamic_coefficients(held(table, "q", 700, 800), GLIDER, thrust=None, ignore=["q"])
            .notna()
            .all(axis=None)
        )

    def test_identify_warns_of_them_and_leaves_their_rows_out(self):
        with (
            pytest.warns(FlightDataWarning, match="alpha is stuck"),
            pytest.warns(UserWarning, match="12 of 2400 rows are left out"),
        ):
            flights = usable_flights(
                {"sortie": held(log(), "alpha", 700, 712)}, ["alpha"], ["alpha"]
            )
        assert len(flights["sortie"]) == 2388

    def test_single_lost_samples_leave_no_rows_out(self):
        """3 % of the cells of each channel are missing, one sample at a time."""
        table, rng = log(), default_rng(0)
        sparse = table.copy()
        for name in sparse.columns.difference(["time", "flight"]):
            lost = rng.choice(np.arange(1, len(table) - 1, 3), len(table) // 33, replace=False)
            sparse.loc[lost, name] = np.nan
        with pytest.warns(FlightDataWarning, match="gaps up to 0.25 s are interpolated"):
            found = usable_flights({"sortie": sparse}, ["alpha", "q"], ["alpha", "q"])["sortie"]
        assert len(found) == len(table)
        assert found.notna().all(axis=None)

    def test_a_coarse_resolution_in_steady_flight_is_not_stuck(self):
        """Airspeed rounded to 0.01 m/s, slow and almost without noise, interpolated to another clock."""
        time = np.arange(0, 60, 0.02)
        slow = np.arange(0, 60, 0.05)
        speed = 24.98 + 0.02 * np.sin(0.2 * slow) + 3 * np.exp(-slow / 4)
        airspeed = np.interp(time, slow, np.round(speed, 2))
        assert inspect_flight(pd.DataFrame({"time": time, "airspeed": airspeed})).empty
        airspeed[150:250] = airspeed[150]
        found = inspect_flight(pd.DataFrame({"time": time, "airspeed": airspeed}))
        assert found.kind.tolist() == ["stuck"]

    def test_dropouts_to_the_same_value_are_found_each_time(self):
        table = log()
        for start in (400, 900, 1500):
            table.loc[start : start + 60, "airspeed"] = 25.0
        assert faults(table) == [("airspeed", "stuck")] * 3


class TestWhatCannotBeLearned:
    def test_regressors_that_never_moved_are_named(self):
        table = log().assign(rudder=0.01)
        targets = np.where(
            table.time < 0.9, 1.0, np.nan
        )  # the elevator is still where there are targets
        with pytest.warns(
            FlightDataWarning, match=r"\['elevator', 'rudder'\] never change.*cannot learn"
        ):
            RegressorSelector(["alpha", "elevator", "rudder"]).fit(table, targets)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            RegressorSelector(["alpha", "rudder"]).fit(table)  # without targets nothing is learned

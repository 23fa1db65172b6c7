"""Faults of logs: each is found, named and taken out, and nothing else is."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import VELOCITY
from log_errors import held as sampled
from made_flights import GLIDER, make_flight, wrapped
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal

from skdgp.dynamics import aerodynamic_coefficients
from skdgp.preprocessing import FlightCheck, FlightDataWarning, inspect_flight

STEP = 0.025
# Mean, deviation of a slow wave, and noise
LEVELS = {
    "airspeed": (30, 2, 0.3), "alpha": (0.06, 0.03, 0.005), "beta": (0, 0.03, 0.005), "p q r": (0, 0.2, 0.002),
    "ax ay": (0, 1, 0.05), "az": (-9.8, 2, 0.05), "v_north v_east v_down": (10, 5, 0.1),
}  # fmt: skip


def log(seed=0, name="sortie"):
    """Return a flight of a minute of noisy sensors and a pilot's controls."""
    table = make_flight(LEVELS, seed=seed)
    elevator = np.where(table["time"] % 10 < 1, 0.1, 0.0)
    return table.assign(flight=name, density=1.2, elevator=elevator, throttle=0.6)


def faults(table, *more):
    """Return channel and kind of each fault of a table, and more columns."""
    return inspect_flight(table)[["channel", "kind", *more]].values.tolist()


def checked(table, words=None):
    """Return a flight without its faults, of which a warning tells."""
    with pytest.warns(FlightDataWarning, match=words):
        return FlightCheck().fit_transform(table)


def spoilt(channel, rows, value, table=None):
    """Return a flight with other values at some rows of a channel."""
    table = log() if table is None else table.copy()
    table.loc[rows, channel] = value
    return table


def held(channel, first, last, table=None):
    """Return a flight with one channel's value repeated at rows first + 1 to last."""
    table = log() if table is None else table
    return spoilt(channel, slice(first, last), table.loc[first, channel], table)


class TestCleanLogs:
    def test_a_sensor_slower_than_the_table_is_not_stuck(self):
        table = sampled(log(), VELOCITY, 8)
        assert faults(table) == []
        assert faults(table.assign(v_north=table["v_north"][::8].reindex(table.index))) == []
        assert faults(held("v_north", 800, 1000, table)) == [["v_north", "stuck"]]

    @pytest.mark.parametrize("quantum", [0.01, 0.1, 1.0])
    def test_a_coarse_sensor_is_not_stuck(self, quantum):
        table = log()
        assert faults(table.assign(airspeed=quantum * (table.airspeed / quantum).round())) == []

    def test_a_filtered_heading_on_a_grid_is_not_stuck_where_it_turns_back(self):
        table = log()
        turns = np.abs(np.cos(0.4 * table.time)) < 0.2
        noise = np.convolve(default_rng(0).normal(size=len(table)), np.ones(5) / 5, "same")
        heading = 0.3 + 0.02 * np.sin(0.4 * table.time) + 0.002 * noise * ~turns
        assert faults(table.assign(psi=1e-4 * (heading / 1e-4).round())) == []

    def test_the_example_flights_have_none(self, first_minute):
        flights = first_minute()
        assert faults(flights.train) == faults(flights.test) == []

    def test_a_pilot_who_holds_the_stick_and_degrees_are_no_fault(self):
        """Degrees are left to those who name the unit."""
        table = log()
        assert faults(table) == []
        assert faults(table.assign(alpha=np.rad2deg(table.alpha))) == []

    def test_a_channel_without_noise_is_not_stuck_at_its_extremes(self):
        table = log()
        assert faults(table.assign(airspeed=np.float32(30 + np.sin(0.1 * table.time)))) == []

    def test_a_coarse_resolution_in_steady_flight_is_not_stuck(self):
        """Airspeed rounded to 0.01 m/s, slow and almost without noise, interpolated to another clock."""
        time = np.arange(0, 60, 0.02)
        slow = np.arange(0, 60, 0.05)
        speed = 24.98 + 0.02 * np.sin(0.2 * slow) + 3 * np.exp(-slow / 4)
        table = pd.DataFrame({"time": time, "airspeed": np.interp(time, slow, speed.round(2))})
        assert faults(table) == []
        assert faults(held("airspeed", 150, 249, table)) == [["airspeed", "stuck"]]

    def test_a_velocity_of_a_simulator_is_not_stuck_where_it_stays(self):
        """Exactly along a heading until a turn; centimetres in single precision, interpolated to another clock."""
        time = np.arange(0, 80, 0.0523)
        clock = np.arange(0, 80, 0.053)
        velocity = np.interp(clock, [0, 10, 20, 35, 40, 80], [0, 0, -12, -12.8, -24, -22.0])
        is_turn = (np.abs(clock - 15) < 5) | (np.abs(clock - 37.5) < 2.5)
        velocity += 0.2 * np.sin(10 * clock) * is_turn
        velocity = np.interp(time, clock, velocity.round(2).astype(np.float32))
        table = pd.DataFrame({"time": time, "v_north": velocity})
        assert faults(table) == []
        assert faults(held("v_north", 250, 280, table)) == [["v_north", "stuck"]]


FAULTS = [
    ("alpha", "stuck", held("alpha", 400, 480), range(401, 481)),
    ("airspeed", "stuck", held("airspeed", 2000, 2399), range(2001, 2400)),
    ("q", "stuck", held("q", 700, 716), range(701, 717)),
    ("alpha", "impossible", spoilt("alpha", [500, 501], -999.0), [500, 501]),
    ("throttle", "impossible", spoilt("throttle", [500], 1e30), [500]),
    ("q", "spike", spoilt("q", [900, 901], 7.0), [900, 901]),
    ("beta", "missing", spoilt("beta", range(1000, 1100), np.nan), range(1000, 1100)),
]


@pytest.mark.parametrize(
    ("channel", "kind", "table", "rows"), FAULTS, ids=[f"{c}-{k}" for c, k, *_ in FAULTS]
)
def test_a_fault_is_found_with_its_seconds_told_once_and_taken_out(channel, kind, table, rows):
    found = inspect_flight(table)
    assert found[["flight", "channel", "kind", "n_samples"]].values.tolist() == [
        ["sortie", channel, kind, len(rows)]
    ]
    assert_allclose(found[["start", "end"]], [[STEP * rows[0], STEP * rows[-1]]])
    words = f"flight sortie: {channel} .* to .* s, {len(rows)} samples"
    with pytest.warns(FlightDataWarning, match=words) as said:
        out = FlightCheck().fit_transform(table)
    assert len(said) == 1
    clean = log()
    rows = [*rows]
    line = np.interp(clean.time, np.delete(clean.time, rows), np.delete(clean[channel], rows))
    expected = np.nan if len(rows) > 10 else line[rows]  # short gaps are bridged
    assert_frame_equal(out, spoilt(channel, rows, expected))


@pytest.mark.parametrize(
    ("channel", "possible", "impossible"),
    [
        ("airspeed", 999.0, 1001.0),
        ("airspeed", -9.9, -10.1),
        ("alpha", 3.19, 3.2),  # half a turn, with noise
        ("beta", -1.62, -1.63),
        ("q", -49.0, -51.0),
        ("ax", -999.0, -1001.0),
        ("v_north", -1499.0, -1501.0),
        ("north", -9.9e6, -10.1e6),
        ("density", 0.0011, 0.0009),
        ("density", 2.99, 3.01),
        ("altitude", -999.0, -1001.0),
        ("altitude", 9.9e4, 10.1e4),
        ("throttle", -0.09, -0.11),
        ("throttle", 2.09, 2.11),  # an afterburner has more than 1
        ("propeller_speed", -9.9e3, -10.1e3),
        ("propeller_speed", 9.9e3, 10.1e3),
        ("rudder", -1.57, -1.58),  # a surface across the flow
    ],
)
def test_what_no_aircraft_has_is_impossible(channel, possible, impossible):
    table = log()
    table[channel] = table.get(channel, 0.0)
    fault = [channel, "impossible"]
    assert fault not in faults(spoilt(channel, [500], possible, table))
    assert fault in faults(spoilt(channel, [500], impossible, table))


@pytest.mark.parametrize(("n", "is_rare"), [(119, True), (131, False)])
def test_impossible_values_in_more_than_a_twentieth_are_of_another_unit(n, is_rare):
    assert (["throttle", "impossible"] in faults(spoilt("throttle", range(n), 99.0))) == is_rare


def test_channels_that_are_ignored_stay_as_they_are():
    table = spoilt("q", [900, 901], 7.0)
    assert inspect_flight(table, ignore=["q"]).empty
    assert_frame_equal(FlightCheck(ignore=["q"]).fit_transform(table), table)


def test_a_dead_sensor_among_living_ones():
    assert faults(log().assign(ay=0.0)) == [["ay", "constant"]]
    assert faults(log().assign(ax=0.0, ay=0.0, az=-9.8)) == []  # a simulation may be so


class TestBridging:
    def test_short_gaps_are_interpolated_and_long_ones_stay(self):
        """10 steps between the samples around, 0.25 s, and 0.275 s."""
        table = spoilt("alpha", [*range(500, 509), *range(900, 910)], np.nan)
        out = checked(table, r"alpha has no value in 2 gap\(s\)")
        assert out.index[out.alpha.isna()].tolist() == list(range(900, 910))
        line = np.interp(table.time[500:509], table.time[[499, 509]], table.alpha[[499, 509]])
        assert_allclose(out.alpha[500:509], line)

    def test_a_heading_is_bridged_the_short_way_round_south(self):
        table = log()
        table["psi"] = wrapped(3.0 + 0.02 * table["time"])
        out = checked(spoilt("psi", range(281, 286), np.nan, table))
        assert_allclose(np.exp(1j * out["psi"]), np.exp(1j * table["psi"]), atol=1e-9)

    def test_infinite_headings_are_missing(self):
        table = log()
        table["psi"] = 0.1 * np.cos(table["time"])
        wrong = spoilt("psi", range(800, 900), -np.inf, spoilt("psi", [281], np.inf, table))
        assert_allclose(
            checked(wrong)["psi"], spoilt("psi", range(800, 900), np.nan, table)["psi"], atol=1e-4
        )

    def test_not_across_a_gap_in_time_nor_into_another_flight(self):
        both = pd.concat([log(), log(seed=1, name="next")], ignore_index=True)
        out = checked(spoilt("alpha", [2399, 2400], np.nan, both))
        assert out.alpha.isna().sum() == 2


class TestClock:
    @pytest.mark.parametrize(("steps", "found"), [(2.4, []), (2.6, [["time", "gap"]])])
    def test_a_jump_forward_is_listed_and_silent(self, steps, found):
        """By more than 2.5 steps."""
        table = log()
        table.loc[1000:, "time"] += (steps - 1) * STEP
        assert faults(table) == found
        assert_frame_equal(FlightCheck().fit_transform(table), table)


def test_targets_are_not_observed_where_sensors_were_faulty():
    expected = aerodynamic_coefficients(log(), GLIDER, thrust=None)
    stuck = held("q", 700, 800)
    with pytest.warns(FlightDataWarning, match="q is stuck .* coefficients are not known there"):
        Y = aerodynamic_coefficients(stuck, GLIDER, thrust=None)
    assert Y.index[Y.isna().any(axis=1)].tolist() == list(range(701, 801))
    far = np.abs(np.arange(len(Y)) - 750) > 400
    assert_allclose(Y[far], expected[far], atol=0.01 * expected.std().max())
    assert aerodynamic_coefficients(stuck, GLIDER, thrust=None, ignore=["q"]).notna().all(axis=None)


def attitude_of(table):
    """Return a flight with the attitude that its gyros give, wings about level."""
    angles = {}
    for name, rate in {"phi": "p", "theta": "q", "psi": "r"}.items():
        angles[name] = STEP * np.cumsum(table[rate] - table[rate].mean())
    return table.assign(**angles)


def test_an_attitude_that_jumps_without_the_gyros_is_told():
    """An estimator was reset; the values after it are measured all the same."""
    table = attitude_of(log())
    assert ["theta", "jump"] not in faults(table)
    table.loc[1200:, "theta"] += 0.41
    assert ["theta", "jump"] in faults(table)
    assert_frame_equal(checked(table, "theta jumps by up to 0.4")[["theta"]], table[["theta"]])


def test_dead_sensors_by_what_cannot_move_without_them():
    assert faults(log().assign(airspeed=25.0)) == [["airspeed", "constant"]]
    turns = {"phi": np.sin(log().time), "theta": 0.0, "psi": 0.0}
    dead = log().assign(p=0.01, q=0.01, r=0.01)
    assert faults(dead) == []
    constant = [[name, "constant"] for name in ("p", "q", "r", "theta", "psi")]
    assert sorted(faults(dead.assign(**turns))) == sorted(constant)


@pytest.mark.parametrize(("channel", "length"), [("airspeed", 8), ("p", 1), ("alpha", 4)])
def test_zeros_in_place_of_missing_samples(channel, length):
    rows = np.concatenate([np.arange(k, k + length) for k in range(50, 2300, 70)])
    assert faults(spoilt(channel, rows, 0.0), "n_samples") == [[channel, "spike", len(rows)]]


@pytest.mark.parametrize("channel", ["p", "ax", "beta"])
def test_a_dead_band_and_a_limit_are_no_missing_samples(channel):
    values = log()[channel]
    band = 0.3 * values.std()
    for limited in (values.where(values.abs() > band, 0.0), values.clip(upper=band)):
        assert [channel, "spike"] not in faults(log().assign(**{channel: limited}))


@pytest.mark.parametrize("channel", ["az", "alpha"])
def test_a_sensor_that_is_cut_off_measures_nothing_there(channel):
    values = log()[channel]
    low, high = values.quantile([0.1, 0.95])
    found = faults(log().assign(**{channel: values.clip(low, high)}), "n_samples")
    assert found == [[channel, "clipped", 240], [channel, "clipped", 120]]


def test_a_bank_angle_that_is_held_is_not_cut_off():
    table = log()
    bank = np.abs(table["time"] % 8.0 - 4.0) / 2.0
    for channel in ("phi", "airspeed"):
        assert [channel, "clipped"] not in faults(table.assign(**{channel: bank.clip(upper=0.5)}))


def test_dropouts_to_the_same_value_are_found_each_time():
    table = log()
    for start in (400, 900, 1500):
        table.loc[start : start + 60, "airspeed"] = 25.0
    assert faults(table) == [["airspeed", "stuck"]] * 3


def test_a_turn_to_the_other_side_of_south_is_no_jump():
    table = attitude_of(log())
    heading = table["psi"] + np.linspace(0, 20, len(table))
    assert ["psi", "jump"] not in faults(table.assign(psi=wrapped(heading)))

"""Channels of a flight: their clock, samples that are repeated, the band of the motion, and flights that are copies."""

from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from flight_columns import EULER, FORCES, RATES
from log_errors import shake
from made_flights import make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import CubicSpline

from skdgp._flight.channels import by_elevons
from skdgp._flight.clock import uniform_grid, unrounded
from skdgp._flight.copies import without_copies
from skdgp._flight.findings import Code
from skdgp._flight.holds import (
    error_between_samples,
    find_holds,
    interpolated_rows,
)
from skdgp._flight.servo_functions import WEIGHTS, ServoFunction, ServoRange
from skdgp._flight.smoothing import band_limited, motion_band_of, vibrates_beyond
from skdgp._flight.tables import FlightTable
from skdgp.preprocessing import ElevonSplitter


def test_elevons_are_what_the_transformer_splits_them_into():
    elevons = make_flight({"elevon_left elevon_right": (0, 0.1, 0)}, 40)
    for name, values in by_elevons(elevons).items():
        assert_allclose(ElevonSplitter().fit_transform(elevons)[name], values)


@pytest.mark.parametrize(
    ("kind", "both", "apart", "sign"),
    [
        ("ELEVON", "elevator", "aileron", -1),
        ("VTAIL", "elevator", "rudder", 1),
        ("FLAPERON", "aileron", "flap", 1),
    ],
)
def test_outputs_of_ardupilot_give_back_the_commands_that_move_them(kind, both, apart, sign):
    """ArduPlane/servos.cpp, of commands up, right and down."""
    outputs = {"LEFT": 0.3 + sign * 0.2, "RIGHT": 0.3 - sign * 0.2}
    for control, command in ((both, 0.3), (apart, 0.2)):
        weights = WEIGHTS[control]
        found = sum(weights[ServoFunction[f"{kind}_{side}"]] * outputs[side] for side in outputs)
        assert_allclose(found, command)


def test_a_servo_of_one_control_has_all_of_it():
    for control in ("aileron", "elevator", "rudder", "throttle"):
        assert WEIGHTS[control][ServoFunction[control.upper()]] == 1.0


def test_a_servo_without_parameters_has_the_defaults_of_ardupilot():
    assert ServoRange.of({}, 1) == (1100.0, 1500.0, 1900.0, False)


def test_the_grid_of_uneven_samples_is_uniform():
    """Rounded times lie on it; beside a missed sample there is a place for it."""
    even = 7.0 + 0.02 * np.arange(40)
    for error in (3.6e-4, 4.2e-4):  # by a fiftieth of a step
        grid, is_off = uniform_grid(even + np.resize([error, -error, -error, error], 40))
        assert is_off == (error > 4e-4)
        assert_allclose(np.diff(grid), 0.02, atol=5e-5)
    grid, is_off = uniform_grid(np.delete(even, 13))
    assert is_off
    assert_allclose(grid, even)


@pytest.mark.parametrize("rate", [30.0, 40.0, 60.0, 128.0])
@pytest.mark.parametrize("resolution", [0.01, 2.0**-8])
@pytest.mark.parametrize("begin", [0.0, 20.3])
def test_rounded_times_are_put_on_their_clock(rate, resolution, begin):
    """As of 10 ms, or of seconds of the day as float32, where the step is no multiple of it.

    Halves are rounded to either side, by the error of a difference of times.
    """
    time = begin + np.arange(0.0, 120.0, 1 / rate) - begin
    rounded = resolution * np.round(time / resolution)
    restored, told = unrounded(rounded)
    is_multiple = np.ptp(np.diff(rounded)) < 1e-9
    assert (told == 0.0) == is_multiple
    assert np.ptp(restored - time) < 0.2 * resolution or is_multiple


def test_a_jittered_clock_stays_as_it_is():
    time = np.arange(0.0, 30.0, 0.025) + default_rng(0).uniform(0, 0.01, 1200)
    assert unrounded(time)[1] == 0.0
    assert unrounded(np.array([0.0, 0.03, 0.07]))[1] == 0.0
    changed = np.cumsum(np.repeat([0.02, 0.03], 600))
    assert unrounded(changed)[1] == 0.0


STEP, PERIOD, N = 0.02, 5, 2000  # 10 Hz in a log of 50 Hz
TIME = 30.0 + STEP * np.arange(N)


def test_a_held_channel_has_its_own_rate():
    """Its period is no multiple of the rows."""
    fresh = np.rint(np.arange(2, N, 2.45)).astype(int)
    rows = np.maximum(np.searchsorted(fresh, np.arange(N), side="right") - 1, 0)
    table = pd.DataFrame({"time": TIME, "elevator": np.sin(2.0 * TIME[fresh])[rows]})
    flights = FlightTable.of(table.assign(p=default_rng(0).normal(size=N)))
    (hold,) = find_holds(flights, [("elevator",), ("p",)])
    assert hold.names == ["elevator"]
    assert_allclose(hold.rate, 1 / (2.45 * STEP), rtol=0.01)
    assert not hold.repeated[fresh[4:-4]].any()


def test_error_of_the_curve_is_half_of_the_curvature_between_samples():
    """And a parabola: of a channel x^2, whose second differences are 2."""
    samples = np.arange(0, 41, 4)
    number = np.arange(41) / 4
    error = error_between_samples(TIME[:41], number**2, samples)
    expected = 1.0 - (2 * (number % 1) - 1) ** 2
    assert_allclose(error[8:-8], expected[8:-8], atol=1e-12)
    assert_allclose(error[samples], 0.0, atol=1e-12)


def test_a_channel_of_splines_shows_its_samples():
    knots = np.arange(1, N, PERIOD)
    values = default_rng(1).normal(size=len(knots))
    rows = np.arange(knots[0], knots[-1] + 1)
    curve = CubicSpline(TIME[knots], values)(TIME[rows])
    assert_array_equal(interpolated_rows(TIME[rows], curve), knots - knots[0])
    assert interpolated_rows(TIME, default_rng(2).normal(size=N)) is None


RATE = 40.0


def shaken(size):
    """Return motion below 4 Hz, with a vibration of the rates whose frequency changes, 8 to 14 Hz."""
    table = make_flight({"p q r elevator": (0, 1, 0)}, 4800, 1 / RATE, width=4, seed=2)
    for name in RATES:
        table[name] += size * shake(table["time"])
    return table


@pytest.mark.parametrize(("vibration", "noise"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
def test_vibration_of_the_rates_and_noise_of_the_surfaces_do_not_widen_it(vibration, noise):
    table = shaken(vibration)
    table["elevator"] += noise * default_rng(0).normal(size=len(table))
    assert 1.5 < motion_band_of(table) < 5.0


def test_forces_beyond_it_are_vibration():
    table = shaken(1.0)
    rng = default_rng(1)
    band = motion_band_of(table)
    for name in FORCES:
        table[name] = table["elevator"] + 0.5 * rng.normal(size=len(table))
    assert not vibrates_beyond(table, band)
    shaking = table["p"] - shaken(0.0)["p"]
    table["ax"] += 3 * shaking
    assert not vibrates_beyond(table, band)
    table["az"] += 3 * shaking
    assert vibrates_beyond(table, band)


def test_a_wave_beyond_it_is_removed_and_one_within_it_is_kept():
    time = np.arange(4800) / RATE
    waves = np.sin(2 * np.pi * np.outer(time, [2.0, 12.0]))
    out = band_limited(waves, pd.DataFrame({"time": time}), 5.0)
    middle = slice(200, -200)
    assert_allclose(out[middle], waves[middle] * [1.0, 0.0], atol=0.01)


def test_without_rates_and_surfaces_it_is_unknown():
    assert motion_band_of(shaken(0.0)[["time"]].assign(alpha=0.1)) == np.inf
    assert motion_band_of(shaken(0.0).iloc[:60]) == np.inf


SENSORS = [*RATES, *FORCES, *EULER]
ANGLES = {"elevator": "theta", "aileron": "phi", "rudder": "psi"}


@pytest.fixture
def doublets():
    """Return flights about one trim, by the surface whose doublet at 2 s decays in one angle."""
    time = np.arange(0.0, 20.0, 0.02)
    since = np.clip(time - 2.0, 0.0, None)
    response = 0.15 * np.exp(-since / 2.0) * np.sin(2.0 * since)
    flights = {}
    for seed, (surface, angle) in enumerate(ANGLES.items()):
        noise = default_rng(seed).normal(0.0, 0.001, (len(time), len(SENSORS)))
        table = pd.DataFrame(noise, columns=SENSORS).assign(time=time)
        table[angle] += response
        flights[surface] = table
    return flights


def test_another_flight_on_the_same_course_is_no_copy(doublets):
    flights = {}
    for name, phase in {"first": 0.0, "second": np.pi / 2}.items():
        table = doublets["rudder"]
        phi = 0.03 * np.sin(1.5 * table["time"] + phase)
        table = table.assign(phi=phi, psi=0.1 * table["time"])
        table[SENSORS] += default_rng(len(name)).normal(0.0, 0.001, (len(table), len(SENSORS)))
        flights[name] = FlightTable.of(table)
    kept, *_ = without_copies(flights, {})
    assert {*kept} == {*flights}


@pytest.mark.parametrize("name", ANGLES)
def test_telemetry_of_a_doublet_is_a_copy(doublets, name):
    sent = doublets[name].iloc[3::10].reset_index(drop=True)
    sent[SENSORS] += default_rng(3).normal(0.0, 0.001, (len(sent), len(SENSORS)))
    flights = {surface: FlightTable.of(flight) for surface, flight in doublets.items()}
    kept, _, (copy,) = without_copies(flights | {"sent": FlightTable.of(sent)}, {})
    assert {*kept} == {*flights}
    assert (copy.code, copy.flight, copy.numbers) == (Code.FLIGHT_TWICE, "sent", {"other": name})


def with_another_recorder(table):
    """Return a flight, and the same with noise of its own."""
    noise = default_rng(3).normal(0.0, 0.001, (len(table), len(SENSORS)))
    again = table.assign(**(table[SENSORS] + noise))
    return {"log": FlightTable.of(table), "again": FlightTable.of(again)}


@pytest.mark.parametrize(("n", "attitude"), [(12, 0.1), (1000, np.nan)])
def test_flights_too_short_or_without_attitude_are_judged_by_their_rows_alone(
    doublets, n, attitude
):
    table = doublets["elevator"][:n].copy()
    table.loc[1:, "phi"] = attitude
    kept, *_ = without_copies(with_another_recorder(table), {})
    assert [*kept] == ["log", "again"]


CHAINS = {
    "a log and its halves": ([(0, 1000), (0, 550), (450, 1000)], ["0"]),
    "halves and their log": ([(0, 550), (450, 1000), (0, 1000)], ["2"]),
    "each overlaps the next": ([(0, 500), (200, 700), (400, 900)], ["0", "2"]),
    "three of one": ([(0, 500), (0, 500), (0, 500)], ["0"]),
    **{
        f"an excerpt of an excerpt, {ranges}": (ranges, [str(ranges.index((0, 1000)))])
        for ranges in permutations([(0, 1000), (0, 300), (0, 450)])
    },
}


@pytest.mark.parametrize(("ranges", "kept"), CHAINS.values(), ids=CHAINS)
def test_of_a_chain_of_copies_the_longest_is_kept(ranges, kept, doublets):
    table = doublets["elevator"]
    flights = {}
    for name, (begin, end) in enumerate(ranges):
        flights[str(name)] = FlightTable.of(table.iloc[begin:end].reset_index(drop=True))
    found, _, copies = without_copies(flights, {})
    assert [*found] == kept
    assert {copy.flight for copy in copies} == {*flights} - {*kept}


@pytest.mark.parametrize(
    ("names", "kept", "code"),
    [
        (["elevator", "rudder"], ["rudder"], Code.COPY_LEFT_OUT),
        (["elevator"], ["elevator"], Code.TESTED_ON_COPY),
    ],
)
def test_of_test_flights_copies_are_left_out_where_others_stay(names, kept, code, doublets):
    flights = {name: FlightTable.of(table) for name, table in doublets.items()}
    train = {"first": flights["elevator"]}
    _, tests, (copy,) = without_copies(train, {name: flights[name] for name in names})
    assert [*tests] == kept
    assert (copy.code, copy.flight, copy.numbers) == (code, "elevator", {"other": "first"})

"""Laws of physics: faults of channels are found, sound flights break none."""

import re
from dataclasses import replace
from functools import partial

import log_errors
import numpy as np
import pandas as pd
import pytest
import uav_flight
from flight_columns import EULER, FORCES, RATES, SURFACES, VELOCITY
from log_errors import exchange, scale, with_channels, without
from made_flights import flight_of_motion, lasting, wrapped
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy import signal
from scipy.spatial.transform import Rotation

from skdgp._flight.findings import Code
from skdgp._flight.physics import (
    Regression,
    confirmed_channels,
    estimated_slope,
    find_contradictions,
)
from skdgp._flight.physics._equations import thrust
from skdgp._flight.physics._laws import EQUAL
from skdgp._flight.physics._list import ALPHA, OFFSETS, PITCH
from skdgp._flight.physics._signals import Signals, signals_of
from skdgp._flight.tables import FlightTable
from skdgp.datasets import load_example_flights
from skdgp.design import doublet
from skdgp.dynamics import (
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
    simulate,
    trim,
)
from skdgp.io import inspect_log, read_flight

ELEVONS = ["elevon_left", "elevon_right"]
VANES = ["alpha", "beta"]
PLACE = ["north", "east", "altitude"]
DEGREES = 180 / np.pi
GRAVITY = 9.80665
FOOT = 0.3048
AHEAD = (1.8, 0.0, 0.0)  # of the centre of gravity [m]


@pytest.fixture(scope="module")
def flights(first_minute):
    """Return minutes of several flights by name, all controls moving in ``latlon``."""
    train = first_minute().train
    return {name: table.reset_index(drop=True) for name, table in train.groupby("flight")}


@pytest.fixture
def flight(flights):
    return flights["latlon"]


def contradictions(table):
    return find_contradictions(FlightTable.of(table))


def named(findings):
    """Return the channels of each finding, in alphabetical order."""
    return {" ".join(sorted(finding.numbers["channels"])) for finding in findings}


def channels_of(table):
    return {*" ".join(named(contradictions(table))).split()}


# What is done to a flight


def turn(names):
    return scale({names: -1.0})


def late(seconds, *names):
    return lambda flight: log_errors.late(flight, seconds, names)


def replaced(**channels):
    """Replace channels by functions of the flight."""
    return lambda flight: flight.assign(**channels)


def then(*changes):
    """Change a flight in steps."""

    def change(flight):
        for step in changes:
            flight = step(flight)
        return flight

    return change


def from_part(begin, name, change):
    """Change a channel after a part of the flight."""

    def changed(flight):
        values = flight[name].to_numpy()
        first = round(begin * len(values))
        return flight.assign(**{name: np.r_[values[:first], change(values[first:])]})

    return changed


from_half = partial(from_part, 0.5)


def blocked(later):
    """Return an airspeed that is the noise of its sensor alone."""
    return later[0] + default_rng(0).normal(0, 0.3, len(later))


def mix(names, matrix):
    """Make channels of combinations of the elevons."""
    return lambda flight: with_channels(flight, names, flight[ELEVONS] @ np.transpose(matrix))


def held(rates):
    """Sample and hold channels of a flight of 40 Hz at rates [Hz]."""

    def hold(flight):
        for names, rate in rates.items():
            flight = log_errors.held(flight, names.split(), 40 // rate)
        return flight

    return hold


def vibrating(flight):
    """Add an engine's vibration: accelerometers by 3 m/s^2, gyros by 0.15 rad/s."""
    noise = default_rng(0).normal(size=(6, len(flight))) / 3
    wave = np.sin(2 * np.pi * 63 * flight["time"].to_numpy())
    shaken = flight.copy()
    shaken[FORCES] += 3.0 * (wave + noise[:3]).T
    shaken[RATES] += 0.15 * (wave + noise[3:]).T
    return shaken


def to_earth(flight, vectors):
    """Return vectors (n, 3) in body axes north, east and down."""
    return body_to_ned(euler_to_quaternion(*(flight[name] for name in EULER)), vectors)


def in_earth_axes(west):
    """Log accelerations north, east or west, and down, as inertial navigation systems do."""

    def change(flight):
        force = to_earth(flight, flight[FORCES].to_numpy())
        return with_channels(flight, FORCES, force * [1.0, west, 1.0])

    return change


def ahead(flight):
    return log_errors.elsewhere(flight, AHEAD)


def heading(degrees):
    """Count the heading from another north."""
    return replaced(psi=lambda flight: wrapped(flight["psi"] + degrees / DEGREES))


def ordinary(flight):
    """Give a flight elevator and aileron, and no position."""
    mixed = mix(["elevator", "aileron"], [[0.5, 0.5], [0.5, -0.5]])
    return then(mixed, without(*ELEVONS, *PLACE))(flight)


EAST_NORTH = exchange("v_north", "v_east")
SWAP = [[0.0, 1.0], [1.0, 0.0]]

# Faults of one channel, the channels of each finding, and the first slope where its size is known
FAULTS = [
    (turn("alpha"), "alpha", None),
    (turn("az"), "az", -1),
    (turn("altitude"), "altitude", -1),
    (then(turn("v_down"), without("altitude")), "v_down", -1),
    (turn("ax"), "ax", None),
    (turn("thrust_x"), "ax thrust_x", None),
    (turn("psi"), "psi r", None),
    (turn("q r"), "q, r", None),
    (turn("theta psi"), "q theta", None),
    (turn("v_east v_down"), "east v_east, v_down", -1),
    (turn("elevon_left elevon_right"), "elevon_left elevon_right", None),
    (mix(ELEVONS, SWAP), "elevon_left elevon_right", None),
    (scale({"alpha": DEGREES, "p rudder": -1}), "alpha, p, rudder", None),
    (scale({"beta": 0.5}), "beta", 0.5),
    (scale({"p": 1.25}), "p", 0.8),
    (scale({"psi": DEGREES}), "psi", None),
    (scale({"phi theta psi": DEGREES}), "p phi", DEGREES),
    (scale({"p q r": DEGREES}), "p, q theta", None),
    (scale({"ax ay az": 1 / GRAVITY}), "az", 1 / GRAVITY),
    (scale({"airspeed": 1 / 0.514444}), "airspeed", 0.514444),
    (scale({"altitude": 1 / FOOT}), "altitude", 1 / FOOT),
    (replaced(alpha=lambda flight: flight["alpha"] + 0.087), "alpha", 0.087),
    (heading(15.0), "psi", -0.259),
    (replaced(psi=lambda flight: np.pi / 2 - flight["psi"]), "psi r", None),
    (log_errors.without_gravity, "az", None),
    (then(without(*VANES), turn("rudder")), "rudder", None),
    (then(ahead, without(*VANES), turn("rudder")), "rudder", None),
]


@pytest.mark.parametrize(("change", "channels", "slope"), FAULTS)
def test_a_fault_is_found_in_its_channel(flight, change, channels, slope):
    found = contradictions(change(flight))
    assert named(found) == {*channels.split(", ")}
    assert all(abs(finding.numbers["t"]) > 5 for finding in found)
    assert slope is None or found[0].numbers["slope"] == pytest.approx(slope, rel=0.1)


def test_a_magnetic_heading_hides_no_other_fault(flight):
    assert "ay" in channels_of(then(heading(15.0), turn("ay"))(flight))


@pytest.mark.parametrize("west", [1.0, -1.0])
def test_accelerometers_in_earth_axes_are_accused(flight, west):
    accused = channels_of(in_earth_axes(west)(flight))
    assert accused & {"ax", "ay"}
    assert accused <= {*FORCES}


# Faults of an ordinary flight that are one finding, and its numbers
FOUND = [
    (
        from_half("aileron", lambda later: 0 * later + later[0]),
        {"percent": pytest.approx(50, abs=3)},
    ),
    (from_half("airspeed", lambda later: 0.7 * later), {"slope": pytest.approx(-0.43, abs=0.05)}),
    (scale({"airspeed": 0.95}), {"slope": pytest.approx(1 / 0.95, rel=0.02)}),
    (scale({"airspeed": 1.1}), {"slope": pytest.approx(1 / 1.1, rel=0.02)}),
    (scale({"airspeed": 3.6}), {"causes": ["an airspeed in km/h"]}),
    (scale({"airspeed": 1 / 0.514444}), {"causes": ["an airspeed in kt"]}),
    (log_errors.without_gravity, {"causes": ["an acceleration without gravity"]}),
    (then(without(*VELOCITY), scale({"airspeed": 3.6})), {"channels": ["airspeed"]}),
    (from_half("airspeed", blocked), {"channels": ["airspeed"]}),
    (late(0.3, "alpha"), {"lag": pytest.approx(0.3), "channels": ["alpha"]}),
    (late(0.2, *RATES), {"lag": pytest.approx(0.2), "late": RATES}),
    (late(0.3, *SURFACES), {"lag": pytest.approx(0.3, abs=0.1), "late": SURFACES}),
    (late(1.0, *VELOCITY), {"lag": pytest.approx(1.0, abs=0.1), "late": VELOCITY}),
    (
        then(without(*VANES), late(1.0, *VELOCITY)),
        {"lag": pytest.approx(1.0, abs=0.1), "late": VELOCITY},
    ),
    (
        scale({"time": 0.8}),
        {"rate": pytest.approx(50.0, rel=0.01), "true_rate": pytest.approx(40.0, rel=0.02)},
    ),
    (replaced(alpha=lambda flight: flight["theta"]), {"channels": ["alpha"]}),
    (
        replaced(psi=lambda flight: np.arctan2(flight["v_east"], flight["v_north"])),
        {"channels": ["psi"]},
    ),
    (
        replaced(airspeed=lambda flight: np.hypot(flight["v_north"], flight["v_east"]).round(2)),
        {"channels": ["airspeed"]},
    ),
]


@pytest.mark.parametrize(("change", "numbers"), FOUND)
def test_a_fault_has_its_numbers(flight, change, numbers):
    (found,) = contradictions(change(ordinary(flight)))
    assert {name: found.numbers[name] for name in numbers} == numbers


def turning():
    """Return two minutes of turns in a steady wind, without positions."""
    time = np.arange(0.0, 120.0, 0.05)
    speed = 20.0 + 2.0 * np.sin(0.4 * time)
    psi = 0.1 * time
    log = {"v_north": 3.0 + speed * np.cos(psi), "v_east": speed * np.sin(psi), "psi": psi}
    log |= dict.fromkeys(["phi", "theta", "v_down"], 0.0 * time)
    noise = default_rng(1).normal(size=(7, len(time)))
    sound = pd.DataFrame(log) + 0.01 * noise[:6].T
    return sound.assign(time=time, airspeed=speed + 0.3 * noise[6])


@pytest.mark.parametrize("begin", [0.25, 0.75])
def test_a_pitot_tube_may_be_blocked_at_any_time(begin):
    sound = turning()
    assert contradictions(sound) == []
    (found,) = contradictions(from_part(begin, "airspeed", blocked)(sound))
    assert found.numbers["causes"] == ["a blocked pitot tube"]


@pytest.mark.parametrize("name", ELEVONS)
def test_one_turned_elevon_is_named(flight, name):
    (found,) = contradictions(turn(name)(flight))
    assert found.numbers["turned"] == [name]


@pytest.mark.parametrize(
    "pair",
    [
        "p and r",
        "q and r",
        "phi and theta",
        "ax and az",
        "v_north and v_east",
        "elevator and aileron",
        "aileron and rudder",
        "beta and alpha",
    ],
)
def test_exchanged_channels_are_named_as_such(flight, pair):
    (found,) = contradictions(then(without(*ELEVONS), exchange(*pair.split(" and ")))(flight))
    assert found.numbers["exchanged"] == [pair]


def test_velocities_are_exchanged_without_positions_too():
    (found,) = contradictions(EAST_NORTH(turning()))
    assert found.numbers["exchanged"] == ["v_north and v_east"]


def test_velocities_east_north_up_are_named_as_such(flight):
    (found,) = contradictions(then(EAST_NORTH, turn("v_down"))(flight))
    assert found.numbers["axes"] == "east, north, up"
    assert found.numbers["exchanged"] == ["v_north and v_east"]


def test_without_an_altitude_an_exchange_of_velocities_does_not_blame_the_third(flights):
    changed = then(without("altitude"), EAST_NORTH)(flights["lateral"])
    assert named(contradictions(changed)) == {"v_east v_north"}


@pytest.mark.parametrize(
    ("names", "dropped"),
    [
        *((names, dropped) for names in ("q theta", "p phi", "r psi") for dropped in ([], VANES)),
        ("q r ay az", VANES),
        ("q r ay az theta psi v_east v_down", VANES),
        ("q r ay az theta psi beta", []),
        ("q r ay az theta psi beta", VELOCITY),
        ("q r ay az theta psi", [*VANES, *VELOCITY]),
        ("q r ay az theta psi v_east v_down beta", []),
    ],
)
def test_channels_that_are_turned_together_are_one_mistake(flight, names, dropped):
    """A rate and its angle agree, but in turns q = psi_dot sin phi cos theta > 0; and axes forward, left, up."""
    (found,) = contradictions(turn(names)(ordinary(flight).drop(columns=dropped)))
    assert {*found.numbers["turned"]} == {*names.split()}


@pytest.mark.parametrize("factor", [-1.0, 0.1])
def test_impossible_factors_are_no_wrong_clock(flight, factor):
    kept = flight[["time", *RATES, *EULER, *VELOCITY, *FORCES]]
    found = contradictions(scale({"p q r v_north v_east v_down": factor})(kept))
    assert {finding.code for finding in found} == {Code.CONTRADICTION}


@pytest.mark.parametrize(
    ("name", "seconds", "explained", "channels"),
    [
        ("p", 0.8, 0.1, "phi p"),
        ("v_down", 0.8, 0.2, "altitude v_down"),
        ("altitude", 0.8, 0.2, "altitude v_down"),
        ("airspeed", 2.0, 0.3, "airspeed psi v_north v_east"),
        ("airspeed", 2.0, -0.3, "airspeed psi v_north v_east"),
    ],
)
def test_a_lag_is_found_beyond_what_corrections_holds_and_gusts_explain(
    flight, name, seconds, explained, channels
):
    found = contradictions(late(seconds, name)(flight))
    assert {*" ".join(named(found)).split()} <= {*channels.split()}
    assert_allclose(abs(found[0].numbers["lag"]), seconds, rtol=0.12)
    assert contradictions(late(explained, name)(flight)) == []


def test_a_vane_late_by_half_a_period_is_not_turned(flight):
    """At one frequency alone, 1 Hz, both look alike to the motion, and forces tell them apart."""
    band = signal.butter(2, (0.85, 1.15), "bandpass", fs=40.0, output="sos")
    moving = [*VANES, *RATES, "ay", "az", *EULER, "aileron", "rudder"]
    narrow = flight[["time", "airspeed"]].copy()
    narrow[moving] = 4 * signal.sosfiltfilt(band, np.unwrap(flight[moving], axis=0), axis=0)
    narrow["az"] -= GRAVITY
    assert contradictions(narrow) == []
    (found,) = contradictions(late(0.5, "beta")(narrow))
    assert found.numbers["channels"] == ["beta"]
    assert_allclose(found.numbers["lag"], 0.5)
    (found,) = contradictions(turn("beta")(narrow))
    assert found.numbers["is_turned"]


@pytest.mark.parametrize("name", ["ax", "ay"])
def test_one_accelerometer_in_g_is_named(flight, name):
    assert channels_of(scale({name: 1 / GRAVITY})(flight)) == {name}


def test_a_surface_that_moves_by_rounding_alone_is_not_accused(flight):
    """Its wrong sign would be sure."""
    rounding = flight.assign(rudder=1e-9 * flight["r"].diff().fillna(0.0))
    assert contradictions(rounding) == []


@pytest.mark.parametrize("rows", [4, 20])
def test_late_vanes_are_named_and_no_surface(flight, rows):
    """Of 0.1 s at most LagCorrector corrects in silence."""
    log = ordinary(flight).drop(columns=VELOCITY)
    log[VANES] = log[VANES].shift(rows)
    assert channels_of(log.iloc[rows:].reset_index(drop=True)) == ({*VANES} if rows > 4 else set())


def circling(rate, bank, updraft=0.0, late=0.0, heading=0.0):
    """Return two minutes of a glider that turns at a rate [rad/s] through gusts, or flies one heading at rate 0."""
    time = 0.05 * np.arange(2400)
    psi = heading + rate * time
    airspeed = 14.0 + 3.0 * np.sin(0.1 * time)
    noise = default_rng(0).normal(size=(3, len(time)))
    gust = 0.5 * signal.lfilter([0.05], [1, -0.95], noise)
    crosswind = np.sin(0.1 * time) if rate == 0 else 0.0
    north = airspeed * np.cos(psi) + 4.0 - 3.0 * np.sin(heading) * crosswind + gust[0]
    east = airspeed * np.sin(psi) - 2.0 + 3.0 * np.cos(heading) * crosswind + gust[1]
    table = {
        "time": time, "phi": bank, "theta": 0.0, "psi": psi, "airspeed": airspeed, "v_north": north,
        "v_east": east, "v_down": gust[2] - updraft,
    }  # fmt: skip
    return log_errors.late(pd.DataFrame(table), late, VELOCITY)


@pytest.mark.parametrize(
    "options",
    [
        {"rate": 0.5, "bank": 0.6, "late": 0.5},
        {"rate": 0.4, "bank": 0.7, "updraft": 4.0},
        {"rate": 0.0, "bank": 0.0, "heading": 1.0},
    ],
)
def test_late_velocity_updrafts_and_crosswinds_are_no_wrong_heading(options):
    assert "psi" not in channels_of(circling(**options))


def test_the_error_of_a_slope_counts_dependent_samples():
    """Over many pairs of unrelated series with memory, slopes vary as much as their standard deviations say."""
    rng = default_rng(0)
    scores = []
    sizes = []
    for _ in range(200):
        x, y = signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=(2, 2000)))
        slope = estimated_slope(Regression(y, x, [np.ones(2000)]))
        scores.append(slope.value / slope.std)
        sizes.append(slope.n_effective)
    assert_allclose(np.std(scores), 1.0, rtol=0, atol=0.2)
    # Bartlett: tau = (1 + rho^2) / (1 - rho^2)
    assert_allclose(np.mean(sizes), 2000 * 0.19 / 1.81, rtol=0.25)


@pytest.fixture(scope="module")
def held_in_pitch():
    """Return a minute in gusts without vanes, in which an autopilot answers theta and q by the elevator."""
    plane = uav_flight.AIRCRAFT["trainer"]
    flown = uav_flight.fly(plane, uav_flight.AIRS["1 m/s, 1 s"], default_rng(1), 60.0, 0.06)
    q = flown["q"] + 0.004 * default_rng(0).normal(size=len(flown))
    log = flown.assign(q=q, elevator=flown["elevator_command"])
    return log[["time", "airspeed", "q", "elevator"]]


@pytest.mark.parametrize(("sign", "accused"), [(1.0, []), (-1.0, ["elevator or q"])])
@pytest.mark.parametrize("hold", [1, 5])
def test_an_autopilot_that_answers_gusts_is_no_wrong_sign(
    hold, sign, accused, held_in_pitch, tmp_path
):
    """The elevator has the sign of the autopilot after the response, and its own before.

    ``hold`` rows at a time have one sample of the elevator's command.
    """
    path = tmp_path / "flight.csv"
    log = scale({"elevator": sign})(held_in_pitch)
    log_errors.held(log, ["elevator"], hold).to_csv(path, index=False)
    remarks = re.findall("(.*) is probably wrong", "\n".join(inspect_log(path).remarks))
    assert remarks == accused


def slow_gps(flight):
    """Keep every eighth value of the velocities, and lose some of p."""
    slow = flight.copy()
    slow.loc[slow.index % 8 > 0, VELOCITY] = np.nan
    slow.loc[100:300, "p"] = np.nan
    return slow


def noisy(flight):
    """Add noise that attenuates the slope of the change of velocity over the impulse, and not the reverse slope."""
    return flight.assign(ay=flight["ay"] + default_rng(0).normal(0.0, 12.0, len(flight)))


def in_gusts(airspeed):
    """Return an airspeed that an autopilot holds: gusts of 0.3 m/s for 2 s remain."""
    white = default_rng(0).normal(0.0, 0.3 * 0.025**0.5, len(airspeed))
    return airspeed.mean() + signal.lfilter([1.0], [1.0, -(1 - 0.025 / 2.0)], white)


HELD = {
    "p q r ax ay az phi theta psi airspeed alpha beta elevon_left elevon_right rudder throttle": 10,
    "v_north v_east v_down north east altitude": 5,
}
CLEAN = [
    then(),
    vibrating,
    held(HELD),
    then(vibrating, held(HELD)),
    held({"v_north v_east v_down north east altitude": 1}),
    held({"elevon_left elevon_right rudder throttle": 5}),
    late(0.2, *VELOCITY),
    without(*VANES),
    then(ahead, without(*VANES)),
]
SOUND = [
    *(("latlon", change) for change in CLEAN),
    *(("lateral", change) for change in CLEAN[-1:0:-3]),
    ("latlon", heading(3.0)),
    ("latlon", slow_gps),
    ("latlon", noisy),
    ("latlon", from_half("airspeed", in_gusts)),
    ("latlon", scale({"r": 0.0})),
    ("latlon", scale({"airspeed": 0.0})),
]


@pytest.mark.parametrize(("name", "change"), SOUND)
def test_good_flights_have_none(flights, name, change):
    """Nor do those with a dead sensor or missing samples."""
    assert contradictions(change(flights[name])) == []


def test_a_known_position_of_the_accelerometers_ends_a_contradiction(flight):
    """Five metres ahead, they contradict the ground velocity."""
    place = (5.0, 0.0, 0.0)
    log = log_errors.elsewhere(flight, place)
    assert contradictions(log)
    assert contradictions(log_errors.placed(log, place)) == []


@pytest.mark.parametrize("air", ["calm", "light"])
def test_flights_of_jsbsim_have_none(jsbsim_flight, jsbsim_maker, air):
    table = jsbsim_maker.sensed(jsbsim_flight("c172p", air))
    assert contradictions(table) == []
    assert contradictions(vibrating(table)) == []


def test_a_turned_surface_that_an_autopilot_moves_is_named(jsbsim_flight, jsbsim_maker):
    """A late one with the right sign explains the motion surely worse."""
    table = jsbsim_maker.sensed(jsbsim_flight("J3Cub", "light"))
    assert contradictions(table) == []
    assert named(contradictions(turn("aileron")(table))) == {"aileron"}


@pytest.mark.parametrize("every", [10, 20, 40])
def test_rows_that_miss_the_motion_between_them_accuse_no_channel(flights, every):
    """At 2 Hz the trapezoidal rule loses half of a roll or pitch rate, even that of a sound gyro."""
    for flight in flights.values():
        assert contradictions(flight.iloc[::every].reset_index(drop=True)) == []


def test_seconds_of_a_flight_accuse_no_channel(flights):
    """What explains a response a little better by chance is no exchange, a gust that lasts no error of alpha."""
    in_light_gusts = load_example_flights(duration=6.0, turbulence=0.3).train
    lateral = in_light_gusts[in_light_gusts["flight"] == "lateral"].reset_index(drop=True)
    assert not contradictions(lateral[:180])
    for table in flights.values():
        for begin in range(0, len(table), 240):
            assert not contradictions(table[begin : begin + 240].reset_index(drop=True))


def test_a_wrong_scale_beside_noise_and_a_turned_sign_beside_gaps_are_found(flight):
    assert channels_of(then(noisy, scale({"ax ay az": 1 / FOOT}))(flight)) & {*FORCES}
    assert channels_of(turn("v_down")(slow_gps(flight))) == {"v_down"}


@pytest.mark.shared
def test_the_aileron_of_a_real_flight(shared_data):
    """The identified model of the Ampyx AP2 has Cl_aileron = -0.249: positive rolls left (Malz et al. 2019)."""
    assert channels_of(read_flight(shared_data / "ampyx_ap2" / "ampyx_ap2.parquet")) == {"aileron"}


def test_a_surface_that_stands_still_is_not_stuck(flight):
    """In steady flight its response does not go on."""
    steady = ordinary(flight).iloc[:1200].copy()
    still = [name for name in steady if name not in ("time", "flight")]
    steady.loc[600:, still] = steady.loc[[600], still].to_numpy()
    assert Code.STUCK_SURFACE not in [finding.code for finding in contradictions(steady)]


def test_a_surface_that_moves_in_few_rows_is_not_stuck():
    """Beta follows it then, so that their effects on yaw are not told apart; later gusts move beta alone."""
    time = np.arange(0.0, 60.0, 0.05)
    moves = (time > 20.0) & (time < 24.0)
    rudder = 0.1 * np.sin(3.0 * time) * moves
    gusts = 0.03 * np.sin(1.7 * time) + 0.02 * np.sin(2.9 * time)
    beta = np.where(moves, 0.3 * rudder, gusts)
    r = np.cumsum(0.05 * (30.0 * beta - 20.0 * rudder))
    r += 0.001 * default_rng(0).normal(size=len(time))
    still = dict.fromkeys(["p", "aileron"], 0.0 * time)
    log = {"time": time, "airspeed": 20.0 + 0.0 * time, "r": r, "beta": beta, "rudder": rudder}
    assert contradictions(pd.DataFrame(log | still)) == []


def test_a_simulated_airspeed_in_still_air_is_the_ground_speed(flight):
    """Without noise the wind is what both differ by, and of still air that is nothing."""
    through_air = air_velocity(*(flight[name] for name in ("airspeed", "alpha", "beta")))
    still = ordinary(flight)
    still[VELOCITY] = to_earth(flight, through_air)
    level = still.assign(airspeed=np.hypot(still["v_north"], still["v_east"]))
    assert "airspeed" not in [finding.numbers["y"] for finding in contradictions(level)]


def test_gusts_on_an_aircraft_that_hardly_pitches_are_no_wrong_airspeed():
    """Its lift follows the gusts of alpha, which rises where the aircraft falls: a slope of -1.9."""
    step, speed, lift = 0.05, 30.0, 60.0
    rng = default_rng(0)
    gust = 0.02 * lasting(rng, (2400, 1), 14)[:, 0]
    alpha, q = 0.0 * gust, 0.0 * gust
    for k in range(2399):
        flow = alpha[k] + gust[k]
        alpha[k + 1] = alpha[k] + step * (q[k] - lift / speed * flow)
        q[k + 1] = q[k] - step * (10.0 * flow + 4.0 * q[k])
    noise = rng.normal(size=(4, 2400)) * [[0.002], [0.002], [0.002], [0.3]]
    angles = {"alpha": alpha + gust, "q": q + noise[0], "phi": noise[1], "theta": noise[2]}
    log = {"airspeed": speed + noise[3], "az": -9.80665 - lift * (alpha + gust)} | angles
    log["time"] = step * np.arange(2400)
    assert contradictions(pd.DataFrame(log)) == []


def test_a_usual_lag_is_no_wrong_scale():
    """Of a velocity 0.4 s late in heaves of 1.5 s the slope without a lag is negative; vibration attenuates all."""
    time = np.arange(0.0, 60.0, 0.05)
    turns = 2 * np.pi / 1.5
    names = [*log_errors.EULER, *VELOCITY, *FORCES]
    log = pd.DataFrame(default_rng(0).normal(0.0, 0.01, (len(time), 9)), columns=names)
    log["az"] = 350.0 * log["az"] + 3.0 * np.sin(turns * time) - GRAVITY
    log["v_down"] -= 3.0 / turns * np.cos(turns * (time - 0.4))
    assert contradictions(log.assign(time=time)) == []


def test_a_late_servo_is_no_wrong_sign():
    """Rudder of 2 to 3 Hz, servo 0.15 s late, a third of a period: the slope at lag zero has the wrong sign."""
    step = 0.025
    n_late = 6
    time = step * np.arange(6000)
    band = signal.butter(2, (2.0, 3.0), "band", fs=1 / step, output="sos")
    rudder = signal.sosfilt(band, default_rng(0).normal(size=time.size))
    r = signal.lfilter([step], [1.0, 0.5 * step - 1.0], -8.0 * np.roll(rudder, n_late))
    log = pd.DataFrame({"time": time, "airspeed": 15.0, "r": r, "rudder": rudder})[n_late:]
    assert contradictions(log) == []
    assert len(contradictions(turn("rudder")(log))) == 1


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("p", scale({"p": 0.0, "phi": 0.0})),
        ("p", without("p")),
        ("p", turn("p")),
        ("az", log_errors.without_gravity),
    ],
)
def test_what_confirms_a_channel(flight, name, change):
    """Its motion, and another channel of it, unless a law doubts it."""
    confirmed = confirmed_channels(FlightTable.of(flight))
    assert {*RATES, *EULER, "az", "v_down"} <= confirmed
    assert name not in confirmed_channels(FlightTable.of(change(flight)))


def test_noise_has_none(flight):
    noise = flight.drop(columns=["time", "flight"])
    noise[:] = 0.1 * default_rng(0).normal(size=noise.shape)
    noise[["airspeed", "az"]] += [20.0, -9.8]
    assert contradictions(noise.assign(time=flight["time"])) == []


def judged(law, alpha, x, **changes):
    """Return the judgement of a law of alpha over x, 20 Hz."""
    signals = Signals({"alpha": alpha}, np.zeros(len(x), int), 0.05)
    regression = lambda signals: Regression.with_intercept(signals["alpha"], x)  # noqa: E731
    return replace(law, uses=(), regression=regression, **changes).judge(signals)


@pytest.mark.parametrize(("noise", "is_confirmed"), [(0.3, True), (1.5, False)])
def test_a_slope_confirms_a_vane_only_without_gusts(noise, is_confirmed):
    """Of a slope of 1 with a correlation of 0.55 the scale is 1 to 3."""
    x, gusts = default_rng(0).normal(size=(2, 600))
    assert judged(ALPHA, x + noise * gusts, x) == (None, is_confirmed)


@pytest.mark.parametrize(("ratio", "is_accused"), [(1.12, False), (1.17, True)])
def test_a_scale_of_a_vane_is_accused_by_four_standard_deviations(ratio, is_accused):
    """Beyond the admissible 1.1, by slopes near enough to 1 that other signals of them would count as equal."""
    x, noise = default_rng(0).normal(size=(2, 600))
    contradiction, _ = judged(OFFSETS[-2], ratio * x + 0.57 * noise, x)
    assert (contradiction is not None) == is_accused
    assert not is_accused or 4 < contradiction.t < 5


def test_a_late_vane_in_strong_gusts_is_accused_and_confirms_nothing():
    """By 0.4 s, where gusts leave a correlation of less than 0.5 and a long flight a sure slope of 1."""
    motion, gusts = default_rng(0).normal(size=(2, 6000))
    late = np.roll(motion, 8) + 1.9 * gusts
    contradiction, is_equal = judged(PITCH, late, motion, admissible=EQUAL, channels=("alpha",))
    assert contradiction.lag[0] == 0.4
    assert contradiction.slope.correlation < 0.5
    assert not is_equal


def test_parasitic_and_induced_drag_are_no_thrust():
    """CX = CT - CD0 - k CZ^2, beside a part of the lift in ax."""
    noise = default_rng(0).normal(size=(3, 600))
    airspeed, az, force = 20.0 + 2.0 * noise[0], -9.8 + 3.0 * noise[1], 50.0 + 10.0 * noise[2]
    ax = force / 45.0 - 2e-3 * airspeed**2 + 0.05 * az - 0.7 * az**2 / airspeed**2
    channels = {"airspeed": airspeed, "az": az, "ax": ax, "thrust_x": force}
    found = thrust(Signals(channels, np.zeros(600, int), 0.05), "thrust_x")
    assert_allclose(estimated_slope(found).value, 1 / 45.0)


def test_a_faster_flight_is_averaged_by_its_own_rate():
    """Its noise is that of means over 10 samples, not that of single ones between."""
    tables = [
        pd.DataFrame({"time": np.arange(0.0, end, 1 / rate), "flight": name})
        for name, end, rate in (("slow", 300.0, 20), ("fast", 25.0, 200))
    ]
    table = pd.concat(tables, ignore_index=True)
    table = table.assign(airspeed=20.0, q=default_rng(0).normal(size=len(table)))
    signals = signals_of(FlightTable.of(table), ["q"])
    assert_allclose(signals["q"][signals.segment == 0].std(), 1.0, rtol=0.05)
    assert_allclose(signals["q"][signals.segment == 1].std(), 0.1**0.5, rtol=0.1)


def test_flights_shorter_than_a_block_are_judged_by_nothing(flight):
    """Of 8 rows at 200 Hz."""
    assert contradictions(flight.head(8).assign(time=np.arange(8) / 200)) == []


def test_one_of_several_flights(flight):
    """Of half a minute, by itself."""
    wrong = turn("beta")(flight).iloc[: 31 * 40].assign(flight="wrong")
    (found,) = contradictions(pd.concat([flight, wrong], ignore_index=True))
    assert (found.flight, found.numbers["channels"]) == ("wrong", ["beta"])


@pytest.mark.parametrize("seconds", [60.0, 120.0])
def test_q_and_theta_turned_together_in_shallow_turns(seconds):
    """Of a jet psi hardly turns, but q and the turn still have one sign."""
    time = np.arange(0.0, seconds, 0.05)

    def attitude(t):
        turned = -0.057 * np.cos(0.4 * t)  # psi_dot = g tan(phi) / V
        angles = np.stack([turned, 0.02 * np.sin(1.3 * t), 0.3 * np.sin(0.4 * t)], axis=-1)
        return Rotation.from_euler("ZYX", angles)

    motion = flight_of_motion(time, attitude, lambda t: np.ones((len(t), 3)))
    table = motion[[*RATES, *EULER]].copy()
    table += default_rng(0).normal(0.0, 0.001, table.shape)
    table["time"] = time
    assert contradictions(table) == []
    (found,) = contradictions(turn("q theta")(table))
    assert found.numbers["turned"] == ["q", "theta"]


@pytest.fixture
def doublets(glider):
    """Return a function to a glider's flight from trim, whose surfaces fly doublets of 2 s in an order."""
    start = trim(glider.model(), glider.aircraft, 20.0, climb=None, thrust=None)

    def doublets(order):
        time = np.arange(0.0, 7.0 * len(order) + 3.0, 0.02)
        controls = pd.DataFrame({"time": time}).assign(**start.controls)
        for k, name in enumerate(order):
            controls[name] += doublet(1.0, 0.06 * (-1.0) ** k)(time - 7.0 * k - 3.0)
        log = simulate(glider.model(), glider.aircraft, start, controls, thrust=None)
        rng = default_rng(1)
        for names, std in NOISE.items():
            for name in names.split():
                log[name] += std * rng.standard_normal(len(log))
        return log[["time", *SURFACES, *" ".join(NOISE).split()]]

    return doublets


# Standard deviations
NOISE = {"ax ay az": 0.05, "p q r": 0.005, "airspeed": 0.3, "alpha beta phi theta psi": 0.002}


@pytest.mark.parametrize(
    "order",
    [
        ["elevator", "elevator", "aileron", "aileron", "rudder", "rudder"],
        ["aileron", "aileron", "aileron", "aileron", "rudder"],
    ],
)
def test_surfaces_that_move_one_after_another_are_not_stuck(order, doublets):
    """What the other surfaces do is not known from rows where one moves alone."""
    assert contradictions(doublets(order)) == []


def test_late_vanes_accuse_no_surface():
    """Of a record that shows the lag of alpha alone beta is late, too, and rolling by it is no wrong aileron."""
    flights = load_example_flights(random_state=505, duration=21.0, turbulence=0.4).test
    record = flights[(flights["flight"] == "two_altitudes") & (flights["time"] >= 5.0)]
    record = without(*PLACE, *VELOCITY)(record.reset_index(drop=True))
    record[VANES] = record[VANES].shift(12)
    assert channels_of(record[12:].reset_index(drop=True)) == {"alpha"}

"""Laws of physics: faults of channels and sizes of aircraft are found, sound flights and aircraft break none."""

import re
import warnings
from dataclasses import replace

import log_errors
import numpy as np
import pandas as pd
import pytest
import uav_flight
from made_flights import lasting
from numpy.random import default_rng
from scipy import signal

from skdgp._compute.messages import FindingWarning
from skdgp._flight.findings import Code
from skdgp._flight.physics import (
    Regression,
    estimated_slope,
    find_contradictions,
    question_of_sizes,
)
from skdgp._flight.physics._laws import EQUAL
from skdgp._flight.physics._list import ALPHA, OFFSETS
from skdgp._flight.physics._signals import Signals, signals_of
from skdgp._flight.physics._sizes import usual_lift_slope
from skdgp._flight.tables import FlightTable
from skdgp.dynamics import (
    Aircraft,
    ScaleFactor,
    ThrustLine,
    air_velocity,
    euler_to_matrix,
    numbers_in_flight,
    simulate,
    trim,
)
from skdgp.io import inspect_log, read_flight

ELEVONS = ["elevon_left", "elevon_right"]
FORCES = ["ax", "ay", "az"]
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
    """Return findings."""
    return find_contradictions(FlightTable.of(table))


def channels_of(findings):
    return set().union(*(finding.numbers["channels"] for finding in findings))


def scaled(flight, factors):
    """Return a flight with channels, by name or names, multiplied."""
    changed = flight.copy()
    for names, factor in factors.items():
        changed[names.split()] *= factor
    return changed


def opposite(flight, names):
    return scaled(flight, {names: -1.0})


def with_columns(flight, names, values):
    """Return a flight with other values (n, k) of channels."""
    changed = flight.copy()
    changed[names] = values
    return changed


def mixed(matrix):
    """Return what puts other elevons, combinations of the true ones, into a flight."""
    return lambda flight: with_columns(flight, ELEVONS, flight[ELEVONS].to_numpy() @ matrix.T)


def east_north_up(flight):
    names = {"v_north": "v_east", "v_east": "v_north"}
    return opposite(flight.rename(columns=names), "v_down")


def held(flight, rates):
    """Return a flight of 40 Hz whose channels are sampled and held at rates [Hz]."""
    for names, rate in rates.items():
        flight = log_errors.held(flight, names.split(), 40 // rate)
    return flight


def vibrating(flight):
    """Return a flight with an engine's vibration: accelerometers by 3 m/s^2, gyros by 0.15 rad/s."""
    noise = default_rng(0).normal(size=(6, len(flight))) / 3
    wave = np.sin(2 * np.pi * 63 * flight["time"].to_numpy())
    shaken = flight.copy()
    shaken[FORCES] += 3.0 * (wave + noise[:3]).T
    shaken[["p", "q", "r"]] += 0.15 * (wave + noise[3:]).T
    return shaken


# Factors of channels, the channels that are found, and the slope that shows it (None: of a known sign)
SCALED = [
    ({"alpha": -1}, "alpha", None),
    ({"p": -1}, "p", -1),
    ({"az": -1}, "az", -1),
    ({"north": -1}, "north", -1),
    ({"altitude": -1}, "altitude", -1),
    ({"v_down": -1, "altitude": np.nan}, "v_down", -1),
    ({"v_north": -1}, "north v_north", -1),
    ({"ax": -1}, "ax", None),
    ({"thrust_x": -1}, "thrust_x ax", None),
    ({"psi": -1}, "psi r", None),
    ({"elevon_left elevon_right": -1}, "elevon_left elevon_right", None),
    ({"alpha": DEGREES}, "alpha", None),
    ({"beta": 0.5}, "beta", 0.5),
    ({"phi": DEGREES}, "phi", DEGREES),
    ({"psi": DEGREES}, "psi", None),
    ({"phi theta psi": DEGREES}, "phi p", DEGREES),
    ({"p q r": DEGREES}, "p theta q", None),
    ({"ax ay az": 1 / GRAVITY}, "az", 1 / GRAVITY),
    ({"airspeed": 1 / 0.514444}, "airspeed", 0.514444),
    ({"altitude": 1 / 0.3048}, "altitude", 1 / 0.3048),
    ({"q r": -1}, "q r", None),
    ({"theta psi": -1}, "theta q", None),
    ({"v_east v_down": -1}, "east v_east v_down", -1),
    ({"alpha": DEGREES, "p": -1, "rudder": -1}, "alpha p rudder", None),
]


def assert_found(found, channels):
    assert channels_of(found) == set(channels.split())
    assert all("slope" in finding.numbers and abs(finding.numbers["t"]) > 5 for finding in found)


@pytest.mark.parametrize(("factors", "channels", "slope"), SCALED)
def test_a_wrong_sign_or_unit_is_found_in_its_channel(flight, factors, channels, slope):
    found = contradictions(scaled(flight, factors))
    assert_found(found, channels)
    if slope is not None:
        assert found[0].numbers["slope"] == pytest.approx(slope, rel=0.1)


EXCHANGED = [("p", "r"), ("q", "r"), ("phi", "theta"), ("ax", "az"), ("v_north", "v_east")]
EXCHANGED += [("elevator", "aileron"), ("aileron", "rudder"), ("alpha", "beta")]


@pytest.mark.parametrize("pair", EXCHANGED, ids="-".join)
def test_exchanged_channels_are_named_as_such(flight, pair):
    first, second = pair
    log = flight.drop(columns=ELEVONS).rename(columns={first: second, second: first})
    (found,) = contradictions(log)
    assert {*found.numbers["channels"]} == {*pair}
    assert found.numbers["exchanged"]


@pytest.mark.parametrize("name", ELEVONS)
def test_one_turned_elevon_is_named(flight, name):
    (found,) = contradictions(opposite(flight, name))
    assert found.numbers["turned"] == [name]


def test_velocities_east_north_up_are_named_as_such(flight):
    (found,) = contradictions(east_north_up(flight))
    assert found.numbers["axes"] == "east, north, up"


def test_without_an_altitude_an_exchange_of_velocities_does_not_blame_the_third(flights):
    table = flights["lateral"].drop(columns="altitude")
    (found,) = contradictions(table.rename(columns={"v_north": "v_east", "v_east": "v_north"}))
    assert {*found.numbers["channels"]} == {"v_north", "v_east"}


@pytest.mark.parametrize(
    ("factor", "without"),
    [(0.8, []), (2.0, []), (1.4, ["north", "east", "altitude"])],
)
def test_a_wrong_clock_is_named_with_both_rates(flight, factor, without):
    log = flight.drop(columns=without)
    (found,) = contradictions(log.assign(time=factor * log["time"]))
    rate = 1 / np.diff(flight["time"]).mean()
    assert found.numbers["rate"] == pytest.approx(rate / factor, rel=0.01)
    assert found.numbers["true_rate"] == pytest.approx(rate, rel=0.02)


def test_a_wrong_scale_of_one_gyro_is_no_wrong_clock(flight):
    assert_found(contradictions(scaled(flight, {"p": 1.25})), "p")


@pytest.mark.parametrize("factor", [-1.0, 0.1])
def test_impossible_factors_are_no_wrong_clock(flight, factor):
    columns = ["time", "p", "q", "r", "phi", "theta", "psi", "v_north", "v_east", "v_down", *FORCES]
    wrong = scaled(flight[columns], {"p q r v_north v_east v_down": factor})
    found = contradictions(wrong)
    assert {finding.code for finding in found} == {Code.CONTRADICTION}


@pytest.mark.parametrize("degrees", [0.0, 5.0, -5.0])
def test_a_constant_error_of_alpha_is_found_by_the_velocity_through_the_air(flight, degrees):
    found = contradictions(flight.assign(alpha=flight["alpha"] + np.deg2rad(degrees)))
    assert channels_of(found) == ({"alpha"} if degrees else set())
    for finding in found:
        assert finding.numbers["slope"] == pytest.approx(np.deg2rad(degrees), abs=0.02)


EXCHANGED = np.array([[0.0, 1.0], [1.0, 0.0]])
FAULTS = {
    "elevons exchanged": (mixed(EXCHANGED), "elevon_left elevon_right"),
    "elevator reversed": (mixed(-EXCHANGED), "elevon_left elevon_right"),
    "gravity removed": (log_errors.without_gravity, "az"),
    "heading from east": (lambda flight: flight.assign(psi=np.pi / 2 - flight["psi"]), "psi r"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_in_its_channel(flight, fault):
    change, channels = FAULTS[fault]
    assert_found(contradictions(change(flight)), channels)


@pytest.mark.parametrize(
    ("name", "seconds", "explained", "channels"),
    [
        ("p", 0.8, 0.2, "phi p"),
        ("v_down", 0.8, 0.2, "altitude v_down"),
        ("altitude", 0.8, 0.2, "altitude v_down"),
        ("airspeed", 2.0, 0.3, "airspeed psi v_north v_east"),
        ("airspeed", 2.0, -0.3, "airspeed psi v_north v_east"),
    ],
)
def test_a_lag_is_found_beyond_what_corrections_holds_and_gusts_explain(
    flight, name, seconds, explained, channels
):
    found = contradictions(log_errors.late(flight, seconds, [name]))
    assert all("lag" in finding.numbers for finding in found)
    assert channels_of(found) <= set(channels.split())
    assert abs(found[0].numbers["lag"]) == pytest.approx(seconds, rel=0.12)
    assert contradictions(log_errors.late(flight, explained, [name])) == []


@pytest.mark.parametrize("degrees", [-15.0, 3.0, 15.0])
def test_a_magnetic_heading_is_found_by_the_course_through_the_air(flight, degrees):
    turned = flight["psi"] + np.deg2rad(degrees)
    found = contradictions(flight.assign(psi=np.angle(np.exp(1j * turned))))
    if degrees == 3.0:
        assert found == []
    else:
        assert_found(found, "psi")
        assert found[0].numbers["slope"] == pytest.approx(-np.sin(np.deg2rad(degrees)), abs=0.03)
        # and hides no other
        assert "ay" in channels_of(contradictions(opposite(flight.assign(psi=turned), "ay")))


def circling(rate, bank, updraft=0.0, late=0.0, heading=0.0):
    """Return two minutes of a glider that turns at a rate [rad/s] through gusts, or flies one heading at rate 0."""
    rng = default_rng(0)
    time = 0.05 * np.arange(2400)
    psi = heading + rate * time
    phi = np.full(len(time), bank)
    airspeed = 14.0 + 3.0 * np.sin(0.1 * time)
    gust = signal.lfilter([0.05], [1, -0.95], rng.normal(size=(3, len(time)))) * 0.5
    crosswind = np.sin(0.1 * time) if rate == 0 else 0.0
    north = airspeed * np.cos(psi) + 4.0 - 3.0 * np.sin(heading) * crosswind + gust[0]
    east = airspeed * np.sin(psi) - 2.0 + 3.0 * np.cos(heading) * crosswind + gust[1]
    table = {"time": time, "phi": phi, "theta": 0.0 * time, "psi": psi, "airspeed": airspeed}
    table |= {"v_north": north, "v_east": east, "v_down": gust[2] - updraft}
    for name in ("v_north", "v_east", "v_down"):
        table[name] = np.interp(time - late, time, table[name])
    return pd.DataFrame(table)


@pytest.mark.parametrize(
    "options",
    [
        {"rate": 0.5, "bank": 0.6, "late": 0.5},
        {"rate": 0.4, "bank": 0.7, "updraft": 4.0},
        {"rate": 0.0, "bank": 0.0, "heading": 1.0},
    ],
)
def test_late_velocity_updrafts_and_crosswinds_are_no_wrong_heading(options):
    flight = circling(**options)
    assert "psi" not in channels_of(contradictions(flight))


@pytest.mark.parametrize("west", [1.0, -1.0])
def test_accelerometers_in_earth_axes_are_accused(flight, west):
    """North, east or west, and down, as inertial navigation systems record them."""
    rotation = euler_to_matrix(flight["phi"], flight["theta"], flight["psi"])
    force = np.einsum("nij,nj->ni", rotation, flight[FORCES].to_numpy())
    accused = channels_of(contradictions(with_columns(flight, FORCES, force * [1.0, west, 1.0])))
    assert accused & {"ax", "ay"}
    assert accused <= {*FORCES}


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
    assert np.std(scores) == pytest.approx(1.0, abs=0.2)
    # Bartlett: tau = (1 + rho^2) / (1 - rho^2)
    assert np.mean(sizes) == pytest.approx(2000 * 0.19 / 1.81, rel=0.25)


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
    log = scaled(held_in_pitch, {"elevator": sign})
    log_errors.held(log, ["elevator"], hold).to_csv(path, index=False)
    remarks = re.findall("(.*) is probably wrong", "\n".join(inspect_log(path).remarks))
    assert remarks == accused


RATES = {
    "p q r ax ay az phi theta psi airspeed alpha beta elevon_left elevon_right rudder throttle": 10,
    "v_north v_east v_down north east altitude": 5,
}
CLEAN = {
    "as logged": lambda flight: flight,
    "vibrating": vibrating,
    "held": lambda flight: held(flight, RATES),
    "vibrating and held": lambda flight: held(vibrating(flight), RATES),
    "slow GPS": lambda flight: held(flight, {"v_north v_east v_down north east altitude": 1}),
    "slow servos": lambda flight: held(flight, {"elevon_left elevon_right rudder throttle": 5}),
    "late GPS": lambda flight: log_errors.late(flight, 0.2, log_errors.VELOCITY),
    "no vanes": lambda flight: flight.drop(columns=["alpha", "beta"]),
    "no vanes, accelerometers ahead": lambda flight: log_errors.elsewhere(flight, AHEAD).drop(
        columns=["alpha", "beta"]
    ),
}


@pytest.mark.parametrize("logged", CLEAN)
@pytest.mark.parametrize("name", ["lateral", "latlon"])
def test_good_flights_have_none(flights, logged, name):
    assert contradictions(CLEAN[logged](flights[name])) == []


@pytest.mark.parametrize("moved", [False, True])
def test_a_reversed_rudder_is_found_without_vanes(flight, moved):
    log = log_errors.elsewhere(flight, AHEAD) if moved else flight
    found = contradictions(opposite(log.drop(columns=["alpha", "beta"]), "rudder"))
    assert channels_of(found) == {"rudder"}


def test_a_known_position_of_the_accelerometers_ends_a_contradiction(flight):
    """Five metres ahead, they contradict the ground velocity."""
    place = (5.0, 0.0, 0.0)
    log = log_errors.elsewhere(flight, place)
    assert contradictions(log)
    assert contradictions(log_errors.placed(log, place)) == []


@pytest.mark.parametrize("name", ["r", "airspeed"])
def test_a_dead_sensor_makes_no_other_wrong(flight, name):
    assert contradictions(flight.assign(**{name: 0.0})) == []


@pytest.mark.parametrize("air", ["calm", "light"])
def test_flights_of_jsbsim_have_none(jsbsim_flight, jsbsim_maker, air):
    table = jsbsim_maker.sensed(jsbsim_flight("c172p", air))
    assert contradictions(table) == []
    assert contradictions(vibrating(table)) == []


def test_noise_of_a_sensor_is_no_contradiction_and_a_wrong_scale_beside_it_is(flight):
    """Noise attenuates the slope of the change of velocity over the impulse, and not the reverse slope."""
    noise = default_rng(0).normal(0.0, 12.0, len(flight))
    noisy = flight.assign(ay=flight["ay"] + noise)
    assert contradictions(noisy) == []
    in_feet = scaled(noisy, {"ax ay az": 1 / FOOT})
    assert channels_of(contradictions(in_feet)) & {*FORCES}


@pytest.mark.shared
def test_the_aileron_of_a_real_flight(shared_data):
    """The identified model of the Ampyx AP2 has Cl_aileron = -0.249: positive rolls left (Malz et al. 2019)."""
    (found,) = contradictions(read_flight(shared_data / "ampyx_ap2" / "ampyx_ap2.parquet"))
    assert found.numbers["channels"] == ["aileron"]


GPS = ["v_north", "v_east", "v_down"]
VANES = ["alpha", "beta"]
BODY = ["q", "r", "ay", "az"]


def channels_of_each(flight):
    """Return the channels of each contradiction."""
    return [{*finding.numbers["channels"]} for finding in contradictions(flight)]


@pytest.fixture
def ordinary(flight):
    """Return a flight of elevator and aileron, without position."""
    mixed = flight[ELEVONS].to_numpy() @ np.array([[0.5, 0.5], [0.5, -0.5]])
    table = flight.assign(elevator=mixed[:, 0], aileron=mixed[:, 1])
    return table.drop(columns=[*ELEVONS, "north", "east", "altitude"])


@pytest.mark.parametrize("pair", [{"q", "theta"}, {"p", "phi"}, {"r", "psi"}])
@pytest.mark.parametrize("without", [[], VANES])
def test_a_rate_and_its_angle_turned_together(ordinary, pair, without):
    """They agree with each other, but in turns q = psi_dot sin phi cos theta is positive on either side."""
    turned = opposite(ordinary.drop(columns=without), " ".join(pair))
    assert channels_of_each(turned) == [pair]


@pytest.mark.parametrize("names", [BODY, [*BODY, "theta", "psi", "v_east", "v_down"]])
def test_axes_forward_left_up_are_one_mistake(ordinary, names):
    turned = opposite(ordinary.drop(columns=VANES), " ".join(names))
    assert channels_of_each(turned) == [{*names}]


@pytest.mark.parametrize("earth", [[], ["v_east", "v_down"]])
def test_beta_may_be_in_these_axes_too(ordinary, earth):
    names = [*BODY, "theta", "psi", "beta", *earth]
    assert channels_of_each(opposite(ordinary, " ".join(names))) == [{*names}]


@pytest.mark.parametrize("rows", [4, 20])
def test_late_vanes_are_named_and_no_surface(ordinary, rows):
    """Of 0.1 s at most LagCorrector corrects in silence."""
    late = ordinary[VANES].shift(rows)
    table = ordinary.assign(**late).iloc[rows:].reset_index(drop=True)
    vanes = {*VANES} if rows > 4 else set()
    assert channels_of(contradictions(table.drop(columns=GPS))) == vanes


SURFACES = ["elevator", "aileron", "rudder"]


def from_half(values, change):
    """Return a channel with the second half changed."""
    half = len(values) // 2
    return np.concatenate([values[:half], change(values.to_numpy()[half:])])


@pytest.mark.parametrize("name", ["elevator", "aileron"])
def test_a_surface_that_is_stuck_from_the_middle(ordinary, name):
    stuck = from_half(ordinary[name], lambda later: np.full(len(later), later[0]))
    (found,) = contradictions(ordinary.assign(**{name: stuck}))
    assert found.code is Code.STUCK_SURFACE
    assert found.numbers["channels"] == [name]
    assert found.numbers["percent"] == pytest.approx(50.0, abs=3.0)


def test_a_surface_that_stands_still_is_not_stuck(ordinary):
    """In steady flight its response does not go on."""
    steady = ordinary.iloc[:1200].copy()
    still = [name for name in steady if name not in ("time", "flight")]
    steady.loc[600:, still] = steady.loc[[600], still].to_numpy()
    codes = [finding.code for finding in contradictions(steady)]
    assert Code.STUCK_SURFACE not in codes


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_pitot_tube_that_changes_in_flight(ordinary, factor):
    airspeed = from_half(ordinary["airspeed"], lambda later: factor * later)
    (found,) = contradictions(ordinary.assign(airspeed=airspeed))
    assert found.numbers["channels"] == ["airspeed"]
    assert found.numbers["slope"] == pytest.approx(1 - 1 / factor, abs=0.05)


@pytest.mark.parametrize(
    ("names", "seconds", "without"),
    [(SURFACES, 0.3, []), (log_errors.VELOCITY, 1.0, []), (log_errors.VELOCITY, 1.0, VANES)],
)
def test_channels_that_are_late_together_are_one_mistake(ordinary, names, seconds, without):
    """Velocities of GPS later than a corrector takes, and surfaces that follow their effects."""
    (found,) = contradictions(log_errors.late(ordinary.drop(columns=without), seconds, names))
    assert {*found.numbers["late"]} == {*names}
    assert found.numbers["lag"] == pytest.approx(seconds, abs=0.1)


@pytest.mark.parametrize("factor", [0.9, 0.95, 1.05, 1.1])
def test_a_small_error_of_the_scale_of_the_airspeed(ordinary, factor):
    (found,) = contradictions(scaled(ordinary, {"airspeed": factor}))
    assert found.numbers["channels"] == ["airspeed"]
    assert found.numbers["slope"] == pytest.approx(1 / factor, rel=0.02)


COPIES = {
    "alpha": lambda flight: flight["theta"],
    "psi": lambda flight: np.arctan2(flight["v_east"], flight["v_north"]),
    "airspeed": lambda flight: np.hypot(flight["v_north"], flight["v_east"]).round(2),
}


@pytest.mark.parametrize("name", COPIES)
def test_a_copy_of_another_signal_is_no_sensor(ordinary, name):
    found = contradictions(ordinary.assign(**{name: COPIES[name]}))
    assert channels_of(found) == {name}


def test_a_simulated_airspeed_in_still_air_is_the_ground_speed(ordinary):
    """Without noise the wind is what both differ by, and of still air that is nothing."""
    angles = [ordinary[name] for name in ("phi", "theta", "psi")]
    through_air = air_velocity(*(ordinary[name] for name in ("airspeed", "alpha", "beta")))
    velocity = np.einsum("nij,nj->ni", euler_to_matrix(*angles), through_air)
    still = with_columns(ordinary, log_errors.VELOCITY, velocity)
    level = still.assign(airspeed=np.hypot(still["v_north"], still["v_east"]))
    accused = [each.numbers["y"] for each in contradictions(level)]
    assert "airspeed" not in accused


def test_the_scale_of_the_airspeed_without_gps(ordinary):
    """alpha follows q + az / V."""
    wrong = scaled(ordinary.drop(columns=GPS), {"airspeed": 3.6})
    assert channels_of_each(wrong) == [{"airspeed"}]


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
    assert contradictions(pd.DataFrame(log).assign(time=step * np.arange(2400))) == []


def test_a_late_servo_is_no_wrong_sign():
    """Rudder of 2 to 3 Hz, servo 0.15 s late, a third of a period: the slope at lag zero has the wrong sign."""
    step = 0.025
    n_late = 6
    time = step * np.arange(6000)
    band = signal.butter(2, (2.0, 3.0), "band", fs=1 / step, output="sos")
    rudder = signal.sosfilt(band, default_rng(0).normal(size=time.size))
    acceleration = -8.0 * np.roll(rudder, n_late)
    r = signal.lfilter([step], [1.0, 0.5 * step - 1.0], acceleration)
    log = pd.DataFrame({"time": time, "airspeed": 15.0, "r": r, "rudder": rudder})[n_late:]
    assert contradictions(log) == []
    assert len(contradictions(opposite(log, "rudder"))) == 1


def test_noise_has_none(flight):
    rng = default_rng(0)
    noise = flight.drop(columns=["time", "flight"])
    noise[:] = 0.1 * rng.normal(size=noise.shape)
    noise[["airspeed", "az"]] += [20.0, -9.8]
    assert contradictions(noise.assign(time=flight["time"])) == []


@pytest.mark.parametrize(("ratio", "is_accused"), [(1.12, False), (1.17, True)])
def test_a_scale_of_a_vane_is_accused_by_four_standard_deviations(ratio, is_accused):
    """Beyond the admissible 1.1, by slopes near enough to 1 that other signals of them would count as equal."""
    x, noise = default_rng(0).normal(size=(2, 600))
    signals = Signals({"alpha": ratio * x + 0.57 * noise}, np.zeros(600, int), 0.05)
    law = replace(
        OFFSETS[-2],
        uses=(),
        regression=lambda signals: Regression.with_intercept(signals["alpha"], x),
    )
    contradiction, _ = law.judge(signals)
    assert (contradiction is not None) == is_accused
    assert not is_accused or 4 < contradiction.t < 5


def test_a_late_vane_in_strong_gusts_is_accused_and_confirms_nothing():
    """By 0.4 s, where gusts leave a correlation of less than 0.5 and a long flight a sure slope of 1."""
    motion, gusts = default_rng(0).normal(size=(2, 6000))
    signals = Signals({"alpha": np.roll(motion, 8) + 1.9 * gusts}, np.zeros(6000, int), 0.05)
    law = replace(
        ALPHA,
        uses=(),
        admissible=EQUAL,
        regression=lambda signals: Regression.with_intercept(signals["alpha"], motion),
    )
    contradiction, is_equal = law.judge(signals)
    assert contradiction.lag[0] == 0.4
    assert contradiction.slope.correlation < 0.5
    assert not is_equal


def test_a_faster_flight_is_averaged_by_its_own_rate():
    """Its noise is that of means over 10 samples, not that of single ones between."""
    rng = default_rng(0)
    tables = [
        pd.DataFrame({"time": np.arange(0.0, end, 1 / rate), "flight": name, "q": 0.0})
        for name, end, rate in (("slow", 300.0, 20), ("fast", 25.0, 200))
    ]
    table = pd.concat(tables, ignore_index=True).assign(airspeed=20.0)
    table["q"] = rng.normal(size=len(table))
    signals = signals_of(FlightTable.of(table), ["q"])
    assert signals["q"][signals.segment == 0].std() == pytest.approx(1.0, rel=0.05)
    assert signals["q"][signals.segment == 1].std() == pytest.approx(0.1**0.5, rel=0.1)


def test_flights_shorter_than_a_block_are_judged_by_nothing(flight):
    """Of 8 rows at 200 Hz."""
    short = flight.head(8).assign(time=np.arange(8) / 200)
    assert contradictions(short) == []


def test_missing_samples_change_nothing(flight):
    slow = flight.copy()
    slow.loc[slow.index % 8 > 0, ["v_north", "v_east", "v_down"]] = np.nan
    slow.loc[100:300, "p"] = np.nan
    assert contradictions(slow) == []
    (found,) = contradictions(opposite(slow, "v_down"))
    assert found.numbers["channels"] == ["v_down"]


def test_one_of_several_flights(flight):
    wrong = opposite(flight, "beta").assign(flight="wrong")
    (found,) = contradictions(pd.concat([flight, wrong], ignore_index=True))
    assert (found.flight, found.numbers["channels"]) == ("wrong", ["beta"])


# mass, wing area, span, chord, (Ixx, Iyy, Izz), CZ_alpha, Cl_p, Cm_q, Cn_r: Heffley & Jewell 1972, Beard &
# McLain 2012, Gryte 2018, from memory
PUBLISHED = {
    "Cessna 172": ((1043.0, 16.2, 11.0, 1.49), (1285, 1825, 2667), (-5.1, -0.47, -12.4, -0.099)),
    "F-104": ((7400.0, 18.2, 6.69, 2.92), (4810, 79500, 81300), (-3.44, -0.285, -5.8, -0.265)),
    "X-15": ((7060.0, 18.6, 6.82, 3.13), (4950, 108500, 111200), (-3.5, -0.25, -6.2, -1.0)),
    "Boeing 747": ((288800.0, 511.0, 59.6, 8.32), (24.7e6, 44.9e6, 67.4e6), (-5.5, -0.45, -20.8, -0.3)),
    "Zagi": ((1.56, 0.2589, 1.4224, 0.3302), (0.1147, 0.0576, 0.1712), (-3.5, -0.32, -1.4, -0.0043)),
    "Skywalker X8": ((3.364, 0.75, 2.1, 0.3571), (0.335, 0.14, 0.4), (-4.02, -0.41, -1.3, -0.022)),
}  # fmt: skip
NAMES = ("mass", "wing_area", "span", "chord")
INERTIA = ("Ixx", "Iyy", "Izz")
DERIVATIVES = ("CZ_alpha", "Cl_p", "Cm_q", "Cn_r")


@pytest.fixture(scope="module")
def train(first_minute):
    """Return half a minute of flights of an aircraft of 45 kg and 2.8 m."""
    train = first_minute().train
    return train[train["time"] < 30.0].reset_index(drop=True)


def published(name):
    sizes, inertia, derivatives = PUBLISHED[name]
    return dict(
        zip((*NAMES, *INERTIA, *DERIVATIVES), (*sizes, *inertia, *derivatives), strict=True)
    )


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_aircraft_break_no_law(name):
    assert question_of_sizes(published(name), {}) is None


def test_lift_slope_of_a_slender_and_of_an_infinite_wing():
    assert usual_lift_slope({"span": 0.1, "wing_area": 1.0}) == pytest.approx(
        np.pi * 0.01 / 2, rel=0.01
    )
    assert usual_lift_slope({"span": 1e3, "wing_area": 1.0}) == pytest.approx(2 * np.pi, rel=0.01)


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize(
    ("size", "unit"), [("span", FOOT), ("mass", 1e-3), ("chord", 0.01), ("wing_area", FOOT**2)]
)
def test_one_size_of_another_unit_is_asked_for(name, size, unit):
    """It is among those that are asked for, unless the number is one that aircraft have."""
    right = published(name)
    bare = {key: right[key] for key in (*NAMES, *INERTIA)}
    question = question_of_sizes(bare | {size: right[size] / unit}, {})
    assert question.code is Code.SIZES_QUESTIONED
    asked = {found.channel: found.numbers["value"] for found in question.numbers["asked"]}
    assert asked[size] == pytest.approx(right[size])


@pytest.mark.parametrize(
    ("changed", "law"),
    [
        ({"Ixx": 79500.0, "Iyy": 4810.0}, "Ixx / Iyy over the aspect ratio"),
        ({"Ixx": 81300.0, "Izz": 4810.0}, "Izz over Ixx + Iyy"),
        ({"Ixz": 12000.0}, "Ixz over the root of Ixx Izz"),
    ],
)
def test_moments_of_inertia_that_no_aeroplane_has(changed, law):
    question = question_of_sizes(published("F-104") | changed, {})
    assert law in {found.channel for found in question.numbers["laws"]}


def test_the_unit_of_the_inertia_is_asked_for():
    right = published("Zagi")
    bare = {name: right[name] for name in NAMES}
    question = question_of_sizes(bare | {name: right[name] / 0.001 for name in INERTIA}, {})
    asked = [(found.channel, found.numbers["unit"]) for found in question.numbers["asked"]]
    assert ("Ixx", "g m^2") in asked


def test_a_size_of_another_source_is_asked_for():
    weighed = {"weight": ScaleFactor(0.02, {"mass": 1.0}, "scale of 2021")}
    inertia = np.diag([0.8, 1.1, 1.8])
    sizes = {"mass": 13500.0, "inertia": inertia, "wing_area": 0.55, "span": 2.9, "chord": 0.19}
    question = Aircraft(**sizes, deviations=weighed).question_of_sizes()
    asked = [(found.channel, found.numbers["unit"]) for found in question.numbers["asked"]]
    assert ("mass", "g") in asked


@pytest.mark.parametrize(
    ("size", "unit", "factor"),
    [
        ("span", "m of half the span", 0.5),
        ("wing_area", "m^2 of one wing", 0.5),
        ("Ixx", "kgf m s^2", 1 / GRAVITY),
    ],
)
def test_the_half_and_the_technical_unit_are_asked_for_first(size, unit, factor):
    right = published("Zagi")
    bare = {name: right[name] for name in (*NAMES, *INERTIA)}
    names = INERTIA if size == "Ixx" else [size]
    changed = {name: factor * bare[name] for name in names}
    question = question_of_sizes(bare | changed, {})
    assert unit in [found.numbers["unit"] for found in question.numbers["asked"]]


@pytest.mark.parametrize("seconds", [60.0, 120.0])
def test_q_and_theta_turned_together_in_shallow_turns(seconds):
    """Of a jet psi hardly turns, but q and the turn still have one sign."""
    time = np.arange(0.0, seconds, 0.05)
    phi = 0.3 * np.sin(0.4 * time)
    psi = np.cumsum(0.05 * 9.81 / 130 * np.tan(phi))
    theta = 0.02 * np.sin(1.3 * time)
    q = np.gradient(theta, time) * np.cos(phi) + np.gradient(psi, time) * np.sin(phi)
    r = np.gradient(psi, time) * np.cos(phi) - np.gradient(theta, time) * np.sin(phi)
    p = np.gradient(phi, time) - np.gradient(psi, time) * np.sin(theta)
    table = pd.DataFrame(
        {"time": time, "p": p, "q": q, "r": r, "phi": phi, "theta": theta, "psi": psi}
    )
    table.iloc[:, 1:] += default_rng(0).normal(0.0, 0.001, (len(time), 6))
    assert contradictions(table) == []
    (found,) = contradictions(opposite(table, "q theta"))
    assert found.numbers["turned"] == ["q", "theta"]


def asked_of(aircraft, flights):
    """Return the question for the sizes of an aircraft that flights ask."""
    return aircraft.question_of_sizes(*numbers_in_flight(flights, aircraft))


@pytest.mark.parametrize(("size", "factor"), [("mass", 1 / 0.45359237), ("thrust_x", 1 / 4.44822)])
def test_the_thrust_tells_the_mass(first_minute, flight, size, factor):
    """Newton's second law: the slope of ax over the thrust is 1 / mass."""
    aircraft = first_minute().aircraft
    assert asked_of(aircraft, FlightTable.of(flight)) is None
    if size == "mass":
        aircraft = replace(aircraft, mass=factor * aircraft.mass)
    else:
        flight = flight.assign(thrust_x=factor * flight["thrust_x"])
    question = asked_of(aircraft, FlightTable.of(flight))
    assert size.removesuffix("_x") in {found.channel for found in question.numbers["asked"]}


@pytest.mark.parametrize(
    ("diameter", "scale", "direction", "asked"),
    [
        (1.0, 1.0, 1.0, None),
        (1.0, 1.0, -1.0, "thrust_line.direction"),
        (1 / 0.0254, 1.0, 1.0, "propeller.diameter"),
        (100.0, 1.0, 1.0, "propeller.diameter"),
        (1.0, 30 / np.pi, 1.0, "propeller_speed"),
    ],
)
def test_flights_ask_for_the_propeller_and_the_thrust_line(
    first_minute, flight, diameter, scale, direction, asked
):
    aircraft = first_minute().aircraft
    propeller = replace(aircraft.propeller, diameter=diameter * aircraft.propeller.diameter)
    line = ThrustLine(direction=direction * aircraft.engine_line.direction)
    changed = replace(aircraft, propeller=propeller, thrust_line=line)
    speed = scale * flight["propeller_speed"]
    by_propeller = flight.drop(columns=flight.filter(like="thrust").columns)
    question = asked_of(changed, FlightTable.of(by_propeller.assign(propeller_speed=speed)))
    names = [] if question is None else [each.channel for each in question.numbers["asked"]]
    assert (asked in names) == (asked is not None)
    assert "mass" not in names


def test_an_engine_that_is_off_or_unknown_asks_nothing(first_minute, flight):
    aircraft = first_minute().aircraft
    gliding = flight.drop(columns=flight.filter(like="thrust").columns)
    assert asked_of(aircraft, FlightTable.of(gliding.assign(propeller_speed=0.0))) is None
    assert asked_of(aircraft, FlightTable.of(gliding.assign(propeller_speed=np.nan))) is None
    assert asked_of(aircraft, FlightTable.of(flight.assign(thrust_z=np.nan))) is None


def test_noise_of_the_thrust_questions_no_mass(first_minute, flight):
    """Noise three times the spread, each value for ten rows, attenuates the slope to 0.27 / mass."""
    thrust = flight["thrust_x"]
    noise = default_rng(0).normal(0.0, 3 * thrust.std(), len(thrust) // 10)
    noisy = FlightTable.of(flight.assign(thrust_x=thrust + np.repeat(noise, 10)))
    assert asked_of(first_minute().aircraft, noisy) is None


def test_the_aircraft_is_judged_when_it_is_read():
    with pytest.warns(FindingWarning, match=r"Check these .*span 11 m \(1100 cm\)"):
        Aircraft.estimate(1111.0, 1100.0)
    sizes = {"mass": 13.5, "span": 2.9, "wing_area": 0.55, "chord": 0.19}
    inertia = 1e4 * np.diag([0.8, 1.1, 1.8])
    with pytest.warns(FindingWarning, match="radius of gyration in roll"):
        Aircraft.from_dict(sizes | {"inertia": inertia.tolist()})


def test_flights_of_the_right_sizes_ask_nothing(first_minute, train):
    for aircraft in (first_minute().aircraft, Aircraft.estimate(45.0, 2.8, kind="delta")):
        assert asked_of(aircraft, FlightTable.of(train)) is None


@pytest.mark.parametrize(
    ("mass", "span", "factor", "asked"),
    [
        (450.0, 2.8, 1.0, "mass .* kg"),
        (45.0, 1.4, 1.0, r"CL_alpha over that of a wing .* span 2.8 m \(1.4 m of half"),
        (45.0, 280.0, 1.0, r"span 2.8 m \(280 cm\)"),
        (45.0, 2.8 / FOOT, 1.0, r"span 2.8 m \(9.186 ft\)"),
        (45.0, 2.8, 1 / FOOT, r"airspeed 3\d.* m/s \(.* ft/s\)"),
        (45.0, 2.8, 3.6, r"airspeed 3\d.* m/s \(.* km/h\)"),
    ],
)
def test_flights_ask_for_the_wrong_size(mass, span, factor, asked, train):
    """The lift that carried an aircraft has a slope of a wing only with its mass, wing and airspeed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        aircraft = Aircraft.estimate(mass, span, kind="delta")
    flights = FlightTable.of(train.assign(airspeed=factor * train["airspeed"]))
    assert re.search(asked, asked_of(aircraft, flights).text)


def test_half_a_span_is_asked_for_and_no_mass_in_grams(train):
    """A mass of 45 g has a small slope of the lift, whose error is as small."""
    question = asked_of(Aircraft.estimate(45.0, 1.4), FlightTable.of(train)).text
    assert "span 2.8 m (1.4 m of half the span)" in question
    assert "45 g" not in question


@pytest.mark.parametrize(("name", "factor"), [("alpha", 3), ("az", 10)])
def test_a_noisy_sensor_accuses_no_size(first_minute, train, name, factor):
    """Noise of alpha attenuates the slope, that of az the correlation; the reverse regression bounds it."""
    rng = np.random.default_rng(0)
    noise = factor * train[name].std() * rng.standard_normal(len(train))
    noisy = train.assign(**{name: train[name] + noise})
    assert asked_of(first_minute().aircraft, FlightTable.of(noisy)) is None


@pytest.fixture
def doublets(glider):
    """Return a function to a glider's flight from trim, whose surfaces fly doublets of 2 s in an order."""
    start = trim(glider.model(), glider.aircraft, 20.0, climb=None, thrust=None)

    def doublets(order):
        time = np.arange(0.0, 7.0 * len(order) + 3.0, 0.02)
        controls = pd.DataFrame({"time": time}).assign(**start.controls)
        for k, name in enumerate(order):
            since = time - 7.0 * k - 3.0
            sign = (-1.0) ** k * np.where(since < 1.0, 1.0, -1.0)
            controls[name] += 0.06 * sign * ((since >= 0.0) & (since < 2.0))
        flown = simulate(glider.model(), glider.aircraft, start, controls, thrust=None)
        log = flown[["time", *SURFACES]].copy()
        rng = default_rng(1)
        for names, std in NOISE.items():
            for name in names.split():
                log[name] = flown[name] + std * rng.standard_normal(len(flown))
        return log

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

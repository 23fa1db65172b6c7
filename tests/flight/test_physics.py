"""Checks of physics: a fault put into a good flight is found in its channel, and a good flight has none."""

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.wording import reason_of
from skdgp._flight import physics
from skdgp._flight.frames import STANDARD_GRAVITY, gravity_in_body_axes
from skdgp._flight.physics import Regression, estimated_slope
from skdgp._flight.tables import FlightTable
from skdgp.datasets import load_example_flights
from skdgp.identification._prepare import usable_flights
from skdgp.io import inspect_log, read_flight
from skdgp.preprocessing import FlightDataWarning

ELEVONS = {"elevon_left", "elevon_right"}
ATTITUDE = ("phi", "theta", "psi")
FORCES = ("ax", "ay", "az")
DEGREES = 180 / np.pi


def find_contradictions(table):
    return physics.find_contradictions(FlightTable.of(table))


@pytest.fixture(scope="module")
def flight(first_minute):
    """Return a minute with all controls moving."""
    train = first_minute().train
    return train[train["flight"] == "latlon"].reset_index(drop=True)


def scaled(factor, *names):
    return lambda flight: flight.assign(**{name: factor * flight[name] for name in names})


def opposite(*names):
    return scaled(-1.0, *names)


def controls(elevator, aileron):
    """Return what multiplies the controls by signs, the elevons with them."""

    def change(flight):
        left, right = flight["elevon_left"], flight["elevon_right"]
        symmetric = elevator * (left + right) / 2
        antisymmetric = aileron * (left - right) / 2
        return flight.assign(
            elevon_left=symmetric + antisymmetric, elevon_right=symmetric - antisymmetric
        )

    return change


def exchanged_elevons(flight):
    return flight.assign(elevon_left=flight["elevon_right"], elevon_right=flight["elevon_left"])


def without_gravity(flight):
    gravity = gravity_in_body_axes(flight["phi"], flight["theta"])
    return flight.assign(**{name: flight[name] + gravity[:, k] for k, name in enumerate(FORCES)})


def east_north_up(flight):
    return flight.assign(
        v_north=flight["v_east"], v_east=flight["v_north"], v_down=-flight["v_down"]
    )


def late(seconds, *names):
    def change(flight):
        time = flight["time"]
        return flight.assign(
            **{name: np.interp(time - seconds, time, np.unwrap(flight[name])) for name in names}
        )

    return change


def held(flight, rates):
    """Return a flight whose channels are sampled and held at rates [Hz]."""
    step = np.median(np.diff(flight["time"]))
    rows = np.arange(len(flight))
    columns = {}
    for names, rate in rates.items():
        n = round(1 / (rate * step))
        columns |= {name: flight[name].to_numpy()[rows // n * n] for name in names.split()}
    return flight.assign(**columns)


def vibrating(flight, size=3.0):
    """Return a flight with an engine's vibration: accelerometers by ``size`` [m/s^2], gyros by a twentieth [rad/s]."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(6, len(flight))) / 3
    wave = np.sin(2 * np.pi * 63 * flight["time"].to_numpy())
    columns = {}
    for k, name in enumerate((*FORCES, "p", "q", "r")):
        amplitude = size if name in FORCES else size / 20
        columns[name] = flight[name] + amplitude * (wave + noise[k])
    return flight.assign(**columns)


# Fault: what makes it, its channels, and the slope that shows it (None: of a known sign)
FAULTS = {
    **{
        f"sign of {name}": (opposite(name), {name}, slope)
        for name, slope in {
            "alpha": None, "p": -1, "az": -1, "phi": -1, "v_down": -1, "r": -1, "north": -1,
            "altitude": -1, "rudder": None,
        }.items()
    },
    "sign of v_down without altitude": (
        lambda flight: opposite("v_down")(flight.drop(columns="altitude")),
        {"v_down"},
        -1,
    ),
    "sign of beta": (opposite("beta"), {"beta", "ay"}, None),
    "sign of v_north": (opposite("v_north"), {"north", "v_north"}, -1),
    "sign of ax": (opposite("ax"), {"throttle", "ax"}, None),
    "sign of psi": (opposite("psi"), {"psi", "r"}, None),
    "elevator reversed": (controls(-1, 1), ELEVONS, None),
    "aileron reversed": (controls(1, -1), ELEVONS, None),
    "elevons exchanged": (exchanged_elevons, ELEVONS, None),
    "elevons reversed": (controls(-1, -1), ELEVONS, None),
    "alpha in degrees": (scaled(DEGREES, "alpha"), {"alpha"}, None),
    "r in degrees": (scaled(DEGREES, "r"), {"r"}, 1 / DEGREES),
    "phi in degrees": (scaled(DEGREES, "phi"), {"phi"}, DEGREES),
    "theta in degrees": (scaled(DEGREES, "theta"), {"theta"}, None),
    "psi in degrees": (scaled(DEGREES, "psi"), {"psi"}, None),
    "attitude in degrees": (scaled(DEGREES, *ATTITUDE), {"phi", "p"}, DEGREES),
    "rates in degrees": (scaled(DEGREES, "p", "q", "r"), {"p", "theta", "q"}, None),
    "forces in g": (scaled(1 / STANDARD_GRAVITY, *FORCES), {"az"}, 1 / STANDARD_GRAVITY),
    "airspeed in knots": (scaled(1 / 0.514444, "airspeed"), {"airspeed"}, 0.514444),
    "airspeed in km/h": (scaled(3.6, "airspeed"), {"airspeed"}, 1 / 3.6),
    "altitude in feet": (scaled(1 / 0.3048, "altitude"), {"altitude"}, 1 / 0.3048),
    "gravity removed": (without_gravity, {"az"}, None),
    "accelerometer z up": (opposite("ay", "az"), {"az", "beta", "ay"}, -1),
    "gyro z up": (opposite("q", "r"), {"q", "r"}, None),
    "attitude z up": (opposite("theta", "psi"), {"theta", "q"}, None),
    "velocity north, west, up": (opposite("v_east", "v_down"), {"east", "v_east", "v_down"}, -1),
    "velocity east, north, up": (east_north_up, {"v_down"}, None),
    "heading from east": (
        lambda flight: flight.assign(psi=np.pi / 2 - flight["psi"]), {"psi", "r"}, None
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_in_its_channel(flight, fault):
    change, channels, slope = FAULTS[fault]
    found = find_contradictions(change(flight))
    assert {name for each in found for name in each.channels} == channels
    assert all(each.quantity == "slope" and abs(each.t) > 5 for each in found)
    if slope is not None:
        assert found[0].slope.value == pytest.approx(slope, rel=0.1)


@pytest.mark.parametrize(
    ("names", "channels"),
    [
        (["p"], {"phi", "p"}),
        (["v_down"], {"altitude", "v_down"}),
        (["altitude"], {"altitude", "v_down"}),
    ],
)
def test_a_lag_is_found(flight, names, channels):
    """Beyond the lags that LagCorrector and holds explain."""
    found = find_contradictions(late(0.8, *names)(flight))
    assert {each.quantity for each in found} == {"lag"}
    assert {name for each in found for name in each.channels} <= channels
    assert abs(found[0].slope.value) == pytest.approx(0.8, abs=0.1)
    assert find_contradictions(late(0.2, *names)(flight)) == []


def test_several_faults_are_all_found(flight):
    found = find_contradictions(scaled(DEGREES, "alpha")(opposite("p", "rudder")(flight)))
    assert {name for each in found for name in each.channels} == {"alpha", "p", "rudder"}


def test_the_message_has_the_numbers(flight):
    (found,) = find_contradictions(scaled(DEGREES, "phi")(flight))
    text = reason_of(found.finding)
    assert text.startswith(
        "phi is probably wrong: the slope of the change of phi over the integral of p is 57."
    )
    assert text.endswith("effective samples)")


def test_the_message_of_gravity_says_what_is_over_what(flight):
    """Forces in g: their integral is a tenth of what the velocity tells."""
    (found,) = find_contradictions(scaled(1 / STANDARD_GRAVITY, *FORCES)(flight))
    assert (
        "the slope of the integral of specific force over the change of velocity less gravity is 0.1"
        in reason_of(found.finding)
    )


def test_the_error_of_a_slope_counts_dependent_samples():
    """Over many pairs of unrelated series with memory, slopes vary as much as their standard deviations say."""
    rng = np.random.default_rng(0)
    scores, sizes = [], []
    for _ in range(200):
        x, y = signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=(2, 2000)))
        slope = estimated_slope(Regression(y, x, [np.ones(2000)]))
        scores.append(slope.value / slope.std)
        sizes.append(slope.n_effective)
    assert np.std(scores) == pytest.approx(1.0, abs=0.2)
    # Bartlett: tau = (1 + rho^2) / (1 - rho^2)
    assert np.mean(sizes) == pytest.approx(2000 * 0.19 / 1.81, rel=0.25)
    assert autocorrelation_time(x) > 10


def test_a_late_servo_is_no_wrong_sign():
    """Rudder of 2 to 3 Hz, servo 0.15 s late, a third of a period: the slope at lag zero has the wrong sign."""
    step, n_late = 0.025, 6
    time = step * np.arange(6000)
    band = signal.butter(2, (2.0, 3.0), "band", fs=1 / step, output="sos")
    rudder = signal.sosfilt(band, np.random.default_rng(0).normal(size=time.size))
    acceleration = -8.0 * np.roll(rudder, n_late)
    r = signal.lfilter([step], [1.0, 0.5 * step - 1.0], acceleration)
    log = pd.DataFrame({"time": time, "airspeed": 15.0, "r": r, "rudder": rudder})[n_late:]
    assert find_contradictions(log) == []
    assert len(find_contradictions(log.assign(rudder=-log["rudder"]))) == 1


RATES = {
    "p q r ax ay az phi theta psi": 10,
    "v_north v_east v_down north east altitude": 5,
    "airspeed alpha beta elevon_left elevon_right rudder throttle": 10,
}
CLEAN = {
    "as logged": lambda flight: flight,
    "vibrating": vibrating,
    "held": lambda flight: held(flight, RATES),
    "vibrating and held": lambda flight: held(vibrating(flight), RATES),
    "slow GPS": lambda flight: held(flight, {"v_north v_east v_down north east altitude": 1}),
    "slow servos": lambda flight: held(flight, {"elevon_left elevon_right rudder throttle": 5}),
    "late GPS": late(0.2, "v_north", "v_east", "v_down"),
    "no vanes": lambda flight: flight.drop(columns=["alpha", "beta"]),
}


@pytest.mark.parametrize("logged", CLEAN)
def test_good_flights_have_none(logged):
    example = load_example_flights()
    for name, table in example.train.groupby("flight"):
        part = table[table["time"] < 120].reset_index(drop=True)
        assert find_contradictions(CLEAN[logged](part)) == [], name


def test_good_flights_together_have_none():
    assert find_contradictions(load_example_flights().train) == []


def test_a_slower_flight_beside_a_fast_one_has_none():
    """25 Hz beside 100 Hz: rolls are as long in both."""
    flights = []
    for step, size in ((0.01, 0.01), (0.04, 1.0)):
        time = step * np.arange(round(60 / step))
        motion = {"phi": size * np.sin(time), "p": size * np.cos(time)}
        still = dict.fromkeys(("q", "r", "theta"), 0.0)
        flights.append(pd.DataFrame({"time": time, "flight": f"{step} s", **motion, **still}))
    assert find_contradictions(pd.concat(flights, ignore_index=True)) == []


def test_noise_has_none(flight):
    rng = np.random.default_rng(0)
    names = [name for name in flight.columns if name not in ("time", "flight")]
    noise = pd.DataFrame({name: 0.1 * rng.normal(size=len(flight)) for name in names})
    level = {"airspeed": 20.0 + noise["airspeed"], "az": -9.8 + noise["az"]}
    assert find_contradictions(noise.assign(time=flight["time"], **level)) == []


def test_missing_samples_change_nothing(flight):
    slow = flight.copy()
    slow.loc[slow.index % 8 > 0, ["v_north", "v_east", "v_down"]] = np.nan
    slow.loc[100:300, "p"] = np.nan
    assert find_contradictions(slow) == []
    (found,) = find_contradictions(opposite("v_down")(slow))
    assert found.channels == ("v_down",)


def test_one_of_several_flights(flight):
    others = [flight.assign(flight=name) for name in ("a", "b", "c")]
    wrong = opposite("beta")(flight).assign(flight="d")
    (found,) = find_contradictions(pd.concat([*others, wrong], ignore_index=True))
    assert (found.flight, found.channels) == ("d", ("beta", "ay"))
    assert reason_of(found.finding).startswith("flight d: beta or ay is probably wrong")


def test_inspect_and_identify_say_so_and_turn_nothing(flight, tmp_path):
    path = tmp_path / "flight.csv"
    opposite("az")(flight).to_csv(path, index=False)
    assert any(remark.startswith("az is probably wrong") for remark in inspect_log(path).remarks)
    table = read_flight(path)
    with pytest.warns(FlightDataWarning, match="Contradiction in the flights: az is probably"):
        usable = usable_flights(
            {"latlon": FlightTable.of(table)}, ["alpha", "q_hat"], ["alpha", "q"]
        )
    assert usable["latlon"]["az"].equals(table["az"])


@pytest.mark.shared
@pytest.mark.parametrize(
    "name",
    ["c172p_test_calm", "c172p_train_latlon", "viggen_uav_train_lateral", "viggen_uav_test_twoalt"],
)
def test_simulated_flights_have_none(shared_data, name):
    table = read_flight(shared_data / "flights" / f"{name}.parquet")
    assert find_contradictions(table) == []
    assert find_contradictions(vibrating(table)) == []


@pytest.mark.shared
def test_the_aileron_of_a_real_flight(shared_data):
    """The identified model of the Ampyx AP2 has Cl_aileron = -0.249: positive rolls left (Malz et al. 2019)."""
    (found,) = find_contradictions(read_flight(shared_data / "ampyx_ap2" / "ampyx_ap2.parquet"))
    assert found.channels == ("aileron",)

"""Contradictions of physics: each fault put into a good flight is named, and a good flight has none."""

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from skdgp._flight.frames import gravity_in_body_axes
from skdgp._flight.physics import G, find_contradictions
from skdgp.datasets import load_example_flights
from skdgp.identification._prepare import usable_flights
from skdgp.io import inspect_log, read_flight
from skdgp.preprocessing import FlightDataWarning

ELEVONS = {"elevon_left", "elevon_right"}
DEGREES = 180 / np.pi


@pytest.fixture(scope="module")
def flight(first_minute):
    """Return 36 s with all controls moving."""
    train = first_minute().train
    return train[(train["flight"] == "latlon") & (train["time"] < 36)].reset_index(drop=True)


def scaled(factor, *names):
    return lambda flight: flight.assign(**{name: factor * flight[name] for name in names})


def opposite(*names):
    return scaled(-1.0, *names)


def controls(elevator, aileron):
    """Return what multiplies the controls by signs, the elevons with them."""

    def change(flight):
        left, right = flight["elevon_left"], flight["elevon_right"]
        symmetric, antisymmetric = elevator * (left + right) / 2, aileron * (left - right) / 2
        return flight.assign(
            elevon_left=symmetric + antisymmetric, elevon_right=symmetric - antisymmetric
        )

    return change


def without_gravity(flight):
    gravity = gravity_in_body_axes(flight["phi"], flight["theta"])
    return flight.assign(
        **{name: flight[name] + gravity[:, k] for k, name in enumerate(("ax", "ay", "az"))}
    )


def east_north_up(flight):
    return flight.assign(
        v_north=flight["v_east"], v_east=flight["v_north"], v_down=-flight["v_down"]
    )


SIGNED = [
    "alpha",
    "beta",
    "p",
    "r",
    "ax",
    "az",
    "phi",
    "psi",
    "v_north",
    "v_down",
    "north",
    "altitude",
    "rudder",
]
FAULTS = {
    **{f"sign of {name}": (opposite(name), {name}, f"sign of {name}") for name in SIGNED},
    "sign of elevator": (controls(-1, 1), ELEVONS, "exchanged and of the wrong sign"),
    "sign of aileron": (controls(1, -1), ELEVONS, "exchanged: exchange left and right"),
    "sign of elevons": (controls(-1, -1), ELEVONS, "sign of elevon_left, elevon_right"),
    **{
        f"{names} in degrees": (scaled(DEGREES, *names.split()), set(names.split()), "in degrees")
        for names in ("alpha", "r", "theta", "psi", "p q r", "phi theta psi")
    },
    "g": (scaled(1 / G, "ax", "ay", "az"), {"ax", "ay", "az"}, "in g: multiply by 9.8066"),
    "knots": (scaled(1 / 0.514444, "airspeed"), {"airspeed"}, "in knots"),
    "km/h": (scaled(3.6, "airspeed"), {"airspeed"}, "in km/h"),
    "feet": (scaled(1 / 0.3048, "altitude"), {"altitude"}, "in feet"),
    "no gravity": (without_gravity, {"ax", "ay", "az"}, "gravity is probably removed"),
    "accelerometer z up": (
        opposite("ay", "az"),
        {"ay", "az"},
        "accelerometer's axes are y left, z up",
    ),
    "gyro z up": (opposite("q", "r"), {"q", "r"}, "gyro's axes are y left, z up"),
    "attitude z up": (
        opposite("theta", "psi"),
        {"theta", "psi"},
        "attitude is of axes y left, z up",
    ),
    "velocity north, west, up": (
        opposite("v_east", "v_down"),
        {"v_east", "v_down"},
        "velocity is north, west, up",
    ),
    "velocity east, north, up": (
        east_north_up,
        {"v_north", "v_east", "v_down"},
        "velocity is probably east, north",
    ),
    "heading from east": (
        lambda t: t.assign(psi=np.pi / 2 - t["psi"]),
        {"psi"},
        "measured from east",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named(flight, fault):
    change, channels, words = FAULTS[fault]
    (found,) = find_contradictions(change(flight))
    assert set(found.channels) == channels
    assert words in found.message


def test_several_faults_are_all_named(flight):
    found = find_contradictions(scaled(DEGREES, "alpha")(opposite("p", "rudder")(flight)))
    assert {name for each in found for name in each.channels} == {"alpha", "p", "rudder"}


def test_a_late_servo_is_no_wrong_sign():
    """Rudder of 2 to 3 Hz, servo 0.15 s late, a third of a period: the slope at lag zero has the wrong sign."""
    step, late = 0.025, 6
    time = step * np.arange(6000)
    band = signal.butter(2, (2.0, 3.0), "band", fs=1 / step, output="sos")
    rudder = signal.sosfilt(band, np.random.default_rng(0).normal(size=time.size))
    acceleration = -8.0 * np.roll(rudder, late)
    r = signal.lfilter([step], [1.0, 0.5 * step - 1.0], acceleration)
    log = pd.DataFrame({"time": time, "airspeed": 15.0, "r": r, "rudder": rudder})[late:]
    assert find_contradictions(log) == []
    assert len(find_contradictions(log.assign(rudder=-log["rudder"]))) == 1


def test_good_flights_have_none():
    example = load_example_flights()
    for table in (example.train, example.test):
        assert find_contradictions(table) == []


def test_noise_has_none(flight):
    rng = np.random.default_rng(0)
    names = [name for name in flight.columns if name not in ("time", "flight")]
    noise = pd.DataFrame({name: 0.1 * rng.normal(size=len(flight)) for name in names})
    level = {"airspeed": 20.0 + noise["airspeed"], "az": -9.8 + noise["az"]}
    assert find_contradictions(noise.assign(time=flight["time"], **level)) == []


@pytest.mark.parametrize(("climb", "n_faults"), [(2.0, 1), (0.005, 0)])
def test_level_flight_tells_nothing_of_the_sign_of_v_down(climb, n_faults):
    time = np.arange(0, 40, 0.05)
    noise = np.random.default_rng(0).normal(size=(2, len(time)))
    table = {
        "time": time,
        "v_down": climb * np.sin(1.3 * time),
        "airspeed": 25 + 0.3 * climb * (np.cos(1.3 * time) + 0.01 * noise[0]),
        "throttle": 0.5 + 0.01 * noise[1],
    }
    assert len(find_contradictions(pd.DataFrame(table))) == n_faults


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
    assert (found.flight, found.channels) == ("d", ("beta",))
    assert str(found).startswith("flight d: the sign of beta")


def test_inspect_and_identify_say_so(flight, tmp_path):
    path = tmp_path / "flight.csv"
    opposite("az", "ay")(flight).to_csv(path, index=False)
    assert any(
        "accelerometer's axes are y left, z up" in remark for remark in inspect_log(path).remarks
    )
    with pytest.warns(FlightDataWarning, match="Contradiction in the flights: .*y left, z up"):
        usable_flights({"latlon": read_flight(path)}, ["alpha", "q_hat"], ["alpha", "q"])


@pytest.mark.shared
@pytest.mark.parametrize(
    "name",
    ["c172p_test_calm", "c172p_train_latlon", "viggen_uav_train_lateral", "viggen_uav_test_twoalt"],
)
def test_simulated_flights_have_none(shared_data, name):
    assert find_contradictions(read_flight(shared_data / "flights" / f"{name}.parquet")) == []


@pytest.mark.shared
def test_the_aileron_of_a_real_flight(shared_data):
    """The identified model of the Ampyx AP2 has Cl_aileron = -0.249: positive rolls left (Malz et al. 2019)."""
    (found,) = find_contradictions(read_flight(shared_data / "ampyx_ap2" / "ampyx_ap2.parquet"))
    assert found.channels == ("aileron",)

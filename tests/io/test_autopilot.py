"""Logs of autopilots into flight tables: every channel comes back, in SI, on one clock, with the signs of a table."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from flight_columns import FORCES, SURFACES
from made_flights import wrapped
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.io import FlightReadError, inspect_log, read_flight
from skdgp.preprocessing import FlightDataWarning

NOTATION = Path(__file__).parents[2] / "docs" / "notation.md"
POINTS = [[1000, -0.5], [2000, 0.5]]
ARDUPILOT_SERVOS = {
    "aileron": {"channel": "RCOU.C1", "points": POINTS},
    "elevator": {"channel": "RCOU.C2", "points": [[1000, 0.5], [2000, -0.5]]},
    "rudder": {"channel": "RCOU.C4", "points": POINTS},
}
# Interpolation between samples of a slow channel, and the resolution of centidegrees and
# microseconds of pulses.
TOLERANCE = {
    "airspeed": 2e-3,
    "altitude": 0.05,
    "density": 1e-4,
    "propeller_speed": 0.1,
    "wind_north": 5e-3,
}
LOOSE = 2e-3


@pytest.fixture
def whole(read):
    """Read all of a log, not the flights alone."""
    return partial(read, airborne=False)


def assert_is(table, flight, names):
    inside = table[table.time.between(flight.BEGIN + 1.0, flight.END - 1.0)]
    for name in names:
        error = inside[name] - flight[name](inside.time)
        if name == "psi":
            assert_allclose(table.psi, 0.0, atol=np.pi)
            error = wrapped(error)
        bound = max(TOLERANCE.get(name, LOOSE), 5e-4 * abs(flight.SIZES[name][1]))
        assert_allclose(error, 0.0, atol=bound, err_msg=name)


class TestEveryChannelComesBack:
    def test_px4(self, read, px4, px4_servos, flight):
        table = read(px4, "sortie.ulg", servos=px4_servos)
        names = set(flight.SIZES) - {"elevon_left", "elevon_right"}
        assert set(table.columns) == names | {"time", "flight"}
        assert table.notna().all(axis=None)
        assert_is(table, flight, names)
        assert (table.flight == "sortie").all()
        assert_allclose(np.diff(table.time), 0.02, rtol=1e-9)

    def test_ardupilot(self, read, ardupilot, flight):
        """But alpha and beta, which its message AOA has by computation, without gusts: no vane measured them."""
        table = read(ardupilot, "sortie.BIN", servos=ARDUPILOT_SERVOS)
        names = set(flight.SIZES) - {"elevon_left", "elevon_right", "alpha", "beta"}
        assert set(table.columns) == names | {"time", "flight"}
        assert_is(table, flight, names)

    def test_sources_are_told(self, read, px4, ardupilot):
        table = read(px4)
        assert not set(SURFACES) & set(table)  # without a servo file
        sources = table.attrs["sources"]
        assert sources["p"] == "vehicle_angular_velocity.xyz[0] xyz[1] xyz[2]"
        assert sources["airspeed"] == "airspeed.true_airspeed_m_s"
        sources = read(ardupilot, "log.bin").attrs["sources"]
        assert sources["airspeed"] == "ARSP.Airspeed (equivalent; true by density)"


class TestChoices:
    t = 1.0 + np.arange(600) / 50.0

    @pytest.fixture
    def log(self, ulog):
        """Return a log of gyros."""
        return ulog().gyros(self.t, np.sin(self.t))

    def test_samples_that_are_not_valid_are_missing(self, whole, log):
        t = self.t
        valid = ("bool", (t < 5) | (t > 6))
        velocity = {"vx": np.sin(t), "vy": np.cos(t), "vz": 0 * t}
        log.topic("vehicle_local_position", t, **velocity, v_xy_valid=valid)
        table = whole(log)
        lost = (table.time > 4.99) & (table.time < 6.01)
        assert table.v_north[lost].isna().all()
        assert table.v_north[~lost & (table.time < 12.9)].notna().all()
        assert table.p.notna().all()

    def test_density_of_the_standard_atmosphere_where_only_altitude_is_known(self, whole, log):
        table = whole(log.topic("vehicle_global_position", self.t, alt=1000.0))
        assert_allclose(table.density.median(), 1.1117, rtol=0, atol=2e-4)
        assert "standard atmosphere" in table.attrs["sources"]["density"]

    def test_what_no_aircraft_can_feel_is_not_taken(self, whole, log):
        log.topic("vehicle_acceleration", self.t, xyz=np.full((600, 3), 5000.0))
        with pytest.warns(FlightDataWarning, match=r"cannot be ax ay az: 100 % is impossible"):
            assert "ax" not in whole(log)

    def test_sensors_count_from_when_they_sampled(self, whole, ulog):
        """The message comes 40 ms later; what was sent to a servo counts from when it was sent."""
        t = self.t
        late = {"timestamp_sample": ("uint64_t", np.round((t - 0.04) * 1e6))}
        log = ulog().gyros(t, np.sin(t - 0.04), **late)
        log.topic("actuator_motors", t, **late, control=("float[1]", np.sin(t) ** 2))
        table = whole(log).iloc[10:-10]
        assert_allclose(table.p, np.sin(table.time), atol=1e-3)
        assert_allclose(table.throttle, np.sin(table.time) ** 2, atol=1e-3)

    @pytest.mark.parametrize("late", [1.5, 20.0, 1000.0])
    @pytest.mark.parametrize("is_told", [True, False])
    def test_a_topic_that_is_wholly_late(self, told, ulog, late, is_told):
        """It counts from when it was sampled, where the log says so; one that ends behind the gyros is told."""
        t = self.t
        sampled = {"timestamp_sample": ("uint64_t", np.round(t * 1e6))} if is_told else {}
        log = ulog().gyros(t, np.sin(t))
        log.topic("airspeed", t + late, true_airspeed_m_s=18 + np.sin(t), **sampled)
        if is_told:
            words = f"airspeed is published {late} s after it was sampled"
            airspeed = told(words, log, airborne=False).set_index("time").airspeed.loc[0.5:]
            assert_allclose(airspeed.loc[:12], 18 + np.sin(airspeed.loc[:12].index), atol=1e-3)
        else:
            told("ends first: .* time stamps of others are late .airspeed", log, airborne=False)

    def test_slow_gyros_end_up_to_a_step_earlier(self, whole, ulog):
        """Which is no lateness of others: nothing is told."""
        slow = np.arange(10, 39.9, 1 / 1.5)
        fast = np.arange(10, 40, 0.05)
        assert fast[-1] - slow[-1] > 0.6
        log = ulog().gyros(slow, np.sin(slow)).topic("airspeed", fast, true_airspeed_m_s=fast)
        table = whole(log)
        assert_allclose(table.airspeed, table.time, atol=1e-3)

    def test_a_time_of_sampling_that_stands_still_is_none(self, whole, ulog):
        """As of a field that nobody writes to."""
        t = self.t
        stuck = {"timestamp_sample": ("uint64_t", np.full(len(t), 1e6))}
        table = whole(ulog().gyros(t, np.sin(t), **stuck))
        assert_allclose(table.p, np.sin(table.time), atol=2e-3)

    def test_signs_of_quaternions_do_not_matter(self, whole, ulog):
        half = 0.1 * self.t
        signs = default_rng(1).choice([-1.0, 1.0], (600, 1))
        q = signs * np.column_stack([np.cos(half), np.sin(half), 0 * half, 0 * half])
        table = whole(ulog().topic("vehicle_attitude", self.t, q=q))
        assert_allclose(table["phi"], 0.2 * table["time"], atol=1e-3)

    def test_another_instance_where_the_first_is_not_there(self, whole, ulog):
        log = ulog().gyros(self.t, self.t, instance=2)
        assert whole(log).attrs["sources"]["p"].split(".")[0] == "vehicle_angular_velocity#2"

    def test_the_servo_file_is_believed_before_the_rules(self, whole, log):
        log.topic("actuator_motors", self.t, control=np.tile([0.0, 0.7], (600, 1)))
        servos = {"throttle": {"channel": "actuator_motors.control[1]", "points": [[0, 0], [1, 1]]}}
        assert_allclose(whole(log, servos=servos).throttle.median(), 0.7)


def spans(table):
    """Return beginning and end of each flight, by its name."""
    return table.groupby("flight").time.agg(["min", "max"])


class TestFlights:
    t = np.arange(0, 60, 0.05)

    @pytest.fixture
    def log(self, ulog):
        """Return a function to a log of gyros and airspeed."""

        def log(airspeed=20.0, t=self.t, **parameters):
            log = ulog(**parameters).gyros(t, t % 1)
            return log.topic("airspeed", t, true_airspeed_m_s=np.broadcast_to(airspeed, len(t)))

        return log

    def test_stretches_in_the_air_become_flights(self, read, log):
        t = np.arange(0, 120, 0.05)
        airspeed = np.where((t > 20) & (t < 50) | (t > 70) & (t < 100), 15.0, 1.0)
        airspeed[(t > 30) & (t < 31)] = 2.0  # a lull
        airspeed[(t > 110) & (t < 112)] = 30.0  # a gust on the ground
        found = spans(read(log(airspeed, t)))
        assert found.index.tolist() == ["log", "log#2"]
        assert_allclose(found, [[20.05, 49.95], [70.05, 99.95]], atol=0.051)
        assert len(read(log(airspeed, t), airborne=False)) == len(t)

    def test_a_leap_of_the_clock_ends_a_flight(self, read, log):
        t = self.t + np.where(self.t > 30, 3600, 0)
        assert_allclose(spans(read(log(t=t))), [[0, 30], [3630.05, 3659.95]], atol=0.051)

    def test_rows_at_the_ends_that_lack_a_slow_channel_are_left_out(self, read, log):
        """A vane that comes later is no reason."""
        log = log()
        rpm = self.t[14:-3:10]
        late = self.t[500:]
        log.topic("rpm", rpm, indicated_frequency_rpm=rpm)
        table = read(log.topic("airflow_aoa", late, aoa_rad=late / 100))
        assert table.propeller_speed.notna().all()
        assert_allclose(table.time.min(), 0.7)
        assert_allclose(table.alpha.isna().sum(), 500 - 14, rtol=0, atol=1)

    @pytest.mark.parametrize(("options", "least"), [({}, 14.0), ({"airborne": 5.0}, 5.0)])
    def test_threshold_is_the_autopilots_or_the_callers(self, read, log, options, least):
        table = read(log(self.t / 2, FW_AIRSPD_MIN=20.0), **options)
        assert_allclose(table.airspeed.min(), least, rtol=0, atol=0.05)

    def test_a_flight_that_was_never_armed_is_told(self, told, log):
        log = log().topic("vehicle_status", [0.0, 30.0], arming_state=("uint8_t", 1))
        told("never armed", log)

    def test_landed_is_not_flight(self, read, log):
        log = log().topic("vehicle_land_detected", [0.0, 30.0], landed=("bool", [1, 0]))
        assert_allclose(read(log).time.min(), 30.0, rtol=0, atol=0.05)

    def test_a_dead_airspeed_sensor_hides_no_flight(self, read, log):
        """It shows 0 throughout, at a ground speed of 15 m/s from 20 s on."""
        north = np.where(self.t > 20, 15.0, 1.0)
        log = log(0.0).topic("vehicle_local_position", self.t, vx=north, vy=0 * north, vz=0 * north)
        assert_allclose(read(log).time.min(), 20.0, rtol=0, atol=0.1)

    def test_rolling_on_the_ground_is_not_flight(self, read, log):
        """Fast and no longer reported as landed from 10 s, half a metre above the runway at 22.5 s."""
        log = log().topic("vehicle_land_detected", [0.0, 10.0], landed=("bool", [1, 0]))
        down = -100.0 - 0.2 * np.maximum(self.t - 20, 0)
        log.topic("vehicle_local_position", self.t, x=0 * down, y=0 * down, z=down)
        assert_allclose(read(log).time.min(), 22.5, rtol=0, atol=0.1)

    def test_an_airspeed_sensor_that_dies_ends_no_flight(self, read, log):
        """It stops at 40 s, at a ground speed of 15 m/s throughout."""
        measured = np.where(self.t < 40, 20.0 + np.sin(self.t), np.nan)
        north = np.full(len(self.t), 15.0)
        log = log(measured).topic("vehicle_local_position", self.t, vx=north, vy=north, vz=north)
        table = read(log)
        assert_allclose(table.time.max(), self.t[-1], rtol=0, atol=0.1)
        assert table.airspeed[table.time > 40.1].isna().all()


class TestRefusals:
    t = np.arange(0, 30, 0.02)

    def test_a_bench_log(self, refused, ulog):
        log = ulog().gyros(self.t, 0.0)
        log.topic("airspeed", self.t, true_airspeed_m_s=0.5)
        refused("airspeed up to 0.5 m/s, where a flight stays above 8 m/s", log)

    def test_nothing_of_a_flight(self, refused, ulog):
        refused(
            r"no message of a flight.*log these topics",
            ulog().topic("cpuload", self.t, load=np.zeros(1500)),
        )

    def test_a_log_under_the_suffix_of_another_autopilot(self, refused, px4, ardupilot):
        words = "A log of PX4 is named .ulg, one of ArduPilot .bin"
        refused(words, px4, "log.bin")
        refused(words, ardupilot, "log.ulg")

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"airborne": -1.0}, "airborne=-1.0, but expected True"),
            ({"servos": {"canard": {}}}, "'canard' in the servo file"),
            (
                {"servos": {"rudder": {"channel": "RCOU.C4", "points": [[0, 0], [1, 1]]}}},
                r"'RCOU.C4' for rudder, but the log has no such field: expected one of .*'actuator_outputs'",
            ),
        ],
    )
    def test_options_that_make_no_sense(self, refused, px4, tmp_path, options, message):
        assert str(tmp_path / "log.ulg") in refused(message, px4, **options)


class TestWithoutAnAccelerometer:
    @pytest.fixture
    def log(self, ulog, flight):
        t = flight.time(20)
        log = ulog().gyros(t, 0.0).topic("airspeed", t, true_airspeed_m_s=20.0)
        log.topic("vehicle_attitude", t, q=np.roll(flight.attitude(t).as_quat(), 1, axis=1))
        velocity = zip(("vx", "vy", "vz"), flight.velocity(t).T, strict=True)
        return log.topic("vehicle_local_position", t, **dict(velocity))

    def test_specific_force_is_that_of_velocity_and_attitude(self, read, log, flight):
        table = read(log)
        inside = table[table.time.between(flight.BEGIN + 2, flight.END - 2)]
        assert_allclose(inside[FORCES], flight.sensed(inside.time)[FORCES], atol=0.03)
        source = "velocity and attitude, as no accelerometer is of use"
        assert table.attrs["sources"]["az"] == source

    def test_an_accelerometer_has_priority(self, read, log, flight):
        time = flight.time(20)
        log.topic("vehicle_acceleration", time, xyz=np.tile([0, 0, -9.0], (len(time), 1)))
        assert_allclose(read(log).az.median(), -9.0)


class TestRules:
    @pytest.mark.parametrize("suffix", [".ulg", ".bin", ".tlog"])
    def test_columns_are_words_of_the_vocabulary(self, suffix, px4, ardupilot, tlog, parse):
        content = {".ulg": px4, ".bin": ardupilot, ".tlog": b"".join(tlog)}[suffix]
        known = {*re.findall(r"`(\w+)`", NOTATION.read_text(encoding="utf-8"))}
        for rule in parse(content, f"log{suffix}").rules:
            columns = rule.columns.split()
            assert {*columns} <= known | {"qw", "qx", "qy", "qz", "equivalent_airspeed"}
            # each engine has a field
            n_fields = 1 if rule.engines else len(rule.fields.split())
            converted = rule.convert(np.ones((3, n_fields)))
            assert np.shape(converted) == (3, len(columns)), rule.topic


@pytest.mark.shared
class TestSharedLogs:
    @pytest.fixture
    def table(self, shared_data):
        path = shared_data / "logs" / "fw_system_id_log_altitude_1_HITL.ulg"
        with pytest.warns(FlightDataWarning, match="39 % is impossible"):
            return read_flight(path)

    def test_a_flight(self, table):
        """The first seconds are on the runway; the integers of the accelerometer overflowed."""
        assert 48 < np.ptp(table.time) < 51
        assert 20 < table.airspeed.mean() < 27
        assert "velocity and attitude" in table.attrs["sources"]["ax"]
        assert_allclose(table.az.median(), -9.8, rtol=0, atol=0.1)


def test_a_bench_log_of_px4_is_no_flight_but_can_be_read(vtol_bench):
    with pytest.raises(FlightReadError, match="no flight was found"):
        read_flight(vtol_bench)
    assert "a flight stays above" in inspect_log(vtol_bench).remarks[-1]
    with pytest.warns(FlightDataWarning):
        table = read_flight(vtol_bench, airborne=False)
    force = np.linalg.norm(table[FORCES].dropna(), axis=1)
    assert_allclose(np.median(force), 9.7, rtol=0, atol=0.2)


@pytest.fixture
def recorded(whole, dataflash):
    """Return a function from times and a gyro's values, in the order of the file, to the table of the log."""

    def recorded(time, p):
        log = dataflash().gyros(time, p)
        return whole(b"".join([*log.definitions, *(message for _, message in log.data)]), "log.bin")

    return recorded


class TestStamps:
    @pytest.mark.parametrize("wrong", [1e9, 0.0])
    def test_single_wrong_stamps_are_left_out(self, recorded, wrong):
        time = 100 + np.arange(500) * 0.02
        stamps = time.copy()
        stamps[[3, 77, 199, 499]] = wrong
        with pytest.warns(FlightDataWarning, match="4 of 500 messages have a time that cannot be"):
            table = recorded(stamps, time - 100)
        assert_allclose(table["p"], table["time"] - 100, atol=1e-5)

    @pytest.mark.parametrize(
        ("rate", "n_before", "n_after", "wrong"),
        [
            (50, 30, 1000, None),
            (50, 1000, 40, None),
            (4, 400, 400, None),
            (2, 400, 400, None),
            *((50, 2000, 2000, place) for place in (1940, 1995, 2005, 2060)),
        ],
    )
    def test_a_clock_that_was_set_back_goes_on_behind_a_pause(
        self, recorded, rate, n_before, n_after, wrong
    ):
        """To 2 s; all messages stay but one near the restart that may have a wrong time."""
        clock = np.append(500 + np.arange(n_before) / rate, 2 + np.arange(n_after) / rate)
        stamps = clock.copy()
        if wrong:
            stamps[wrong] = 5000.0
        with pytest.warns(FlightDataWarning, match="clock was set back") as warned:
            table = recorded(stamps, clock / 100)
        told = str(warned[0].message)
        assert ("; 1 of 4000 messages" in told) == bool(wrong)
        (shift,) = re.findall(r"what follows has times (.*) s later", told)
        is_later = table.time.diff().gt(59).cumsum()
        assert is_later.value_counts(sort=False).tolist() == [n_before, n_after]
        assert_allclose(table.time - 100 * table.p, float(shift) * is_later, atol=0.1)

    def test_a_clock_that_was_set_back_by_little_is_told(self, recorded):
        times = np.append(np.arange(0, 20, 0.02), np.arange(12, 32, 0.02))
        with pytest.warns(
            FlightDataWarning, match=r"the clock goes back by 8\.0 s in IMU: what follows is mixed"
        ):
            recorded(times, 0 * times)

    @pytest.mark.parametrize(
        ("kind", "name", "head"), [("ulog", "distance_sensor", 5), ("dataflash", "RFND", 3)]
    )
    def test_messages_of_a_topic_without_times_are_left_out(self, told, request, kind, name, head):
        """The sensor of distances of a simulator has the stamp 0."""
        time = np.arange(10, 50, 0.02)
        log = request.getfixturevalue(kind)().gyros(time, 1.0).topic(name, time[::10], x=0.0)
        for k in range(len(time), len(log.data)):
            place, message = log.data[k]
            log.data[k] = place, message[:head] + bytes(8) + message[head + 8 :]
        words = r"200 of 2200 messages have a time that cannot be \(200 of "
        told(f"{words}{name}", log, airborne=False)

    def test_messages_out_of_order_are_sorted(self, recorded):
        time = np.arange(500) * 0.02
        time[[100, 101, 102]] = time[[102, 100, 101]]
        table = recorded(time, time)
        assert_allclose(table["p"], table["time"], atol=1e-5)

    @pytest.mark.parametrize("n", [2, 30, 60])
    def test_a_short_log_far_from_zero_keeps_its_messages(self, recorded, n):
        assert len(recorded(1e4 + 0.1 * np.arange(n), np.zeros(n))) == n


class TestRates:
    @pytest.fixture
    def sine(self, recorded):
        """Return a function to the middle of a sine that was recorded at a rate, and what it was."""

        def sine(frequency, rate):
            time = np.arange(0, 20, 1 / rate)
            table = recorded(time, np.sin(2 * np.pi * frequency * time))
            table = table[table["time"].between(2, 18)]
            return table["p"], np.sin(2 * np.pi * frequency * table["time"])

        return sine

    def test_what_the_new_rate_carries_passes_without_delay(self, sine):
        assert_allclose(*sine(3.0, rate=400.0), atol=2e-3)

    @pytest.mark.parametrize("frequency", [45.0, 55.0, 130.0])
    def test_what_it_cannot_carry_is_not_folded_back(self, sine, frequency):
        p, _ = sine(frequency, rate=400.0)
        assert_allclose(p, 0.0, atol=0.01)

    def test_slower_channels_are_interpolated(self, sine):
        """The error of linear interpolation is at most step^2 / 8 times the second derivative."""
        p, expected = sine(0.5, rate=10.0)
        assert_allclose(p, expected, rtol=0, atol=1.01 * (2 * np.pi * 0.5 * 0.1) ** 2 / 8)

    @pytest.mark.parametrize("rate", [10.0, 50.0, 400.0])
    def test_gaps_stay_and_a_lost_sample_is_bridged(self, recorded, rate):
        time = np.arange(0, 10, 1 / rate)
        logged = (time < 3) | (time > 5)
        logged[np.searchsorted(time, 8.0)] = False
        time = time[logged]
        table = recorded(time, time)
        before = time[time < 4].max() + 1e-9
        inside = table["time"].between(before, time[time > 4].min() - 1e-9)
        assert table["p"][inside].isna().all()
        assert_allclose(table["p"][~inside], table["time"][~inside], atol=1e-5)


class TestOnTheGround:
    t = np.arange(0, 30, 0.05)

    @pytest.fixture
    def log(self, ulog):
        log = ulog().topic("airspeed", self.t, true_airspeed_m_s=20.0)
        log.gyros(self.t, np.sin(self.t))
        return log.topic("vehicle_land_detected", [0.0, 15.0], landed=("bool", [1, 1]))

    def test_what_the_autopilot_says_comes_first(self, refused, log):
        refused("reports to be on the ground in 100 % of the rows", log)

    def test_a_speed_finds_the_flight_of_the_summary_too(self, write, log):
        path = write(log)
        assert inspect_log(path).flights.empty
        assert len(inspect_log(path, airborne=6.0).flights) == 1

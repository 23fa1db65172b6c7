"""Logs of autopilots into flight tables: every channel comes back, in SI, on one clock, with the signs of a table."""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.io import AUTOPILOTS, EQUIVALENT, QUATERNION, FlightReadError, read_flight
from skdgp.preprocessing import FlightCheck, FlightDataWarning

NOTATION = Path(__file__).parents[2] / "docs" / "notation.md"
SURFACES = ("aileron", "elevator", "rudder")
POINTS = [[1000, -0.5], [2000, 0.5]]
PX4_SERVOS = {
    name: {"channel": f"actuator_outputs.output[{n}]", "points": POINTS}
    for n, name in enumerate(SURFACES)
}
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
def write(tmp_path):
    """Write a log under a name; return the path."""

    def to(name, content):
        path = tmp_path / name
        path.write_bytes(bytes(content))
        return path

    return to


def wrapped(angles):
    return (np.asarray(angles) + np.pi) % (2 * np.pi) - np.pi


def assert_is(table, flight, names):
    time = table.time.to_numpy()
    inside = (time > flight.BEGIN + 1.0) & (time < flight.END - 1.0)
    for name in names:
        error = table[name].to_numpy()[inside] - flight[name](time[inside])
        if name == "psi":
            assert table.psi.abs().max() <= np.pi
            error = wrapped(error)
        bound = max(TOLERANCE.get(name, LOOSE), 5e-4 * abs(flight.SIZES[name][1]))
        assert np.abs(error).max() < bound, f"{name}: {np.abs(error).max()}"


class TestEveryChannelComesBack:
    def test_px4(self, write, px4, flight):
        table = read_flight(write("sortie.ulg", px4), servos=PX4_SERVOS)
        names = set(flight.SIZES) - {"elevon_left", "elevon_right"}
        assert set(table.columns) == names | {"time", "flight"}
        assert table.notna().all(axis=None)
        assert_is(table, flight, names)
        assert (table.flight == "sortie").all()
        assert_allclose(np.diff(table.time), 0.02, rtol=1e-9)

    def test_ardupilot(self, write, ardupilot, flight):
        table = read_flight(write("sortie.BIN", ardupilot), servos=ARDUPILOT_SERVOS)
        names = set(flight.SIZES) - {"elevon_left", "elevon_right"}
        assert set(table.columns) == names | {"time", "flight"}
        assert_is(table, flight, names)

    def test_sources_are_told(self, write, px4, ardupilot):
        sources = read_flight(write("a.ulg", px4)).attrs["sources"]
        assert sources["p"] == "vehicle_angular_velocity.xyz[0..2]"
        assert sources["airspeed"] == "airspeed.true_airspeed_m_s"
        sources = read_flight(write("a.bin", ardupilot)).attrs["sources"]
        assert sources["airspeed"] == "ARSP.Airspeed (equivalent; true by density)"
        assert "not measured by a vane" in sources["alpha"]

    def test_no_surface_without_a_servo_file(self, write, px4):
        assert not set(SURFACES) & set(read_flight(write("a.ulg", px4)).columns)


class TestChoices:
    def time(self, rate=50.0, n=600):
        return 1.0 + np.arange(n) / rate

    def gyro(self, log, t):
        return log.topic("vehicle_angular_velocity", t, xyz=np.column_stack([np.sin(t), t, t]))

    def test_a_slow_source_gives_way_to_a_fast_one(self, write, ulog):
        t, slow = self.time(), self.time(1.0, 12)
        log = self.gyro(ulog(), t)
        log.topic("airspeed_validated", slow, true_airspeed_m_s=30.0)
        log.topic("airspeed", t, true_airspeed_m_s=20.0)
        assert read_flight(write("a.ulg", log), airborne=False).airspeed.median() == 20.0

    def test_samples_that_are_not_valid_are_missing(self, write, ulog):
        t = self.time()
        log = self.gyro(ulog(), t)
        valid = (t < 5) | (t > 6)
        log.topic(
            "vehicle_local_position",
            t,
            vx=np.sin(t),
            vy=np.cos(t),
            v_xy_valid=("bool", valid),
        )
        table = read_flight(write("a.ulg", log), airborne=False)
        lost = (table.time > 4.99) & (table.time < 6.01)
        assert table.v_north[lost].isna().all()
        assert table.v_north[~lost & (table.time < 12.9)].notna().all()
        assert table.p.notna().all()

    def test_another_instance_where_the_first_is_not_there(self, write, ulog):
        t = self.time()
        log = ulog().topic(
            "vehicle_angular_velocity", t, instance=2, xyz=np.column_stack([t, t, t])
        )
        table = read_flight(write("a.ulg", log), airborne=False)
        assert table.attrs["sources"]["p"].startswith("vehicle_angular_velocity#2.")

    def test_density_of_the_standard_atmosphere_where_only_altitude_is_known(self, write, ulog):
        t = self.time()
        log = self.gyro(ulog(), t).topic("vehicle_global_position", t, alt=1000.0)
        table = read_flight(write("a.ulg", log), airborne=False)
        assert table.density.median() == pytest.approx(1.1117, abs=2e-4)
        assert "standard atmosphere" in table.attrs["sources"]["density"]

    def test_what_no_aircraft_can_feel_is_not_taken(self, write, ulog):
        t = self.time()
        log = self.gyro(ulog(), t)
        log.topic("vehicle_acceleration", t, xyz=np.full((600, 3), 5000.0))
        with pytest.warns(FlightDataWarning, match=r"cannot be ax, ay, az: 100 % is impossible"):
            table = read_flight(write("a.ulg", log), airborne=False)
        assert "ax" not in table

    def test_sensors_count_from_when_they_sampled(self, write, ulog):
        """The message comes 40 ms later; what was sent to a servo counts from when it was sent."""
        t = self.time()
        late = {"timestamp_sample": ("uint64_t", np.round((t - 0.04) * 1e6))}
        log = ulog().topic(
            "vehicle_angular_velocity",
            t,
            **late,
            xyz=np.column_stack([np.sin(t - 0.04)] * 3),
        )
        log.topic("actuator_motors", t, **late, control=("float[1]", np.sin(t) ** 2))
        table = read_flight(write("a.ulg", log), airborne=False).iloc[10:-10]
        assert_allclose(table.p, np.sin(table.time), atol=1e-3)
        assert_allclose(table.throttle, np.sin(table.time) ** 2, atol=1e-3)

    def test_the_servo_file_is_believed_before_the_rules(self, write, ulog):
        t = self.time()
        log = self.gyro(ulog(), t).topic(
            "actuator_motors", t, control=np.column_stack([0 * t, 0 * t + 0.7])
        )
        servos = {"throttle": {"channel": "actuator_motors.control[1]", "points": [[0, 0], [1, 1]]}}
        assert read_flight(
            write("a.ulg", log), airborne=False, servos=servos
        ).throttle.median() == pytest.approx(0.7)


class TestFlights:
    def log(self, ulog, airspeed, t, **parameters):
        log = ulog(**parameters).topic(
            "vehicle_angular_velocity", t, xyz=np.column_stack([t, t, t]) % 1
        )
        return log.topic("airspeed", t, true_airspeed_m_s=airspeed)

    def test_stretches_in_the_air_become_flights(self, write, ulog):
        t = np.arange(0, 120, 0.05)
        airspeed = np.where((t > 20) & (t < 50) | (t > 70) & (t < 100), 15.0, 1.0)
        airspeed[(t > 30) & (t < 31)] = 2.0  # a lull
        airspeed[(t > 110) & (t < 112)] = 30.0  # a gust on the ground
        table = read_flight(write("log.ulg", self.log(ulog, airspeed, t)))
        spans = table.groupby("flight").time.agg(["min", "max"])
        assert spans.index.tolist() == ["log", "log#2"]
        assert_allclose(spans.to_numpy(), [[20.05, 49.95], [70.05, 99.95]], atol=0.051)
        assert len(
            read_flight(write("log.ulg", self.log(ulog, airspeed, t)), airborne=False)
        ) == len(t)

    def test_a_leap_of_the_clock_ends_a_flight(self, write, ulog):
        t = np.arange(0, 60, 0.05)
        t[t > 30] += 3600
        table = read_flight(write("log.ulg", self.log(ulog, np.full(t.size, 20.0), t)))
        spans = table.groupby("flight").time.agg(["min", "max"])
        assert_allclose(spans, [[0, 30], [3630.05, 3659.95]], atol=0.051)

    def test_rows_at_the_ends_that_lack_a_slow_channel_are_left_out(self, write, ulog):
        t = np.arange(0, 60, 0.05)
        log = self.log(ulog, np.full(t.size, 20.0), t)
        log.topic("rpm", t[14:-3:10], indicated_frequency_rpm=t[14:-3:10])
        log.topic(
            "airflow_aoa", t[500:], aoa_rad=t[500:] / 100
        )  # a vane that comes later is no reason
        table = read_flight(write("log.ulg", log))
        assert table.propeller_speed.notna().all()
        assert table.time.min() == pytest.approx(0.7)
        assert table.alpha.isna().sum() == pytest.approx(500 - 14, abs=1)

    def test_threshold_is_the_autopilots_or_the_callers(self, write, ulog):
        t = np.arange(0, 60, 0.05)
        path = write("log.ulg", self.log(ulog, t / 2, t, FW_AIRSPD_MIN=20.0))
        assert read_flight(path).airspeed.min() == pytest.approx(14.0, abs=0.05)
        assert read_flight(path, airborne=5.0).airspeed.min() == pytest.approx(5.0, abs=0.05)

    def test_landed_is_not_flight(self, write, ulog):
        t = np.arange(0, 60, 0.05)
        log = self.log(ulog, np.full(t.size, 20.0), t)
        log.topic("vehicle_land_detected", [0.0, 30.0], landed=("bool", [1, 0]))
        assert read_flight(write("log.ulg", log)).time.min() == pytest.approx(30.0, abs=0.05)

    def test_rolling_on_the_ground_is_not_flight(self, write, ulog):
        """Fast and no longer reported as landed from 10 s, half a metre above the runway at 22.5 s."""
        t = np.arange(0, 60, 0.05)
        log = self.log(ulog, np.full(t.size, 20.0), t)
        log.topic("vehicle_land_detected", [0.0, 10.0], landed=("bool", [1, 0]))
        log.topic("vehicle_local_position", t, z=-100.0 - 0.2 * np.maximum(t - 20, 0))
        assert read_flight(write("log.ulg", log)).time.min() == pytest.approx(22.5, abs=0.1)

    def test_a_clock_that_was_set_back_makes_flights_of_their_own(self, write, ulog):
        t = np.arange(100, 140, 0.05)
        first = self.log(ulog, np.full(t.size, 20.0), t)
        again = self.log(ulog, np.full(t.size, 25.0), t - 95)
        content = bytes(first) + b"".join(
            message for _, message in sorted(again.data, key=lambda d: d[0])
        )
        with pytest.warns(FlightDataWarning, match=r"set back 1 times \(from 139.9 s to 5.0 s\)"):
            table = read_flight(write("log.ulg", content))
        spans = (
            table.groupby("flight")
            .agg({"time": ["min", "max"], "airspeed": "median"})
            .round(1)
            .to_numpy()
        )
        assert_allclose(spans, [[100.0, 140.0, 20.0], [5.0, 45.0, 25.0]], atol=0.2)


class TestRefusals:
    def test_a_bench_log(self, write, ulog):
        t = np.arange(0, 30, 0.02)
        log = ulog().topic("vehicle_angular_velocity", t, xyz=np.zeros((t.size, 3)))
        log.topic("airspeed", t, true_airspeed_m_s=0.5)
        with pytest.raises(
            FlightReadError,
            match=r"airspeed never stays above 8 m/s in the air \(highest 0.5 m/s\)",
        ):
            read_flight(write("bench.ulg", log))

    def test_nothing_of_a_flight(self, write, ulog):
        log = ulog().topic("cpuload", np.arange(0, 30, 0.02), load=np.zeros(1500))
        with pytest.raises(FlightReadError, match=r"no message of a flight.*log these topics"):
            read_flight(write("log.ulg", log))

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"airborne": -1.0}, "airborne=-1.0, but expected True"),
            ({"servos": {"flap": {}}}, "'flap' in the servo file"),
            (
                {"servos": {"rudder": {"channel": "RCOU.C4", "points": [[0, 0], [1, 1]]}}},
                "no such field: expected one of",
            ),
        ],
    )
    def test_options_that_make_no_sense(self, write, px4, options, message):
        path = write("log.ulg", px4)
        with pytest.raises(FlightReadError, match=message) as error:
            read_flight(path, **options)
        assert str(path) in str(error.value)


class TestWithoutAnAccelerometer:
    """A steady banked turn: specific force is minus gravity over cos(phi) along z, and zero along x and y."""

    def log(self, ulog, **accelerometer):
        t, omega, speed = np.arange(0, 30, 0.05), 0.3, 20.0
        phi, psi = np.arctan(omega * speed / 9.80665), omega * t
        half = np.stack([np.cos(psi / 2), np.sin(psi / 2)])
        q = np.stack([half[0] * np.cos(phi / 2), half[0] * np.sin(phi / 2)], axis=1)
        q = np.column_stack([q, half[1] * np.sin(phi / 2), half[1] * np.cos(phi / 2)])
        log = ulog().topic("airspeed", t, true_airspeed_m_s=speed)
        log.topic("vehicle_angular_velocity", t, xyz=np.zeros((t.size, 3)))
        log.topic("vehicle_attitude", t, q=q)
        velocity = {"vx": speed * np.cos(psi), "vy": speed * np.sin(psi), "vz": np.zeros(t.size)}
        log.topic(
            "vehicle_local_position",
            t,
            **velocity,
        )
        for name, values in accelerometer.items():
            log.topic(name, t, xyz=np.broadcast_to(values, (t.size, 3)))
        return log, 9.80665 / np.cos(phi)

    def test_specific_force_is_that_of_velocity_and_attitude(self, write, ulog):
        log, load = self.log(ulog)
        table = read_flight(write("log.ulg", log))
        found = table[(table.time > 2) & (table.time < 28)][["ax", "ay", "az"]].to_numpy()
        assert_allclose(found, np.broadcast_to([0.0, 0.0, -load], found.shape), atol=0.03)
        assert (
            table.attrs["sources"]["az"] == "velocity and attitude, as no accelerometer is of use"
        )

    def test_an_accelerometer_has_priority(self, write, ulog):
        log, _ = self.log(ulog, vehicle_acceleration=[0.0, 0.0, -9.0])
        assert read_flight(write("log.ulg", log)).az.median() == pytest.approx(-9.0)


class TestRules:
    @pytest.mark.parametrize("suffix", [".ulg", ".bin", ".tlog"])
    def test_columns_are_words_of_the_vocabulary(self, suffix, px4, ardupilot, tlog, tmp_path):
        path = tmp_path / f"log{suffix}"
        path.write_bytes({".ulg": px4, ".bin": ardupilot, ".tlog": b"".join(tlog)}[suffix])
        known = {*re.findall(r"`(\w+)`", NOTATION.read_text(encoding="utf-8"))}
        for rule in AUTOPILOTS[suffix](path).rules:
            assert set(rule.columns) <= known | {*QUATERNION, EQUIVALENT}, rule.topic
            converted = rule.convert(np.ones((3, len(rule.fields))))
            assert np.shape(converted) == (3, len(rule.columns)), rule.topic


@pytest.mark.shared
class TestSharedLogs:
    def test_a_flight(self, shared_data):
        path = shared_data / "logs" / "fw_system_id_log_altitude_1_HITL.ulg"
        with pytest.warns(FlightDataWarning, match="563 of distance_sensor"):
            table = read_flight(path)
        assert 48 < np.ptp(table.time) < 51  # the first seconds are on the runway
        assert 20 < table.airspeed.mean() < 27
        assert (
            "velocity and attitude" in table.attrs["sources"]["ax"]
        )  # the sensor's integers overflowed
        assert table.az.median() == pytest.approx(-9.8, abs=0.1)

    def test_an_airspeed_rounded_to_hundredths_is_not_stuck(self, shared_data):
        with pytest.warns(FlightDataWarning):
            table = read_flight(shared_data / "logs" / "fw_system_id_log_altitude_1_HITL.ulg")
        with pytest.warns(FlightDataWarning, match="v_north is stuck"):  # on the runway
            checked = FlightCheck().fit_transform(table)
        assert checked.airspeed.notna().all()
        quarter = table.tail(len(table) // 4)  # it holds 24.98 m/s for up to 1.7 s, nine times
        with pytest.warns(FlightDataWarning, match="v_down is stuck"):
            checked = FlightCheck().fit_transform(quarter)
        assert checked.airspeed.notna().all()

    def test_bench_logs_are_no_flights_but_can_be_read(self, shared_data):
        for name in ("pyulog_sample_log_small_vtol_bench.ulg", "pyflightcoach_elevator_bench.BIN"):
            with pytest.raises(FlightReadError, match="no flight was found"):
                read_flight(shared_data / "logs" / name)
            with pytest.warns(FlightDataWarning):
                table = read_flight(shared_data / "logs" / name, airborne=False)
            assert np.median(
                np.linalg.norm(table[["ax", "ay", "az"]].dropna(), axis=1)
            ) == pytest.approx(9.7, abs=0.2)


@pytest.fixture
def read(tmp_path, dataflash):
    """Return a function from times and a gyro's values, in the order of the file, to the table of the log."""

    def read(time, p, **options):
        log = dataflash().topic("IMU", time, **{f"Gyr{axis}": ("f", p) for axis in "XYZ"})
        content = [*log.definitions, *(message for _, message in log.data)]
        (tmp_path / "log.bin").write_bytes(b"".join(content))
        return read_flight(tmp_path / "log.bin", airborne=False, **options)

    return read


class TestStamps:
    @pytest.mark.parametrize("wrong", [1e9, 0.0])
    def test_single_wrong_stamps_are_left_out(self, read, wrong):
        time = 100 + np.arange(500) * 0.02
        stamps = time.copy()
        stamps[[3, 77, 199, 499]] = wrong
        with pytest.warns(FlightDataWarning, match="4 of 500 messages have a time that cannot be"):
            table = read(stamps, time - 100)
        assert_allclose(table["p"], table["time"] - 100, atol=1e-5)

    def test_messages_out_of_order_are_sorted(self, read):
        time = np.arange(500) * 0.02
        time[[100, 101, 102]] = time[[102, 100, 101]]
        with pytest.warns(FlightDataWarning, match="1 messages stand out of order"):
            table = read(time, time)
        assert_allclose(table["p"], table["time"], atol=1e-5)

    @pytest.mark.parametrize("n", [2, 30, 60])
    def test_a_short_log_far_from_zero_keeps_its_messages(self, read, n):
        assert len(read(1e4 + 0.1 * np.arange(n), np.zeros(n))) == n


class TestRates:
    def sine(self, read, frequency, own):
        time = np.arange(0, 20, 1 / own)
        table = read(time, np.sin(2 * np.pi * frequency * time))
        table = table[(table["time"] > 2) & (table["time"] < 18)]
        return table["p"], np.sin(2 * np.pi * frequency * table["time"])

    def test_what_the_new_rate_carries_passes_without_delay(self, read):
        p, expected = self.sine(read, 3.0, own=400.0)
        assert_allclose(p, expected, atol=2e-3)

    @pytest.mark.parametrize("frequency", [45.0, 55.0, 130.0])
    def test_what_it_cannot_carry_is_not_folded_back(self, read, frequency):
        p, _ = self.sine(read, frequency, own=400.0)
        assert p.abs().max() < 0.01

    def test_slower_channels_are_interpolated(self, read):
        """The error of linear interpolation is at most step^2 / 8 times the second derivative."""
        p, expected = self.sine(read, 0.5, own=10.0)
        assert (p - expected).abs().max() < 1.01 * (2 * np.pi * 0.5 * 0.1) ** 2 / 8

    @pytest.mark.parametrize("own", [10.0, 50.0, 400.0])
    def test_gaps_stay_and_a_lost_sample_is_bridged(self, read, own):
        time = np.arange(0, 10, 1 / own)
        logged = (time < 3) | (time > 5)
        logged[np.searchsorted(time, 8.0)] = False
        table = read(time[logged], time[logged])
        ends = time[logged][time[logged] < 4].max(), time[logged][time[logged] > 4].min()
        inside = (table["time"] > ends[0] + 1e-9) & (table["time"] < ends[1] - 1e-9)
        assert table["p"][inside].isna().all()
        assert_allclose(table["p"][~inside], table["time"][~inside], atol=1e-5)


def test_signs_of_quaternions_do_not_matter(tmp_path, ulog):
    time = 0.02 * np.arange(600)
    half = 0.1 * time
    signs = default_rng(1).choice([-1.0, 1.0], (600, 1))
    q = signs * np.column_stack([np.cos(half), np.sin(half), 0 * half, 0 * half])
    log = ulog().topic("vehicle_attitude", time, q=q)
    (tmp_path / "log.ulg").write_bytes(bytes(log))
    table = read_flight(tmp_path / "log.ulg", airborne=False)
    assert_allclose(table["phi"], 0.2 * table["time"], atol=1e-3)

"""Several instances of a sensor: the one that the autopilot used longest, else a healthy one; vehicles of all kinds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from skdgp.preprocessing import FlightDataWarning

T = 10 + np.arange(1500) / 50.0
SLOW = T[::5]
TRUE = 18 + np.sin(SLOW)
# rotors lift until then
TRANSITION = 20.0
HOVERS = SLOW < TRANSITION
PLANE = "ArduPlane V4.5.1 (abcdef01)"
MOTORS = {f"SERVO{n}_FUNCTION": 28.0 + n for n in (5, 6, 7, 8)}
RUNNING = dict.fromkeys(("C5", "C6", "C7", "C8"), ("H", 1500))


@pytest.fixture
def plane(dataflash):
    """Return a function to a log of ArduPilot's gyros, with messages and parameters."""
    return lambda *messages, **values: dataflash(*messages, **values).gyros(T, np.sin(T))


@pytest.fixture
def px4(ulog):
    """Return a function to a log of PX4's gyros, with parameters."""
    return lambda **values: ulog(**values).gyros(T, np.sin(T))


def as_vtol(log, state):
    """Return the log of a VTOL in 18 m/s, with its state at each time."""
    log.topic("airspeed", SLOW, true_airspeed_m_s=TRUE)
    log.topic("vehicle_status", SLOW, is_vtol=True)
    return log.topic("vtol_vehicle_status", SLOW, vehicle_vtol_state=("uint8_t", state))


@pytest.fixture
def vtol(plane):
    """Return a writer of a log of a VTOL of ArduPilot in 18 m/s."""

    def vtol(**parameters):
        log = plane(PLANE, Q_ENABLE=1.0, **parameters)
        log.topic("ARSP", SLOW, Airspeed=TRUE, H=("B", 1))
        return log.topic("MODE", SLOW, Mode=("M", 0), ModeNum=("B", np.where(HOVERS, 18, 5)))

    return vtol


@pytest.fixture
def surfaces(read):
    """Read the surfaces of a log in parts of their full throw, without its ends."""
    return lambda log, name=None: read(log, name, servos="full throw", airborne=False)[10:-10]


@pytest.fixture
def allocated(px4, surfaces):
    """Read the surfaces of PX4 by the outputs of control allocation, and parameters."""

    def allocated(*outputs, **parameters):
        control = np.transpose(np.broadcast_arrays(*outputs, SLOW)[:-1])
        return surfaces(px4(**parameters).topic("actuator_servos", SLOW, control=control))

    return allocated


def pulse(part):
    """Return pulses of parts of the full throw."""
    return "H", 1500 + 400 * part


def turned(heading):
    """Return quaternions (w, x, y, z) of headings."""
    return np.roll(Rotation.from_euler("z", heading[:, None]).as_quat(), 1, axis=1)


def assert_is_cut(table):
    """A flight ends where the heading jumps, and in none it does."""
    assert table.flight.nunique() == 2
    steps = np.diff(np.unwrap(table.psi))[np.diff(table.time) < 0.03]
    assert_allclose(steps, 0.0, atol=0.01)


def assert_wave(table, name, size, mean=0.0, atol=0.01):
    """A channel is a sine of the time."""
    assert_allclose(table[name], mean + size * np.sin(table.time), atol=atol)


def assert_is_the_true_airspeed(table):
    assert_wave(table[10:-10], "airspeed", 1.0, mean=18.0, atol=0.02)


def airspeed_of(log, number, airspeed, health=1, time=SLOW, **fields):
    """Add the airspeed of an instance of ArduPilot's sensors, and its health."""
    instance = {"I": ("B", number), "Airspeed": airspeed, "H": ("B", health)}
    return log.topic("ARSP", time + 1e-3 * number, **instance, **fields)


class TestArduPilot:
    def test_a_healthy_sensor_of_another_message_stands_in_for_a_failed_one(self, told, plane):
        log = plane().topic("ARSP", SLOW, Airspeed=0.0, H=("B", 0))
        log.topic("ASP2", SLOW + 1e-3, Airspeed=TRUE, H=("B", 1))
        assert_is_the_true_airspeed(told("of 2, the healthiest", log, airborne=False))

    def test_the_primary_counts_while_it_is(self, told, plane):
        """Both are called healthy, and the primary changes at 27 s; the first reads 8 m/s from then on."""
        log = plane()
        for number, airspeed in enumerate((np.where(SLOW > 27, 8.0, 20.0), 20.0)):
            airspeed_of(log, number, airspeed, Pri=("B", SLOW > 27))
        words = r"ARSP: 43 % of the messages are left out.*used another \(ARSP.Pri\)"
        table = told(words, log, airborne=False)
        assert "of 2, used by the autopilot: ARSP.Pri" in table.attrs["sources"]["airspeed"]
        assert_allclose(table.airspeed.dropna(), 20.0)
        assert table.airspeed[table.time < 26.8].notna().all()

    def test_of_lanes_of_the_estimator_that_differ_one_counts(self, told, plane):
        """The second is used from 20 s on."""
        log = plane()
        for lane, mean in enumerate((1.0, 9.0)):
            time = SLOW + lane * 1e-3
            velocity = dict.fromkeys(("VN", "VE", "VD"), mean + 0.1 * np.sin(SLOW))
            log.topic("XKF1", time, C=("B", lane), **velocity)
            log.topic("XKF4", time, C=("B", lane), PI=("B", SLOW > 20))
        table = told(r"XKF1#1.*used by the autopilot: XKF4.PI", log, airborne=False)
        assert table.flight.nunique() == 1
        assert_wave(table[table.time > 20.2].dropna(), "v_north", 0.1, mean=9.0)

    @pytest.mark.parametrize("is_logged", [True, False])
    def test_a_sensor_that_dies_in_flight(self, told, is_logged, plane):
        """It is unhealthy from 30 s on, or no longer logged."""
        lives = SLOW < 30
        rows = slice(None) if is_logged else lives
        log = airspeed_of(plane(), 0, np.where(lives, TRUE, 0.0)[rows], lives[rows], SLOW[rows])
        airspeed_of(log, 1, TRUE)
        table = told(r"of ARSP#1.Airspeed \(of 2, the healthiest", log, airborne=False)
        assert_is_the_true_airspeed(table)

    def test_the_primary_of_the_parameters(self, told, plane):
        """The other one, which is called healthy too, reads less by a third."""
        log = plane(ARSPD_PRIMARY=1.0)
        airspeed_of(airspeed_of(log, 0, 0.7 * TRUE), 1, TRUE)
        table = told("used by the autopilot: ARSPD_PRIMARY", log, airborne=False)
        assert_is_the_true_airspeed(table)

    def test_an_imu_that_the_autopilot_does_not_use(self, told, dataflash):
        log = dataflash(INS_USE=0.0, INS_USE2=1.0)
        for number in range(2):
            log.gyros(T + number * 1e-3, np.sin(T) + number, I=("B", number))
        table = told(r"p q r of IMU#1\.", log, "log.bin", airborne=False)
        assert_wave(table[10:-10], "p", 1.0, mean=1.0)

    @pytest.mark.filterwarnings("ignore:.*of 2, the healthiest")
    @pytest.mark.parametrize("in_use", [0, 1, "blended"])
    def test_of_two_receivers_the_one_in_use_counts(self, read, plane, in_use):
        """Where ArduPilot blends both, the flag U says of neither that it is in use."""
        log = plane()
        for number in range(2):
            fields = {"I": ("B", number), "Status": ("B", 3), "U": ("B", number == in_use)}
            velocity = {"Spd": 20.0 + number, "GCrs": 0.0, "VZ": np.sin(SLOW)}
            log.topic("GPS", SLOW + 1e-3 * number, **fields, **velocity)
        table = read(log, airborne=False)[10:-10]
        assert_allclose(table.v_north, 21.0 if in_use == 1 else 20.0)
        assert_wave(table, "v_down", 1.0, atol=0.02)


class TestPX4:
    @pytest.mark.parametrize("field", ["airspeed_source", "selected_airspeed_index"])
    @pytest.mark.parametrize("source", [0, -1, 4])
    def test_what_no_sensor_measured_is_no_airspeed(self, read, field, source, px4):
        log = px4()
        fields = {"true_airspeed_m_s": TRUE, field: ("int32_t", source)}
        log.topic("airspeed_validated", SLOW, **fields)
        log.topic("airspeed", SLOW, true_airspeed_m_s=2.0)
        with pytest.warns(FlightDataWarning, match=rf"{field} \[{source}\]"):
            assert "airspeed" not in read(log, airborne=False)

    def test_a_sensor_that_fails_in_flight(self, told, px4):
        log = px4()
        source = ("int32_t", np.where(SLOW < 20, 2, 0))
        log.topic("airspeed_validated", SLOW, true_airspeed_m_s=TRUE, airspeed_source=source)
        table = told(r"67 % of the messages .*airspeed_source", log, airborne=False)
        assert table.airspeed[table.time > 20.1].isna().all()
        assert table.airspeed[table.time < 19.9].notna().all()

    @pytest.mark.parametrize(
        ("rates", "chosen"), [((2, 4), 1), ((4, 5), 1), ((4, 4.2), 0), ((6, 50), 0)]
    )
    def test_of_slow_sources_a_clearly_faster_one_counts(self, read, ulog, rates, chosen):
        """Below 5 Hz, which is enough for the preferred one."""
        log = ulog()
        names = {"vehicle_angular_velocity": "xyz", "sensor_combined": "gyro_rad"}
        for number, (topic, field) in enumerate(names.items()):
            time = np.arange(10, 40, 1 / rates[number])
            rate = np.full((len(time), 3), number + 0.1 * np.sin(time)[:, None])
            log.topic(topic, time, **{field: rate})
        assert_allclose(read(log, airborne=False).p, chosen, atol=0.11)

    @pytest.mark.parametrize("begin", [25, 0])
    def test_a_sensor_of_little_confidence(self, told, px4, begin):
        """It fails in flight, or is worse throughout."""
        log = px4()
        fails = begin < SLOW
        confidence = np.where(fails, 0.3 if begin == 0 else 0.0, 1.0)
        first = np.where(fails, 0.7 * TRUE, TRUE)
        log.topic("airspeed", SLOW, true_airspeed_m_s=first, confidence=confidence)
        fields = {"true_airspeed_m_s": TRUE, "confidence": np.ones(len(SLOW))}
        log.topic("airspeed", SLOW, instance=1, **fields)
        table = told(r"airspeed#1\..* \(of 2, the healthiest\)", log, airborne=False)
        assert_is_the_true_airspeed(table)

    def test_a_sensor_that_stands_still_and_begins_a_little_earlier(self, told, ulog):
        time = np.arange(0, 400, 0.2)
        log = ulog().gyros(time, np.sin(time))
        log.topic("airspeed", time, true_airspeed_m_s=18.0)
        later = time[time > 1.5]
        log.topic("airspeed", later, instance=1, true_airspeed_m_s=18 + np.sin(later))
        table = told(r"airspeed#1\..* \(of 2, the healthiest\)", log, airborne=False)
        assert_is_the_true_airspeed(table[table.time > 1.5])


class TestResets:
    """The velocity jumps by 5 m/s, or the heading by 0.6 rad, at 25 s."""

    def test_a_velocity_that_is_reset_is_cut(self, told, px4):
        log = px4()
        late = SLOW >= 25
        velocity = {"vx": TRUE - 5 * ~late, "vy": np.cos(SLOW), "vz": 0 * SLOW}
        log.topic("vehicle_local_position", SLOW, **velocity, vxy_reset_counter=("uint8_t", late))
        table = told(r"a new flight begins, at 25.0 s", log, airborne=False)
        first, second = (flight.v_north.dropna() for _, flight in table.groupby("flight"))
        assert first.max() < 14.1
        assert second.min() > 16.9

    def test_an_attitude_that_is_reset_is_cut(self, told, ulog):
        q = turned(0.1 * T - 0.6 * (T < 25))
        log = ulog().topic("vehicle_attitude", T, q=q, quat_reset_counter=("uint8_t", T >= 25))
        assert_is_cut(told(r"a new flight begins, at 25.0 s", log, airborne=False))

    @pytest.mark.parametrize("suffix", ["ulg", "bin"])
    def test_a_heading_that_jumps_without_the_gyros_is_cut(self, told, ulog, suffix, plane):
        heading = 0.1 * T - 0.6 * (T < 25)
        if suffix == "ulg":
            log = ulog().topic("vehicle_attitude", T, q=turned(heading)).gyros(T, 0.1)
        else:
            log = plane().gyros(T, 0.1)
            angles = {"Roll": ("c", 0), "Pitch": ("c", 0), "Yaw": ("C", np.degrees(heading) % 360)}
            log.topic("ATT", T, **angles)
        assert_is_cut(told(r"a new flight begins, at 25.0 s", log, f"log.{suffix}", airborne=False))


TURNS = 200 * np.pi  # rad/s, of 6000 1/min


def turning(log, number, rpm, time=SLOW):
    """Add the speed of an engine as its controller tells it."""
    return log.topic("ESC", time + 1e-4 * number, Instance=("B", number), RPM=rpm)


# Speeds that a log adds, the one that is read [rad/s], and the times of which it is known [s]
ENGINES = {
    "the one that runs": (
        lambda log: log.topic("RPM", SLOW, rpm1=0.0, rpm2=6000.0), TURNS, (10, 40),
    ),
    "the controller that runs": (
        lambda log: log.topic("ESC1", SLOW, RPM=("e", 0.0)).topic("ESC2", SLOW, RPM=("e", 6000.0)),
        TURNS, (10, 40),
    ),
    "thrust goes with the squares of all": (
        lambda log: turning(turning(log, 0, np.where(SLOW > 25, 0.0, 6000.0)), 1, 6000.0),
        TURNS / np.sqrt(2), (25.2, 40),
    ),
    "an unhealthy sensor does not count": (
        lambda log: log.topic("RPM", SLOW, I=("B", 0), RPM=9000.0, H=("B", 0))
                       .topic("RPM", SLOW + 1e-3, I=("B", 1), RPM=6000.0, H=("B", 1)),
        TURNS, (10, 40),
    ),
    "the only one stands in a glide": (lambda log: turning(log, 0, 0.0), 0.0, (10, 40)),
    # it stands, and tells nothing from 15 s on
    "one whose telemetry ends is chosen by its own mean": (
        lambda log: turning(turning(log, 0, 0.0, SLOW[SLOW < 15]), 1, 6000.0), TURNS, (10, 40),
    ),
    # its last speed is not that of the time afterwards
    **{f"a mean ends with the telemetry of number {silent}": (
        lambda log, silent=silent: turning(
            turning(log, silent, 6000.0, SLOW[SLOW < 30]), 1 - silent, np.where(SLOW < 30, 6000.0, 0.0)
        ),
        TURNS, (10, 30),
    ) for silent in (0, 1)},
}  # fmt: skip


@pytest.mark.parametrize(("add", "speed", "known"), ENGINES.values(), ids=ENGINES)
def test_the_speed_of_the_engines(read, plane, add, speed, known):
    table = read(add(plane()), airborne=False)
    begin, end = known
    found = table[table.propeller_speed.notna() & (table.time > begin)]
    assert_allclose(found.propeller_speed, speed, rtol=1e-6)
    assert_allclose([found.time.min(), found.time.max()], known, atol=0.25)
    assert len(found) > 0.9 * (end - begin) * 50


def test_the_engine_of_eight_controllers_that_runs(read, px4):
    """PX4 logs them in one message, with other fields of each."""
    fields = {}
    for k in range(8):
        fields |= {f"esc[{k}].esc_voltage": 12.0, f"esc[{k}].esc_rpm": 6000.0 * (k == 2)}
    table = read(px4().topic("esc_status", SLOW, **fields), airborne=False)
    assert_allclose(table.propeller_speed.dropna(), TURNS, rtol=1e-6)
    assert table.propeller_speed.notna().mean() > 0.9


def test_engines_that_tell_no_speed_are_remarked(told, plane):
    log = plane().topic("RPM", SLOW, RPM=6000.0, H=("B", 0))
    table = told("RPM: no engine has valid speeds above zero", log, airborne=False)
    assert "propeller_speed" not in table


class TestVehicles:
    @pytest.mark.parametrize(("kind", "axis", "sign"), [(2, 0, 1), (1, 2, -1)])
    def test_a_vtol_is_read_in_forward_flight_alone(self, read, told, kind, axis, sign, px4):
        """It is in transition before 20 s; the thrust of tilted rotors is along -z."""
        log = px4(VT_TYPE=kind)
        thrust = np.zeros((len(T), 3))
        thrust[:, axis] = sign * 0.55
        log.topic("vehicle_thrust_setpoint", T, xyz=thrust)
        as_vtol(log, np.where(SLOW < 20, 1, 4))
        table = told("rotors lift", log)
        assert table.time.min() >= 19.9
        assert_allclose(table.throttle, 0.55, rtol=1e-6)
        assert_allclose(read(log, airborne=False).time.min(), T[0])  # without that warning

    def test_a_v_tail(self, plane, surfaces):
        """left = elevator + rudder, right = elevator - rudder of commands up and right, reversed."""
        log = plane(SERVO5_FUNCTION=79.0, SERVO6_FUNCTION=80.0, SERVO6_REVERSED=1.0)
        up = 0.3 * np.sin(SLOW)
        right = 0.2 * np.cos(SLOW)
        log.topic("RCOU", SLOW, C5=pulse(up + right), C6=pulse(right - up))
        table = surfaces(log)
        assert_wave(table, "elevator", -0.3)
        assert_allclose(table.rudder, -0.2 * np.cos(table.time), atol=0.01)

    def test_a_tailsitter_is_refused(self, refused, ulog):
        log = ulog(VT_TYPE=0).topic("airspeed", SLOW, true_airspeed_m_s=TRUE)
        log.topic("vehicle_status", SLOW, is_vtol=True)
        refused("Got a log of a tailsitter", log)

    @pytest.mark.parametrize(("reverse", "turn"), [(0.0, 1.0), (1.0, -1.0)])
    def test_flaperons(self, reverse, turn, plane, surfaces):
        """left = aileron + flap, right = aileron - flap (ArduPlane/servos.cpp)."""
        log = plane(SERVO1_FUNCTION=24.0, SERVO5_FUNCTION=25.0, SERVO5_REVERSED=reverse)
        aileron = 0.3 * np.sin(SLOW)
        flap = 0.2 * (SLOW > 30)
        log.topic("RCOU", SLOW, C1=pulse(aileron + flap), C5=pulse(turn * (aileron - flap)))
        inside = surfaces(log)
        assert_wave(inside, "aileron", 0.3)
        assert_allclose(inside.flap[inside.time > 30.5], 0.2, atol=0.01)

    @pytest.mark.parametrize("reverse", [0.0, 1.0])
    def test_flaps_and_a_twin_of_ardupilot(self, reverse, plane, surfaces):
        """Ranges from MIN to MAX; throttle +- half the rudder's part (ArduPlane/servos.cpp)."""
        functions = {"SERVO3_FUNCTION": 73.0, "SERVO4_FUNCTION": 74.0, "SERVO6_FUNCTION": 3.0}
        ends = {
            f"SERVO{n}_{end}": us for n in (3, 4, 6) for end, us in (("MIN", 1e3), ("MAX", 2e3))
        }
        log = plane(**functions, **ends, SERVO6_REVERSED=reverse)
        yaw = 0.1 * np.sin(SLOW)
        flap = 0.4
        pulse = 1000 + 1000 * (1 - flap if reverse else flap)
        engines = {"C3": ("H", 1600 + 500 * yaw), "C4": ("H", 1600 - 500 * yaw)}
        log.topic("RCOU", SLOW, **engines, C6=("H", pulse))
        table = surfaces(log)
        assert_allclose(table.flap, flap)
        assert_wave(table, "differential_throttle", 0.1, atol=0.002)

    def test_flaps_and_a_twin_of_px4(self, px4, surfaces):
        """(2 f - 1) CA_SV_CSn_FLAP."""
        scales = {"CA_SV_CS0_FLAP": 0.8, "CA_SV_CS1_FLAP": -0.8}
        sides = {"CA_ROTOR0_PY": -0.5, "CA_ROTOR1_PY": 0.5}
        log = px4(CA_SV_CS0_TYPE=9, CA_SV_CS1_TYPE=10, **sides, **scales)
        log.topic("actuator_servos", SLOW, control=np.tile([-0.16, 0.16], (len(SLOW), 1)))
        log.topic("actuator_motors", SLOW, control=np.tile([0.6, 0.5], (len(SLOW), 1)))
        table = surfaces(log)
        assert_allclose(table.flap, 0.4, atol=1e-6)
        assert_allclose(table.differential_throttle, 0.1, atol=1e-6)

    def test_an_engine_that_is_switched_off(self, read, px4):
        """The right one of two gets no number from 25 s on; the thrust that was asked for stays."""
        log = px4(CA_ROTOR0_PY=-0.5, CA_ROTOR1_PY=0.5)
        log.topic("vehicle_thrust_setpoint", SLOW, xyz=np.outer(np.ones(len(SLOW)), [0.6, 0, 0]))
        motors = np.column_stack([0.6 + 0 * SLOW, np.where(SLOW < 25, 0.6, np.nan)])
        log.topic("actuator_motors", SLOW, control=motors)
        table = read(log, airborne=False)
        early = table[table.time < 24.8]
        late = table[table.time > 25.2]
        assert_allclose(early[["throttle", "differential_throttle"]], [[0.6, 0.0]] * len(early))
        late = late[["throttle", "differential_throttle"]].dropna()
        assert_allclose(late, [[0.3, 0.6]] * len(late), rtol=1e-6)

    @pytest.mark.parametrize("are_silent", [False, True])
    def test_engines_that_lift_a_vtol_do_not_drive_it(self, told, plane, are_silent):
        """Four lift until 20 s, and tell no speed afterwards or zero; then the fifth pushes."""
        log = plane(PLANE, Q_ENABLE=1.0, **MOTORS)
        log.topic("RCOU", SLOW, **dict.fromkeys(RUNNING, ("H", np.where(HOVERS, 1600, 1000))))
        for k in range(5):
            rpm = 6000.0 * ((k < 4) == HOVERS)
            told_rows = HOVERS if are_silent and k < 4 else slice(None)
            turning(log, k, rpm[told_rows], SLOW[told_rows])
        table = told("rotors lift", airspeed_of(log, 0, TRUE))
        late = table.propeller_speed[table.time > 20.5]
        assert_allclose(late, TURNS, rtol=1e-6)
        assert len(late) > 900

    def test_the_motor_that_drives_a_vtol_of_px4(self, told, px4):
        log = as_vtol(px4(), np.where(HOVERS, 3, 4))
        lift = [0.5] * 8 + [np.nan]
        push = [np.nan] * 8 + [0.7]
        log.topic("actuator_motors", SLOW, control=np.where(HOVERS[:, None], lift, push))
        table = told("rotors lift", log)
        assert_allclose(table.throttle[table.time > 20.5], 0.7, rtol=1e-6)

    def test_surfaces_beyond_the_number_of_surfaces_are_none(self, allocated):
        """Their types are left from an earlier configuration, and their outputs are not used."""
        kinds = {"CA_SV_CS0_TYPE": 3, "CA_SV_CS0_TRQ_P": 1.0, "CA_SV_CS1_TYPE": 9}
        table = allocated(0.1 * np.sin(SLOW), np.nan, CA_SV_CS_COUNT=1, **kinds)
        assert {"elevator", "flap"} & {*table} == {"elevator"}

    @pytest.mark.parametrize(("field", "column"), [(4, "flap"), (5, "spoiler"), (6, "spoiler")])
    def test_flaps_and_spoilers_before_a_fixed_mixer(self, field, column, px4, surfaces):
        log = px4()
        controls = np.zeros((len(SLOW), 8))
        controls[:, field] = 0.5 + 0.5 * np.sin(SLOW)
        log.topic("actuator_controls_0", SLOW, control=controls)
        table = surfaces(log)
        assert {"flap", "spoiler"} & {*table} == {column}
        assert_wave(table, column, 0.5, mean=0.5, atol=0.003)


def test_differential_spoilers_are_told(told, plane):
    log = plane(SERVO1_FUNCTION=4.0, SERVO5_FUNCTION=16.0)
    log.topic("RCOU", SLOW, C1=pulse(0.0), C5=pulse(0.0))
    told("differential spoilers move and are not read", log, airborne=False)


@pytest.mark.parametrize("name", ["vehicle_gps_position", "sensor_gps"])
def test_a_gps_without_a_fix_measures_nothing(told, name, px4):
    log = px4()
    has_fix = SLOW > 20
    velocity = dict.fromkeys(("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"), np.where(has_fix, 9.0, 0.0))
    fix = {"fix_type": ("uint8_t", np.where(has_fix, 3, 1))}
    log.topic(name, SLOW, altitude_msl_m=np.where(has_fix, 500.0, 0.0), **velocity, **fix)
    table = told(r"fix_type \[1", log, airborne=False)
    measured = table[["v_north", "altitude"]].dropna()
    assert_allclose(measured, [[9.0, 500.0]] * len(measured))
    assert table.time[measured.index].min() > 20


@pytest.mark.parametrize(
    ("parameters", "outputs"),
    [
        ({"SERVO3_FUNCTION": 73.0, "SERVO4_FUNCTION": 74.0, "Q_TAILSIT_ENABLE": 1.0}, "C3 C4"),
        (MOTORS | {"Q_TAILSIT_MOTMX": 15.0}, "C5 C6 C7 C8"),
        (MOTORS, "C3 C4"),
    ],
    ids=["tailsitter", "tailsitter with motors of a copter", "motors on other outputs"],
)
def test_the_mode_counts_where_no_output_tells(told, vtol, parameters, outputs):
    log = vtol(**parameters)
    log.topic("RCOU", SLOW, **dict.fromkeys(outputs.split(), ("H", 1500)))
    table = told("rotors lift", log)
    assert_allclose(table.time.min(), TRANSITION, rtol=0, atol=0.2)
    assert table.time.max() > 39


def test_a_flight_in_which_rotors_lift_throughout(refused, vtol):
    log = vtol(**MOTORS)
    log.topic("RCOU", SLOW, C1=("H", 1500 + 100 * np.sin(SLOW)), **RUNNING)
    refused("lifted by rotors in 100 % of the rows", log)


def test_a_mode_that_flies_on_wings_at_first(read, vtol):
    """QRTL returns in forward flight: the motors count, which are idle."""
    log = vtol(**MOTORS)
    log.topic("MODE", SLOW + 1e-3, Mode=("M", 0), ModeNum=("B", 21))
    idle = dict.fromkeys(RUNNING, ("H", 1000))
    log.topic("RCOU", SLOW, C1=("H", 1500 + 100 * np.sin(SLOW)), **idle)
    assert len(read(log)) > 0.98 * len(T)

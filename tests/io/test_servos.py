"""Servo files: pulses to angles, refusals, templates, mixtures; the code of the page of logs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.io import FlightReadError, read_flight, read_servos

ENDS = {"channel": "RCOU.C2", "points": [[1100, -0.4], [1500, 0.0], [1900, 0.4]]}


def deflection(values, **entry):
    return read_servos({"elevator": entry})["elevator"].deflection(np.array(values, float))


class TestAngles:
    def test_points_in_any_order_and_lines_beyond(self):
        points = [[1, 0.3], [-1, -0.5], [0, 0.1]]
        found = deflection([-1.5, -1, -0.5, 0.5, 1, 1.5], channel="a.b", points=points)
        assert_allclose(found, [-0.8, -0.5, -0.2, 0.2, 0.3, 0.4])

    def test_no_pulse_is_no_angle_and_pulses_between_the_ends_are(self):
        found = deflection([0.0, 65.0, 1100, 1300, 1500, 1900], **ENDS)
        assert_allclose(found, [np.nan, np.nan, -0.4, -0.2, 0.0, 0.4])
        assert np.isfinite(deflection([0.0], channel="a.b", points=[[-1, -0.4], [1, 0.4]])).all()


class TestRefusals:
    @pytest.mark.parametrize(
        ("name", "entry", "message"),
        [
            ("canard", ENDS, "Got 'canard' in the servo file, but expected one of"),
            (
                "rudder",
                "25",
                'expected the angle at full throw, up to 90 degrees, as in rudder = "25 deg"',
            ),
            ("rudder", {}, "expected a channel and points"),
            ("rudder", ENDS | {"reversed": True}, "expected a channel and points alone"),
            ("rudder", ENDS | {"points": [[1, 0.1], [2, np.nan]]}, "expected a channel and points"),
            ("rudder", ENDS | {"points": [[1, 0.1], [1, 0.2]]}, "values of the channel, each once"),
            ("rudder", ENDS | {"points": [[1, 0.1], [2, 20.0]]}, "radians, at most pi/2"),
        ],
    )
    def test_entries(self, name, entry, message):
        with pytest.raises(FlightReadError, match=message):
            read_servos({name: entry})

    def test_files(self, tmp_path):
        (tmp_path / "servo.toml").write_text("[elevator\n")
        with pytest.raises(FlightReadError, match="expected TOML"):
            read_servos(tmp_path / "servo.toml")
        with pytest.raises(FileNotFoundError):
            read_servos(tmp_path / "nowhere.toml")


def parameters_of(surfaces):
    """Return PX4's parameters of surfaces: type, and torques about roll, pitch, yaw."""
    parameters = {}
    for n, (kind, *torques) in surfaces.items():
        parameters[f"CA_SV_CS{n}_TYPE"] = kind
        for axis, torque in zip("RPY", torques, strict=True):
            parameters[f"CA_SV_CS{n}_TRQ_{axis}"] = float(torque)
    return parameters


COMMANDS = {"aileron": 0.3, "elevator": -0.4, "rudder": 0.2}
# More torque pitches up, rolls right, yaws right: of these only roll has the sign of the table
ROLL = 0.3
PITCH = 0.4
YAW = -0.2


class TestFullThrow:
    """Surfaces from -1 to 1 by the parameters of the autopilot, with the signs of a flight table."""

    def test_of_ardupilot(self, read, ardupilot, flight):
        table = read(ardupilot, "log.bin", servos="full throw")
        for name, sign in {"aileron": 1, "elevator": 1, "rudder": -1}.items():
            found = table[name][20:-20]
            flown = flight[name](table.time)[20:-20]
            assert np.corrcoef(found, sign * flown)[0, 1] > 0.999
        assert table.attrs["sources"]["rudder"] == "RCOU.C4 (in parts of the full throw)"

    def test_a_throw_in_one_line(self, read, refused, ardupilot, tmp_path):
        parts = read(ardupilot, "log.bin", servos="full throw")
        (tmp_path / "servo.toml").write_text('elevator = "25 deg"\nrudder = "-.5 rad"\n')
        table = read(ardupilot, "log.bin", servos=tmp_path / "servo.toml")
        assert_allclose(table["elevator"], np.deg2rad(25) * parts["elevator"])
        assert_allclose(
            table["rudder"], -0.5 * parts["rudder"]
        )  # another sign than the parameters say
        assert "aileron" not in table
        refused(
            r"full throw of 'elevon_left', but expected surfaces .*'elevator'",
            ardupilot, "log.bin", servos={"elevon_left": "25 deg"},
        )  # fmt: skip

    def test_an_a_tail_and_a_single_aileron_servo_of_px4(self, parse, ulog):
        """The last is a wheel."""
        kinds = {0: (15, 1, 0, 0), 1: (13, 0, 0.5, 0.5), 2: (14, 0, 0.5, -0.5), 3: (16, 0, 0, 1)}
        log = ulog(**parameters_of(kinds))
        mixing = parse(log.topic("actuator_servos", [0.1, 0.2], control=np.zeros((2, 4)))).controls
        numbers = {name: [servo.channel[-2] for servo in parts] for name, parts in mixing.items()}
        assert numbers == {"aileron": ["0"], "elevator": ["1", "2"], "rudder": ["1", "2"]}

    def test_any_mixing_of_px4(self, read, ulog):
        """Control allocation inverts the matrix of torques: a V-tail, and two ailerons of other torques."""
        ailerons = {0: (1, -0.5, 0, 0), 1: (2, 0.8, 0, 0), 4: (9, 0.3, 0, 0)}
        tail = {2: (7, 0, 0.5, 0.5), 3: (8, 0, 0.5, -0.5)}
        t = np.arange(0, 10, 0.05)
        control = np.tile([-ROLL, ROLL, PITCH + YAW, PITCH - YAW, 0.7], (t.size, 1))
        log = ulog(**parameters_of(ailerons | tail)).topic("actuator_servos", t, control=control)
        log.topic("airspeed", t, true_airspeed_m_s=20.0)
        table = read(log, servos="full throw", airborne=False)
        assert dict(table[[*COMMANDS]].median().round(6)) == COMMANDS

    def test_full_throws_are_no_large_angles(self, read, dataflash, tmp_path):
        """Nor are they in radians after they were saved."""
        t = np.arange(0, 10, 0.05)
        log = dataflash(SERVO1_FUNCTION=4.0).topic("RCOU", t, C1=("H", np.where(t < 5, 1900, 1500)))
        table = read(log, servos="full throw", airborne=False)
        assert table.aileron.max() == 1.0
        table.to_csv(tmp_path / "saved.csv", index=False)
        assert (read_flight(tmp_path / "saved.csv")["full_throw"] == 1).all()
        with pytest.warns(UserWarning, match="commands from -1 to 1"):
            read(log, servos={"aileron": "60 deg"}, airborne=False)

    def test_what_cannot_be(self, refused, dataflash, ulog):
        log = dataflash(SERVO1_FUNCTION=4.0, SERVO1_MIN=1900.0)
        log.topic("RCOU", [0.1, 0.2], C1=("H", 1500))
        refused(
            r"min, trim, max of aileron on RCOU.C1 \(1900.0, 1500.0, 1900.0\)",
            log, servos="full throw",
        )  # fmt: skip
        log = ulog().topic("airspeed", [0.1, 0.2], true_airspeed_m_s=[1, 2])
        refused(r"expected some of \['actuator_servos'.*CA_SV", log, servos="full throw")
        log.topic("actuator_servos", [0.1, 0.2], control=np.zeros((2, 2)))
        refused(r"but expected the parameters CA_SV", log, servos="full throw")

    def test_elevons_of_px4_take_nothing_from_a_fixed_mixer(self, parse, ulog):
        log = ulog(**parameters_of({0: (5, -0.5, 0.5, 0), 1: (6, 0.5, 0.5, 0)}))
        log.topic("actuator_servos", [0.1, 0.2], control=np.zeros((2, 2)))
        log.topic("actuator_controls_0", [0.1, 0.2], control=np.zeros((2, 4)))
        assert {*parse(log).controls} == {"aileron", "elevator"}


def test_reversed_outputs(parse, dataflash):
    log = dataflash(SERVO1_FUNCTION=77.0, SERVO1_REVERSED=1.0, SERVO2_FUNCTION=78.0)
    log.topic("RCOU", [0.1, 0.2], C1=("H", 1500), C2=("H", 1500))
    ends = {name: servo.angles[-1] for name, (servo,) in parse(log).controls.items()}
    assert ends == {"elevon_left": 1.0, "elevon_right": -1.0}


def test_the_code_runs(write, monkeypatch, ulog, flight, blocks_of):
    t = flight.time(50)
    log = ulog(MAV_TYPE=1).gyros(t, flight["p"](t))
    controls = flight.at(t, "aileron", "elevator", "rudder", "throttle")
    log.topic("actuator_controls_0", t, control=controls)
    log.topic("airspeed", t, true_airspeed_m_s=flight["airspeed"](t))
    monkeypatch.chdir(write(log, "sortie.ulg").parent)
    names = {}
    for block in blocks_of("logs.md"):
        exec(compile(block, "logs.md", "exec"), names)


def test_the_servo_file_is_one(tmp_path, blocks_of):
    (text,) = blocks_of("logs.md", "toml")
    (tmp_path / "servo.toml").write_text(text)
    servos = read_servos(tmp_path / "servo.toml")
    assert servos["elevator"].angles == (0.35, 0.0, -0.35)
    assert servos["aileron"].channel == "actuator_outputs.output[0]"

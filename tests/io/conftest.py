"""Writers of small logs: PX4 ULog, ArduPilot DataFlash and telemetry, message by message, to be damaged."""

import lzma
import struct
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from flight_columns import FORCES, RATES, VELOCITY
from made_flights import flight_of_motion
from numpy.random import default_rng
from scipy.spatial.transform import Rotation

from skdgp.io import AUTOPILOTS, FlightReadError, read_flight
from skdgp.preprocessing import FlightDataWarning

ULOG_CODES = {"float": "f", "uint8_t": "B", "int32_t": "i", "uint64_t": "Q", "bool": "?"}
DATAFLASH_CODES = {
    "Q": "Q",
    "f": "f",
    "B": "B",
    "H": "H",
    "h": "h",
    "c": "h",
    "C": "H",
    "e": "i",
    "L": "i",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
}
DATAFLASH_SCALE = {"c": 100, "C": 100, "e": 100, "L": 1e7}
DEGREE = 180 / np.pi
INERTIAL = [*FORCES, *RATES]


class LogWriter:
    """Collects definitions and data messages with their times; ``bytes()`` puts the data in order of time."""

    head = b""
    suffix = ""

    def __init__(self):
        self.definitions = []
        self.subscriptions = []
        self.data = []

    def parts(self):
        """Return all messages after the header."""
        ordered = sorted(self.data, key=lambda timed: timed[0])
        return [*self.definitions, *self.subscriptions, *(message for _, message in ordered)]

    def __bytes__(self):
        return self.head + b"".join(self.parts())


def typed(field, n):
    """Return the type of a field of a ULog and its values, (n,) or (n, k): truth values, or numbers."""
    kind, values = field if isinstance(field, tuple) else ("", field)
    values = np.asarray(values)
    values = np.broadcast_to(values, values.shape or n)
    if kind:
        return kind, values
    kind = "bool" if values.dtype == bool else "float"
    return (f"{kind}[{values.shape[1]}]" if values.ndim > 1 else kind), values


class ULogWriter(LogWriter):
    """A log of PX4."""

    suffix = ".ulg"
    head = b"ULog\x01\x12\x35\x01" + bytes(8)

    @staticmethod
    def message(kind, payload):
        return struct.pack("<HB", len(payload), ord(kind)) + payload

    @staticmethod
    def keyed(kind, key, payload):
        return ULogWriter.message(kind, bytes([len(key)]) + key.encode() + payload)

    def __init__(self, **parameters):
        super().__init__()
        self.formats = set()
        self.definitions.append(self.message("B", bytes(40)))
        self.definitions.append(self.keyed("I", "char[3] sys_name", b"PX4"))
        for name, value in parameters.items():
            kind, code = ("int32_t", "i") if isinstance(value, int) else ("float", "f")
            self.definitions.append(self.keyed("P", f"{kind} {name}", struct.pack(code, value)))

    def topic(self, name, time, *, instance=0, **fields):
        """Add a topic; a field is numbers, (n, k), (n,) or one, or with its type ``("float[4]", values)``."""
        fields = {key: typed(value, len(time)) for key, value in fields.items()}
        if name not in self.formats:
            self.formats.add(name)
            layout = "".join(f"{kind} {field};" for field, (kind, _) in fields.items())
            text = f"{name}:uint64_t timestamp;{layout}"
            self.definitions.append(self.message("F", text.encode()))
        number = len(self.subscriptions)
        subscription = struct.pack("<BH", instance, number) + name.encode()
        self.subscriptions.append(self.message("A", subscription))
        layout = [("number", "H"), ("timestamp", "Q")]
        for field, (kind, values) in fields.items():
            layout.append((field, ULOG_CODES[kind.split("[")[0]], values.shape[1:]))
        rows = np.empty(len(time), layout)
        rows["number"] = number
        rows["timestamp"] = np.round(np.multiply(time, 1e6))
        for field, (_, values) in fields.items():
            rows[field] = values
        for t, row in zip(time, rows, strict=True):
            self.data.append((t, self.message("D", row.tobytes())))
        return self

    def gyros(self, time, rate, **fields):
        """Add gyros that all read the same rate."""
        rates = np.broadcast_to(rate, (3, len(time))).T
        return self.topic("vehicle_angular_velocity", time, xyz=rates, **fields)


class DataFlashWriter(LogWriter):
    """A log of ArduPilot."""

    suffix = ".bin"

    def __init__(self, *messages, **parameters):
        super().__init__()
        self.types = {}
        self._define("FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
        for text in messages:
            self.rows("MSG", "QZ", "TimeUS,Message", [(0, text.encode())])
        for name, value in parameters.items():
            self.rows("PARM", "QNf", "TimeUS,Name,Value", [(0, name.encode(), value)])

    def _define(self, name, codes, columns):
        if name not in self.types:
            kind = 0x80 if name == "FMT" else 100 + len(self.types)
            layout = "<" + "".join(DATAFLASH_CODES.get(code, "B") for code in codes)
            length = struct.calcsize(layout) + 3
            self.types[name] = kind, layout
            texts = name.encode(), codes.encode(), columns.encode()
            body = struct.pack("<BB4s16s64s", kind, length, *texts)
            self.definitions.append(b"\xa3\x95\x80" + body)
        return self.types[name]

    def rows(self, name, codes, columns, rows):
        """Add messages as they are stored: the first value is TimeUS."""
        kind, layout = self._define(name, codes, columns)
        for row in rows:
            message = b"\xa3\x95" + bytes([kind]) + struct.pack(layout, *row)
            self.data.append((row[0], message))
        return self

    def topic(self, name, time, **fields):
        """Add a topic; a field is floats, or other values with their type ``(code, values)``."""
        columns = [np.round(np.asarray(time) * 1e6).astype(int).tolist()]
        codes = "Q"
        for field in fields.values():
            code, values = field if isinstance(field, tuple) else ("f", field)
            scaled = np.broadcast_to(values, len(time)) * DATAFLASH_SCALE.get(code, 1)
            columns.append((scaled if code == "f" else np.round(scaled).astype(int)).tolist())
            codes += code
        return self.rows(name, codes, ",".join(["TimeUS", *fields]), zip(*columns, strict=True))

    def gyros(self, time, rate, name="IMU", **fields):
        """Add gyros that all read the same rate."""
        return self.topic(name, time, GyrX=rate, GyrY=rate, GyrZ=rate, **fields)


@pytest.fixture
def ulog():
    """Return the writer of ULogs."""
    return ULogWriter


@pytest.fixture
def dataflash():
    """Return the writer of DataFlash logs."""
    return DataFlashWriter


@pytest.fixture
def write(tmp_path):
    """Write a log, its bytes, telemetry, a text or a table, under a name; return the path."""
    suffixes = {str: ".csv", pd.DataFrame: ".csv", list: ".tlog", bytes: ".ulg"}

    def write(content, name=None):
        suffix = suffixes.get(type(content)) or content.suffix
        path = tmp_path / (name or f"log{suffix}")
        if isinstance(content, str):
            path.write_text(content, encoding="utf-8")
        elif isinstance(content, list):
            path.write_bytes(b"".join(content))
        elif not isinstance(content, pd.DataFrame):
            path.write_bytes(bytes(content))
        elif path.suffix == ".csv":
            content.to_csv(path, index=False)
        else:
            content.to_parquet(path)
        return path

    return write


@pytest.fixture
def read(write):
    """Write a log or a table, and read its flights."""
    return lambda content, name=None, **options: read_flight(write(content, name), **options)


@pytest.fixture
def refused(write):
    """Assert that a log or a table is refused in some words; return these."""

    def refused(words, content, name=None, **options):
        with pytest.raises(FlightReadError, match=words) as error:
            read_flight(write(content, name), **options)
        return str(error.value)

    return refused


@pytest.fixture
def told(write):
    """Read a log, which a FlightDataWarning tells of."""

    def told(words, log, name=None, **options):
        with pytest.warns(FlightDataWarning, match=words):
            return read_flight(write(log, name), **options)

    return told


@pytest.fixture
def parse(write):
    """Write a log under a name, and return its topics, parameters and controls."""

    def parse(log, name=None):
        path = write(log, name)
        return AUTOPILOTS[path.suffix](path)

    return parse


class Flight:
    """A flight of 30 s whose every channel is known at any time: slow sines, and what inertial sensors measure."""

    SIZES = {
        "airspeed": (18.0, 2.0), "alpha": (0.05, 0.02), "beta": (0.0, 0.03), "density": (1.1, 0.01),
        "altitude": (300.0, 20.0), "p": (0.0, 0.4), "q": (0.0, 0.2), "r": (0.0, 0.1), "ax": (0.5, 0.3),
        "ay": (0.0, -0.4), "az": (-9.8, 1.0),
        "phi": (0.1, 0.5), "theta": (0.05, 0.1), "psi": (3.1, 0.3), "north": (100.0, 50.0), "east": (-20.0, 40.0),
        "down": (-50.0, 5.0), "v_north": (3.0, 9.0), "v_east": (1.0, 12.0), "v_down": (0.0, 0.5),
        "throttle": (0.5, 0.2),
        "propeller_speed": (500.0, 50.0), "elevator": (0.02, 0.05), "aileron": (0.0, 0.1), "rudder": (0.0, 0.05),
        "elevon_left": (0.02, 0.1), "elevon_right": (0.02, 0.1), "wind_north": (2.0, 0.2), "wind_east": (-1.0, 0.2),
    }  # fmt: skip
    BEGIN = 12.0
    END = 42.0

    def __getitem__(self, name):
        """Return a channel as a function of time."""
        if name in INERTIAL:
            return lambda t: self.sensed(t)[name].to_numpy()
        mean, size = self.SIZES[name]
        number = list(self.SIZES).index(name)
        frequency = 2 * np.pi * (0.05 + 0.01 * (number % 7))
        return lambda t: mean + size * np.sin(frequency * t + number)

    def sensed(self, t):
        """Return what inertial sensors read."""
        return flight_of_motion(t, self.attitude, self.velocity)

    def attitude(self, t):
        return Rotation.from_euler("ZYX", self.at(t, "psi", "theta", "phi"))

    def velocity(self, t):
        return self.at(t, *VELOCITY)

    def time(self, rate, *, delay=0.0):
        return np.arange(self.BEGIN + delay, self.END, 1 / rate)

    def at(self, time, *names):
        """Return channels at some times, (n, k)."""
        return np.column_stack([self[name](time) for name in names])

    def log(self, log, name, rate, *, delay=0.0, factor=1.0, code=None, **fields):
        """Add a topic: channels by name times a factor, functions, values as they are; of a type, if they have none."""
        time = self.time(rate, delay=delay)
        made = {}
        for key, value in fields.items():
            if isinstance(value, str):
                channels = factor * self.at(time, *value.split())
                value = channels if " " in value else channels[:, 0]
            elif callable(value):
                value = value(time)
            made[key] = (code, value) if code and not isinstance(value, tuple) else value
        log.topic(name, time, **made)

    def equivalent_airspeed(self, t):
        return self["airspeed"](t) * np.sqrt(self["density"](t) / 1.225)

    def pressure(self, t):
        """Return the pressure of the standard atmosphere at this density [Pa]."""
        return 101325 * (self["density"](t) / 1.225) ** (1 / (1 - 1 / 5.25588))


@pytest.fixture(scope="session")
def flight():
    """Return channels that are known at any time."""
    return Flight()


@pytest.fixture(scope="session")
def px4(flight):
    """Return a ULog of a PX4 fixed wing that logs every column."""
    log = ULogWriter(MAV_TYPE=1, FW_AIRSPD_MIN=12.0)
    add = partial(flight.log, log)

    def quaternion(t):
        """Return (w, x, y, z), by SciPy."""
        return np.roll(flight.attitude(t).as_quat(), 1, axis=1)

    def pulses(t):
        return 1500 + 1000 * flight.at(t, "aileron", "elevator", "rudder", "rudder")

    add("vehicle_angular_velocity", 200, xyz="p q r")
    add("vehicle_acceleration", 100, delay=0.0017, xyz="ax ay az")
    add("vehicle_attitude", 50, delay=0.003, q=quaternion)
    add(
        "airspeed", 20, true_airspeed_m_s="airspeed",
        indicated_airspeed_m_s=lambda t: 0.9 * flight["airspeed"](t),
    )  # fmt: skip
    add("airflow_aoa", 25, aoa_rad="alpha")
    add("airflow_slip", 25, slip_rad="beta")
    add(
        "vehicle_local_position", 30, x="north", y="east", z="down",
        vx="v_north", vy="v_east", vz="v_down",
        xy_valid=True, z_valid=True, v_xy_valid=True, v_z_valid=True,
    )  # fmt: skip
    add("vehicle_global_position", 10, alt="altitude")
    add("vehicle_air_data", 15, rho="density")
    add("wind", 2, windspeed_north="wind_north", windspeed_east="wind_east")
    add("actuator_motors", 50, control="throttle throttle throttle throttle")
    add("rpm", 10, factor=30 / np.pi, indicated_frequency_rpm="propeller_speed")
    add("actuator_outputs", 50, output=pulses)
    add("vehicle_status", 1, vehicle_type=("uint8_t", 2))
    add("vehicle_land_detected", 1, landed=False)
    return bytes(log)


@pytest.fixture(scope="session")
def px4_servos():
    """Return the calibration of the servos of that log."""
    servos = {}
    for n, name in enumerate(("aileron", "elevator", "rudder")):
        servos[name] = {
            "channel": f"actuator_outputs.output[{n}]", "points": [[1000, -0.5], [2000, 0.5]],
        }  # fmt: skip
    return servos


@pytest.fixture(scope="session")
def ardupilot(flight):
    """Return a DataFlash log of an ArduPilot plane that logs every column."""
    servos = {"SERVO1_FUNCTION": 4.0, "SERVO2_FUNCTION": 19.0, "SERVO4_FUNCTION": 21.0}
    log = DataFlashWriter("ArduPlane V4.5.1 (abcdef01)", AIRSPEED_MIN=12.0, **servos)
    add = partial(flight.log, log)
    zero = ("B", 0)

    def pulse(channel, factor=1000):
        return lambda t: 1500 + factor * flight[channel](t)

    def yaw(t):
        return "C", flight["psi"](t) * DEGREE % 360

    add("IMU", 100, I=zero, GyrX="p", GyrY="q", GyrZ="r", AccX="ax", AccY="ay", AccZ="az")
    add("ATT", 50, delay=0.004, code="c", factor=DEGREE, Roll="phi", Pitch="theta", Yaw=yaw)
    add("ARSP", 20, I=zero, Airspeed=flight.equivalent_airspeed, H=("B", 1))
    add("AOA", 20, factor=DEGREE, AOA="alpha", SSA="beta")
    add(
        "XKF1", 25, C=zero, VN="v_north", VE="v_east", VD="v_down",
        PN="north", PE="east", PD="down",
    )  # fmt: skip
    add("XKF2", 25, C=zero, VWN="wind_north", VWE="wind_east")
    add("POS", 10, Lat=("L", -9.1234567), Alt="altitude")
    add("BARO", 10, I=zero, Press=flight.pressure)
    add("CTUN", 10, factor=100, ThO="throttle")
    add("RPM", 10, factor=30 / np.pi, rpm1="propeller_speed", rpm2=0.0)
    add(
        "RCOU", 50, code="H", C1=pulse("aileron"), C2=pulse("elevator", -1000), C3=("H", 1100),
        C4=pulse("rudder"),
    )  # fmt: skip
    return bytes(log)


@pytest.fixture
def vtol_bench(write):
    """Return the beginning of a log of a PX4 VTOL on the bench, of pyulog's tests (BSD licence beside)."""
    packed = Path(__file__).parent / "data" / "px4_vtol_bench.ulg.xz"
    return write(lzma.decompress(packed.read_bytes()), "bench.ulg")


ARRIVAL = 1.7e9  # Arrival less the clock of the vehicle [s]


def telemetry(now):
    """Return the values of the messages of a plane by their type, of its channels at a time."""

    def whole(names, factor):
        return [round(factor * getattr(now, name)) for name in names.split()]

    (ms,) = whole("time", 1e3)
    (us,) = whole("time", 1e6)
    force = whole("ax ay az", 1e3 / 9.80665)
    elevator, rudder = whole("elevator rudder", -1000)
    pulses = 1500, 1500 + elevator, 1100, 1500 + rudder, *[1500] * 4
    position = ms, 0, 0, *whole("altitude", 1e3), 0, *whole("v_north v_east v_down", 100), 0
    return {
        "attitude": (ms, now.phi, now.theta, now.psi, now.p, now.q, now.r),
        "global_position_int": position,
        "raw_imu": (us, *force, *whole("p q r", 1e3), 0, 0, 0),
        "vfr_hud": (now.equivalent_airspeed, 0, 0, *whole("throttle", 100), 0, 0),
        "scaled_pressure": (ms, now.pressure / 100, 0, 0),
        "servo_output_raw": (us, 0, *pulses),
    }


@pytest.fixture(scope="session")
def mavlink():
    """Return the messages of telemetry."""
    return pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")


@pytest.fixture(scope="session")
def vehicle(mavlink):
    """Return the vehicle that sends the messages."""
    return mavlink.MAVLink(None, srcSystem=1, srcComponent=1)


@pytest.fixture(scope="session")
def tlog(flight, mavlink, vehicle):
    """Telemetry of a plane with ArduPilot: arrival late by up to .2 s, and a ground station that sends too."""
    station = mavlink.MAVLink(None, srcSystem=255)
    sent = []

    def send(time, kind, *values, by=vehicle):
        message = vars(mavlink)[f"MAVLink_{kind}_message"](*values)
        sent.append((time, message.pack(by)))

    parameters = {
        b"AHRS_TRIM_X": 0.0, b"AHRS_TRIM_Y": 0.0, b"AIRSPEED_MIN": 12.0, b"SERVO2_FUNCTION": 19.0,
        b"SERVO4_FUNCTION": 21.0,
    }  # fmt: skip
    for name, value in parameters.items():
        send(flight.BEGIN, "param_value", name, value, 9, 3, 0)
    for t in flight.time(1):
        send(t, "heartbeat", 1, 3, 128, 0, 0, 3)
        send(t, "heartbeat", 6, 8, 0, 0, 0, 3, by=station)
    time = flight.time(10)
    channels = pd.DataFrame(flight.at(time, *flight.SIZES), columns=[*flight.SIZES]).assign(
        time=time,
        equivalent_airspeed=flight.equivalent_airspeed(time),
        pressure=flight.pressure(time),
    )
    for now in channels.itertuples():
        for kind, values in telemetry(now).items():
            send(now.time, kind, *values)
    sent.sort(key=lambda each: each[0])
    late = default_rng(0).uniform(0, 0.2, len(sent))
    arrivals = np.maximum.accumulate([ARRIVAL + time for time, _ in sent] + late)
    stamps = [struct.pack(">Q", round(1e6 * arrival)) for arrival in arrivals]
    return [stamp + message for stamp, (_, message) in zip(stamps, sent, strict=True)]


@pytest.fixture
def mavlink_parameters(tlog, mavlink, vehicle):
    """Return a function to the telemetry with further parameters, without one."""

    def with_parameters(values, without=b"nothing"):
        sent = []
        for name, value in values.items():
            message = mavlink.MAVLink_param_value_message(name, value, 9, 3, 0)
            sent.append(tlog[0][:8] + message.pack(vehicle))
        return sent + [message for message in tlog if without not in message]

    return with_parameters

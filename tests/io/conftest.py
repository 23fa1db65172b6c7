"""Writers of small logs: PX4 ULog and ArduPilot DataFlash, message by message, so that tests can damage them."""

import struct

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.spatial.transform import Rotation

ULOG_CODES = {
    "float": "f",
    "double": "d",
    "uint8_t": "B",
    "int32_t": "i",
    "uint16_t": "H",
    "uint64_t": "Q",
    "bool": "?",
}
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
    "N": "16s",
    "Z": "64s",
}
DATAFLASH_SCALE = {"c": 100, "C": 100, "e": 100, "L": 1e7}


def ulog_message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def ulog_keyed(kind, key, payload):
    return ulog_message(kind, bytes([len(key)]) + key.encode() + payload)


def typed(field, n):
    """Return the type of a field of a ULog and its values, (n,) or (n, k): truth values, or numbers."""
    if isinstance(field, tuple):
        return field
    values = np.asarray(field)
    values = np.broadcast_to(values, values.shape or n)
    kind = "bool" if values.dtype == bool else "float"
    return (f"{kind}[{values.shape[1]}]" if values.ndim > 1 else kind), values


class ULogWriter:
    """Collects definitions and data messages; ``bytes()`` puts them in order of time."""

    def __init__(self, **parameters):
        self.head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
        self.definitions = [
            ulog_message("B", bytes(40)),
            ulog_keyed("I", "char[3] sys_name", b"PX4"),
        ]
        for name, value in parameters.items():
            code = "i" if isinstance(value, int) else "f"
            self.definitions.append(
                ulog_keyed(
                    "P", f"{'int32_t' if code == 'i' else 'float'} {name}", struct.pack(code, value)
                )
            )
        self.subscriptions, self.data, self.formats = [], [], set()

    def topic(self, name, time, *, instance=0, **fields):
        """Add a topic; a field is numbers, (n, k), (n,) or one, or with its type ``("float[4]", values)``."""
        fields = {key: typed(value, len(time)) for key, value in fields.items()}
        if name not in self.formats:
            self.formats.add(name)
            layout = "".join(f"{kind} {field};" for field, (kind, _) in fields.items())
            self.definitions.append(
                ulog_message("F", f"{name}:uint64_t timestamp;{layout}".encode())
            )
        number = len(self.subscriptions)
        self.subscriptions.append(
            ulog_message("A", struct.pack("<BH", instance, number) + name.encode())
        )
        columns = [
            (kind.split("[")[0], np.asarray(values).reshape(len(time), -1))
            for kind, values in fields.values()
        ]
        for row, t in enumerate(time):
            payload = struct.pack("<HQ", number, round(t * 1e6))
            for kind, values in columns:
                cells = values[row].tolist()
                cells = cells if kind in ("float", "double") else [int(cell) for cell in cells]
                payload += struct.pack(f"<{len(cells)}{ULOG_CODES[kind]}", *cells)
            self.data.append((t, ulog_message("D", payload)))
        return self

    def parts(self):
        """Return all messages after the header, data in order of time."""
        return [
            *self.definitions,
            *self.subscriptions,
            *(message for _, message in sorted(self.data, key=lambda d: d[0])),
        ]

    def __bytes__(self):
        return self.head + b"".join(self.parts())


class DataFlashWriter:
    """The same for DataFlash."""

    COLUMNS = "Type,Length,Name,Format,Columns"

    def __init__(self, *messages, **parameters):
        self.definitions, self.data, self.types = [], [], {}
        self._define("FMT", "BBnNZ", self.COLUMNS, kind=0x80, length=89)
        for text in messages:
            self.rows("MSG", "QZ", "TimeUS,Message", [(0, text.encode())])
        for name, value in parameters.items():
            self.rows("PARM", "QNf", "TimeUS,Name,Value", [(0, name.encode(), value)])

    def _define(self, name, codes, columns, kind=None, length=None):
        if name in self.types:
            return self.types[name]
        kind = kind or 100 + len(self.types)
        layout = "<" + "".join(DATAFLASH_CODES.get(code, "B") for code in codes)
        length = length or struct.calcsize(layout) + 3
        self.types[name] = kind, layout
        body = struct.pack(
            "<BB4s16s64s", kind, length, name.encode(), codes.encode(), columns.encode()
        )
        self.definitions.append(b"\xa3\x95\x80" + body)
        return self.types[name]

    def rows(self, name, codes, columns, rows):
        """Add messages as they are stored: the first value is TimeUS."""
        kind, layout = self._define(name, codes, columns)
        self.data += [
            (row[0], b"\xa3\x95" + bytes([kind]) + struct.pack(layout, *row)) for row in rows
        ]
        return self

    def topic(self, name, time, **fields):
        """Add a topic; a field is ``(code, values)``."""
        columns = []
        for code, values in fields.values():
            values = np.broadcast_to(values, len(time)) * DATAFLASH_SCALE.get(code, 1)
            columns.append(
                values.tolist() if code == "f" else np.round(values).astype(int).tolist()
            )
        stamps = np.round(np.asarray(time) * 1e6).astype(int).tolist()
        names, codes = (
            ",".join(["TimeUS", *fields]),
            "Q" + "".join(code for code, _ in fields.values()),
        )
        return self.rows(name, codes, names, list(zip(stamps, *columns, strict=True)))

    def parts(self):
        return [
            *self.definitions,
            *(message for _, message in sorted(self.data, key=lambda d: d[0])),
        ]

    def __bytes__(self):
        return b"".join(self.parts())


@pytest.fixture
def ulog():
    """Return the writer of ULogs."""
    return ULogWriter


@pytest.fixture
def dataflash():
    """Return the writer of DataFlash logs."""
    return DataFlashWriter


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
    BEGIN, END = 12.0, 42.0

    def __getitem__(self, name):
        """Return a channel as a function of time."""
        if name in ("p", "q", "r"):
            return lambda t: self.rates(t)["pqr".index(name)]
        if name in ("ax", "ay", "az"):
            return lambda t: self.specific_force(t)[:, "xyz".index(name[1])]
        mean, _ = self.SIZES[name]
        return lambda t: mean + self.wave(name, t)

    def wave(self, name, t, shift=0.0):
        """Return the sine of a channel, shifted [rad]."""
        _, size = self.SIZES[name]
        return size * np.sin(self.frequency(name) * t + self.number(name) + shift)

    def number(self, name):
        return list(self.SIZES).index(name)

    def frequency(self, name):
        """Return the frequency of a channel [rad/s]."""
        return 2 * np.pi * (0.05 + 0.01 * (self.number(name) % 7))

    def slope(self, name, t):
        return self.frequency(name) * self.wave(name, t, np.pi / 2)

    def rates(self, t):
        """Return p, q, r of the attitude (Stevens & Lewis, equation 1.4-3)."""
        phi, theta = self["phi"](t), self["theta"](t)
        phi_dot, theta_dot, psi_dot = (self.slope(name, t) for name in ("phi", "theta", "psi"))
        return (
            phi_dot - psi_dot * np.sin(theta),
            theta_dot * np.cos(phi) + psi_dot * np.sin(phi) * np.cos(theta),
            psi_dot * np.cos(phi) * np.cos(theta) - theta_dot * np.sin(phi),
        )

    def specific_force(self, t):
        """Return the acceleration less gravity in body axes, (n, 3)."""
        t = np.atleast_1d(t)
        attitude = Rotation.from_euler("ZYX", self.at(t, "psi", "theta", "phi"))
        acceleration = [self.slope(name, t) for name in ("v_north", "v_east", "v_down")]
        return attitude.inv().apply(np.column_stack(acceleration) - [0.0, 0.0, 9.80665])

    def time(self, rate, *, delay=0.0):
        return np.arange(self.BEGIN + delay, self.END, 1 / rate)

    def at(self, time, *names):
        """Return channels at some times, (n, k)."""
        return np.column_stack([self[name](np.asarray(time)) for name in names])


@pytest.fixture(scope="session")
def flight():
    """Return channels that are known at any time."""
    return Flight()


def quaternion(angles):
    """Return (w, x, y, z) by SciPy, of phi, theta, psi."""
    x, y, z, w = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat().T
    return np.column_stack([w, x, y, z])


def always(kind, value):
    """Return a field that is the same at any time."""
    return lambda t: (kind, np.full(len(t), value))


@pytest.fixture(scope="session")
def px4(flight):
    """Return a ULog of a PX4 fixed wing that logs every column."""
    f, w = flight, ULogWriter(MAV_TYPE=1, FW_AIRSPD_MIN=12.0)

    def add(name, rate, *, delay=0.0, factor=1.0, **fields):
        """Add a topic; a field is channels of the flight, or a function of time to its type and values."""
        t, made = f.time(rate, delay=delay), {}
        for key, value in fields.items():
            if isinstance(value, str):
                values = f.at(t, *value.split()) * factor
                made[key] = values if " " in value else values[:, 0]
            else:
                made[key] = value(t)
        w.topic(name, t, **made)

    valid = dict.fromkeys(("xy_valid", "z_valid", "v_xy_valid", "v_z_valid"), always("bool", True))
    attitude = {"q": lambda t: quaternion(f.at(t, "phi", "theta", "psi"))}
    pulses = {"output": lambda t: 1500 + 1000 * f.at(t, "aileron", "elevator", "rudder", "rudder")}
    indicated = {"indicated_airspeed_m_s": lambda t: 0.9 * f["airspeed"](t)}
    position = {
        "x": "north",
        "y": "east",
        "z": "down",
        "vx": "v_north",
        "vy": "v_east",
        "vz": "v_down",
    }
    add("vehicle_angular_velocity", 200, xyz="p q r")
    add("vehicle_acceleration", 100, delay=0.0017, xyz="ax ay az")
    add("vehicle_attitude", 50, delay=0.003, **attitude)
    add("airspeed", 20, true_airspeed_m_s="airspeed", **indicated)
    add("airflow_aoa", 25, aoa_rad="alpha")
    add("airflow_slip", 25, slip_rad="beta")
    add("vehicle_local_position", 30, **position, **valid)
    add("vehicle_global_position", 10, alt="altitude")
    add("vehicle_air_data", 15, rho="density")
    add("wind", 2, windspeed_north="wind_north", windspeed_east="wind_east")
    add("actuator_motors", 50, control="throttle throttle throttle throttle")
    add("rpm", 10, factor=30 / np.pi, indicated_frequency_rpm="propeller_speed")
    add("actuator_outputs", 50, **pulses)
    add("vehicle_status", 1, vehicle_type=always("uint8_t", 2))
    add("vehicle_land_detected", 1, landed=always("bool", False))
    return bytes(w)


@pytest.fixture(scope="session")
def ardupilot(flight):
    """Return a DataFlash log of an ArduPilot plane that logs every column."""
    f, first = flight, {"I": always("B", 0)}
    servos = {f"SERVO{n}_FUNCTION": value for n, value in ((1, 4.0), (2, 19.0), (4, 21.0))}
    w = DataFlashWriter("ArduPlane V4.5.1 (abcdef01)", AIRSPEED_MIN=12.0, **servos)

    def add(name, rate, *, delay=0.0, code="f", factor=1.0, offset=0.0, **fields):
        """Add a topic; a field is a channel of the flight, or a function of time to its type and values."""
        t = f.time(rate, delay=delay)
        made = {
            key: (code, f[value](t) * factor + offset) if isinstance(value, str) else value(t)
            for key, value in fields.items()
        }
        w.topic(name, t, **made)

    degree = 180 / np.pi
    heading = {"Yaw": lambda t: ("C", f["psi"](t) * degree % 360)}
    pitot = {"Airspeed": lambda t: ("f", f["airspeed"](t) * np.sqrt(f["density"](t) / 1.225))}
    pressure = {
        "Press": lambda t: ("f", 101325 * (f["density"](t) / 1.225) ** (1 / (1 - 1 / 5.25588)))
    }
    others = {"C2": lambda t: ("H", 1500 - 1000 * f["elevator"](t)), "C3": always("H", 1100)}
    velocity = {"VN": "v_north", "VE": "v_east", "VD": "v_down"}
    add("IMU", 100, **first, GyrX="p", GyrY="q", GyrZ="r", AccX="ax", AccY="ay", AccZ="az")
    add("ATT", 50, delay=0.004, code="c", factor=degree, Roll="phi", Pitch="theta", **heading)
    add("ARSP", 20, **first, **pitot, H=always("B", 1))
    add("AOA", 20, factor=degree, AOA="alpha", SSA="beta")
    add("XKF1", 25, C=always("B", 0), **velocity, PN="north", PE="east", PD="down")
    add("XKF2", 25, C=always("B", 0), VWN="wind_north", VWE="wind_east")
    add("POS", 10, Alt="altitude")
    add("BARO", 10, **first, **pressure)
    add("CTUN", 10, factor=100, ThO="throttle")
    add("RPM", 10, factor=30 / np.pi, rpm1="propeller_speed", rpm2=always("f", 0.0))
    add("RCOU", 50, code="H", factor=1000, offset=1500, C1="aileron", **others, C4="rudder")
    return bytes(w)


ARRIVAL = 1.7e9  # Arrival less the clock of the vehicle [s]


@pytest.fixture(scope="session")
def tlog(flight):
    """Telemetry of a plane with ArduPilot: arrival late by up to .2 s, and a ground station that sends too."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    plane, station = (
        mavlink.MAVLink(None, srcSystem=1, srcComponent=1),
        mavlink.MAVLink(None, srcSystem=255),
    )
    rng, sent = default_rng(0), []

    def send(time, message, by=plane):
        sent.append((time, message.pack(by)))

    for name, value in (
        ("AIRSPEED_MIN", 12.0),
        ("SERVO2_FUNCTION", 19.0),
        ("SERVO4_FUNCTION", 21.0),
    ):
        send(flight.BEGIN, mavlink.MAVLink_param_value_message(name.encode(), value, 9, 3, 0))
    for t in flight.time(1):
        send(t, mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 0, 3))
        send(t, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3), station)
    for t in flight.time(10):
        ms = round(t * 1e3)
        at = {name: flight.at([t], name).item() for name in flight.SIZES}
        angles, rates = (at["phi"], at["theta"], at["psi"]), (at["p"], at["q"], at["r"])
        send(t, mavlink.MAVLink_attitude_message(ms, *angles, *rates))
        speed = [round(100 * at[name]) for name in ("v_north", "v_east", "v_down")]
        send(
            t,
            mavlink.MAVLink_global_position_int_message(
                ms, 0, 0, round(1e3 * at["altitude"]), 0, *speed, 0
            ),
        )
        force = [round(1e3 * at[name] / 9.80665) for name in ("ax", "ay", "az")]
        gyro = [round(1e3 * rate) for rate in rates]
        send(t, mavlink.MAVLink_raw_imu_message(round(t * 1e6), *force, *gyro, 0, 0, 0))
        equivalent = at["airspeed"] * np.sqrt(at["density"] / 1.225)
        send(
            t, mavlink.MAVLink_vfr_hud_message(equivalent, 0, 0, round(100 * at["throttle"]), 0, 0)
        )
        pressure = 1013.25 * (at["density"] / 1.225) ** (1 / (1 - 1 / 5.25588))
        send(t, mavlink.MAVLink_scaled_pressure_message(ms, pressure, 0, 0))
        pulses = [
            1500,
            round(1500 - 1000 * at["elevator"]),
            1100,
            round(1500 - 1000 * at["rudder"]),
        ]
        send(t, mavlink.MAVLink_servo_output_raw_message(round(t * 1e6), 0, *pulses, *[1500] * 4))
    sent.sort(key=lambda each: each[0])
    arrivals = np.maximum.accumulate([ARRIVAL + time + rng.uniform(0, 0.2) for time, _ in sent])
    return [
        struct.pack(">Q", round(1e6 * at)) + message
        for at, (_, message) in zip(arrivals, sent, strict=True)
    ]

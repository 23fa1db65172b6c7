"""Inputs of the benchmarks that are recorded flights: one table of what is learned from, and what is predicted.

Flights of the shared data are simulated, but for the Ampyx AP2. Those of DLR's test aircraft ATTAS, its
stall, and a UAV of 3.3 kg are of the public repository github.com/josemiguelbento/UAV-OAT-controlo.
Nothing of it stands here: it states no licence. The manoeuvres of ATTAS in it are the flight data of
Jategaonkar, Flight Vehicle System Identification, 2nd edition (AIAA 2015), which the publisher gives
away (arc.aiaa.org/doi/suppl/10.2514/4.102790). Mass, geometry, positions of sensors and engines of
ATTAS are those of the book's ``umr_reg_attas.m``; those of the UAV are the repository's
``get_coefs_real.m``; the HFB-320 is ``hfb320_1_10.asc``. Each loader takes the folder of the shared
data, or of an unpacked copy of the repository.
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from flight_columns import AIR, EULER, RATES, SPIN
from log_errors import elsewhere
from scipy.io import loadmat

from skdgp.dynamics import Aircraft, aerodynamic_coefficients, air_data, air_velocity
from skdgp.io import read_flight

BOOK = Path("RVJategaonkar_codes_2ed/flt_data")
UAV = Path("get_coeffs/flight_data_1")
# Of ATTAS, from its centre of gravity [m]; the engine is the right one
ACCELEROMETER = np.array([-1.010, 0.886, 0.103])
ENGINE = (-1.343, 2.990, -0.652)
BOOM = (13.080, -0.010, -0.027)
ATTAS = Aircraft(
    name="ATTAS",
    mass=17631.0,
    inertia=[[133367.0, 0.0, -11442.0], [0.0, 252687.0, 0.0], [-11442.0, 0.0, 359593.0]],
    wing_area=64.0,
    span=21.5,
    chord=3.159,
)
SMALL_UAV = Aircraft(
    name="UAV",
    mass=3.3,
    inertia=[[0.170, 0.0, -0.019], [0.0, 0.289, 0.0], [-0.019, 0.0, 0.443]],
    wing_area=0.384,
    span=1.6,
    chord=0.24,
)
# Numbers of the channels of ATTAS in the book; angles are in degrees
ATTAS_CHANNELS = dict(
    zip([*RATES, *EULER, "alpha", "beta", *SPIN], [*range(7, 15), *range(17, 20)], strict=True)
)
ATTAS_CHANNELS |= {"elevator": 22, "aileron_left": 28, "aileron_right": 29, "rudder": 30}
ATTAS_DEGREES = [*ATTAS_CHANNELS]
ATTAS_CHANNELS |= {
    "part": 1, "ax": 2, "ay": 3, "az": 4, "airspeed": 15, "altitude": 16, "density": 34,
    "left": 37, "right": 38,
}  # fmt: skip
EDGE = 30  # Samples at either end of the manoeuvres of ATTAS that its filters made to ring
# Angle of the UAV's surfaces by its commands, about; another scale changes no error
TRAVEL = np.radians(25.0) / 2250.0
DEGREE = np.radians(1.0)
# Channels of the UAV: field of a record, factor to SI
UAV_FIELDS = {
    "airspeed": ("Va", 1.0), "alpha": ("AoA", DEGREE), "beta": ("beta", DEGREE),
    "ax": ("ax", 1.0), "ay": ("ay", 1.0), "az": ("az", 1.0),
    "p": ("p", 1.0), "q": ("q", 1.0), "r": ("r", 1.0),
    "phi": ("roll", DEGREE), "theta": ("pitch", DEGREE), "psi": ("yaw", DEGREE),
    "altitude": ("h", 1.0), "v_north": ("VN", 1.0), "v_east": ("VE", 1.0), "v_down": ("VD", 1.0),
    "elevator": ("delta_e", TRAVEL), "aileron": ("delta_a", TRAVEL), "rudder": ("delta_r", TRAVEL),
    "throttle": ("delta_t", 0.01),
}  # fmt: skip
# The book's Izz of 35959 kg m^2 is that of no body; it hardly enters the longitudinal coefficients
HFB_320 = Aircraft(
    name="HFB-320",
    mass=7472.0,
    inertia=[[13336.0, 0.0, -1144.2], [0.0, 91420.0, 0.0], [-1144.2, 0.0, 1e5]],
    wing_area=30.097216,
    span=14.49,
    chord=2.43,
)
# Of the engines of the HFB-320 [rad], and their place from its centre of gravity [m]
TILT = 0.0524
HFB_ENGINE = (-1.343, 2.990, -0.652)
# Numbers of the channels in its log
HFB_CHANNELS = {
    "time": 0, "airspeed": 4, "alpha": 5, "beta": 16, "ax": 9, "ay": 11, "az": 10, "p": 12, "q": 7,
    "r": 13, "phi": 17, "theta": 6, "elevator": 1, "aileron": 18, "rudder": 19,
}  # fmt: skip
RECORDS = {
    "a": ("ail_1 ail_2 ail_3 el_1 el_2 el_3 rud_1", "ail_4 el_4"),
    "b": ("ail_3 ail_4 el_3 el_4 rud_1", "ail_1 ail_2 el_1 el_2"),
}


def attas(folder):
    """Return aircraft, training and test flights: manoeuvres of elevator, aileron, rudder, and their repetitions."""
    train = [_attas(folder, name) for name in ("fAttasElv1", "fAttasAil1", "fAttasRud1")]
    test = [_attas(folder, name) for name in ("fAttasElv2", "fAttasAilRud2")]
    return ATTAS, pd.concat(train, ignore_index=True), pd.concat(test, ignore_index=True), {}


def attas_stall(folder):
    """Return aircraft, training and test flight: a quasi-steady stall and its repetition."""
    return (ATTAS, *(_attas(folder, f"fAttas_qst0{k}", boom=False) for k in (1, 2)), {})


def _attas(folder, name, boom=True):
    """Return the table of one manoeuvre, with accelerations and air data brought to the centre of gravity."""
    path = Path(folder) / BOOK / name
    mat = path.with_suffix(".mat")
    log = loadmat(mat)[name] if mat.exists() else np.loadtxt(path.with_suffix(".asc"))
    channels = pd.DataFrame(log, columns=range(1, log.shape[1] + 1))
    table = channels[[*ATTAS_CHANNELS.values()]].set_axis([*ATTAS_CHANNELS], axis=1)
    table[ATTAS_DEGREES] = np.radians(table[ATTAS_DEGREES])
    if boom:  # the stalls hold all at the centre of gravity, as their header says, and metres
        at_boom = air_velocity(*table[AIR].to_numpy().T)
        table[AIR] = np.column_stack(air_data(at_boom - np.cross(table[RATES], BOOM)))
        table = elsewhere(table, -ACCELEROMETER, table[SPIN].to_numpy())
        table["altitude"] *= 0.3048
    left = table.pop("left")
    right = table.pop("right")
    table["aileron"] = 0.5 * (table.pop("aileron_right") - table.pop("aileron_left"))
    table["thrust_x"] = left + right
    table["thrust_m"] = ENGINE[2] * (left + right)
    table["thrust_n"] = ENGINE[1] * (left - right)
    part = np.cumsum(table.pop("part").diff() > 1.0)  # one file holds two manoeuvres
    table["flight"] = [f"{name} {k + 1}" for k in part]
    table["time"] = np.arange(len(table)) * 0.04
    parts = table.groupby("flight")
    from_end = np.minimum(parts.cumcount(), parts.cumcount(ascending=False))
    return table[from_end >= EDGE].reset_index(drop=True)


def uav(record, name):
    """Return the table of one manoeuvre of the UAV."""
    columns = {
        channel: factor * getattr(record, field) for channel, (field, factor) in UAV_FIELDS.items()
    }
    time = np.arange(len(record.time)) * 0.02
    return pd.DataFrame(columns).assign(time=time, density=1.2682, flight=name)


def hfb_320(folder):
    """Return aircraft, the first three quarters and the last one of a flight in turbulence, longitudinal."""
    log = np.loadtxt(Path(folder) / BOOK / "hfb320_1_10.asc").T
    table = pd.DataFrame({name: log[k] for name, k in HFB_CHANNELS.items()})
    dynamic_pressure, thrust = log[2:4]
    table["density"] = 2 * dynamic_pressure / table["airspeed"] ** 2
    table["thrust_x"] = thrust * np.cos(TILT)
    table["thrust_z"] = -thrust * np.sin(TILT)
    table["thrust_m"] = HFB_ENGINE[2] * table["thrust_x"] - HFB_ENGINE[0] * table["thrust_z"]
    n = 3 * len(table) // 4
    return HFB_320, table[:n].reset_index(drop=True), table[n:].reset_index(drop=True), {}


def small_uav(folder, split):
    """Return aircraft, training and test records of the UAV."""
    path = Path(folder) / UAV / "ProcessedData_2022_05_07_11_13_57.mat"
    records = loadmat(path, squeeze_me=True, struct_as_record=False)
    parts = []
    for names in RECORDS[split]:
        tables = [uav(records[name], name) for name in names.split()]
        parts.append(pd.concat(tables, ignore_index=True))
    return SMALL_UAV, *parts, {"thrust": None}


def swapped(folder, load):
    aircraft, train, test, loads = load(folder)
    return aircraft, test, train, loads


def simulated(folder, craft, train, test):
    """Return aircraft, training and test flight of the shared data."""
    flights = Path(folder) / "flights"
    tables = [read_flight(flights / f"{craft}_{part}.parquet") for part in (train, test)]
    return Aircraft.from_file(flights / f"{craft}.json"), *tables, {}


def ampyx_ap2(folder, n, tested):
    """Return the real flight in n parts of equal time, without those that are tested, and these."""
    table = read_flight(Path(folder) / "ampyx_ap2" / "ampyx_ap2.parquet")
    part = np.arange(len(table)) * n // len(table) + 1
    table["flight"] = [f"part {k}" for k in part]
    table = table.rename(columns={f"tether_{axis}": f"thrust_{axis}" for axis in "xyzlmn"})
    is_tested = np.isin(part, tested)
    parts = [table[rows].reset_index(drop=True) for rows in (~is_tested, is_tested)]
    return Aircraft.from_file(Path(folder) / "ampyx_ap2" / "ampyx_ap2.json"), *parts, {}


HFB = "HFB-320, last quarter, longitudinal"
LONGITUDINAL = ["CX", "CZ", "Cm"]
VIGGEN = partial(simulated, craft="viggen_uav")
SHARED = {
    "viggen": partial(VIGGEN, train="train_latlon", test="test_twoalt"),
    "c172p": partial(simulated, craft="c172p", train="train_latlon", test="test_calm"),
    "viggen lateral": partial(VIGGEN, train="train_lateral", test="test_twoalt"),
    "lateral to latlon": partial(VIGGEN, train="train_lateral", test="train_latlon"),
    "AP2, real": partial(ampyx_ap2, n=10, tested=[2, 4, 6, 8, 10]),
    **{f"AP2, quarter {k}": partial(ampyx_ap2, n=4, tested=[k]) for k in (1, 3, 4)},
}
REPOSITORY = {
    "ATTAS, three manoeuvres to their repetitions": attas,
    "the other way round": partial(swapped, load=attas),
    "its stall, first to second": attas_stall,
    "second to first": partial(swapped, load=attas_stall),
    "UAV of 3.3 kg, one split": partial(small_uav, split="a"),
    "another split": partial(small_uav, split="b"),
    HFB: hfb_320,
}


class Task(NamedTuple):
    """A flight to learn from, one to predict, the targets of both, and what is asked of the second."""

    aircraft: Aircraft
    train: pd.DataFrame
    test: pd.DataFrame
    targets: pd.DataFrame
    measured: pd.DataFrame
    truth: np.ndarray | None
    loads: dict


def task_of(name, data=None, repository=None):
    """Return the task of this name, of the shared data or of the repository."""
    aircraft, train, test, loads = (
        SHARED[name](data) if name in SHARED else REPOSITORY[name](repository)
    )
    targets, measured = (
        aerodynamic_coefficients(table, aircraft, **loads) for table in (train, test)
    )
    if name == HFB:
        targets, measured = targets[LONGITUDINAL], measured[LONGITUDINAL]
    truth = [f"{column}_true" for column in targets]
    truth = test[truth].to_numpy() if set(truth) <= set(test) else None
    return Task(aircraft, train, test, targets, measured, truth, loads)

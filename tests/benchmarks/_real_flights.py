"""Real flights of others: DLR's test aircraft ATTAS, its stall, and a UAV of 3.3 kg.

They are of the public repository github.com/josemiguelbento/UAV-OAT-controlo. Nothing of it stands
here: it states no licence. The manoeuvres of ATTAS in it are the flight data of Jategaonkar, Flight
Vehicle System Identification, 2nd edition (AIAA 2015), which the publisher gives away
(arc.aiaa.org/doi/suppl/10.2514/4.102790). Mass, geometry, positions of sensors and engines of ATTAS
are those of the book's ``umr_reg_attas.m``; those of the UAV are the repository's
``get_coefs_real.m``. Each function takes the folder of an unpacked copy.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import loadmat

from skdgp.dynamics import Aircraft

BOOK = Path("RVJategaonkar_codes_2ed/flt_data")
UAV = Path("get_coeffs/flight_data_1")
# Of ATTAS, from its centre of gravity [m]; the engine is the right one
ACCELEROMETER = (-1.010, 0.886, 0.103)
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
EDGE = 30  # Samples at either end of the manoeuvres of ATTAS that its filters made to ring
# Angle of the UAV's surfaces by its commands, about; another scale changes no error
TRAVEL = np.radians(25.0) / 2250.0


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
    log = np.column_stack(
        [np.full(len(log), np.nan), log]
    )  # channels from 1 on, as the book numbers them
    degrees = np.radians(log)
    rates = degrees[:, 7:10]
    vanes = degrees[:, 13:15]
    airspeed = log[:, 15]
    if boom:
        alpha, beta = vanes.T
        flow = [np.cos(beta) * np.cos(alpha), np.sin(beta), np.cos(beta) * np.sin(alpha)]
        u, v, w = airspeed * np.stack(flow) - np.cross(rates, BOOM).T
        airspeed = np.sqrt(u**2 + v**2 + w**2)
        vanes = np.column_stack([np.arctan2(w, u), np.arcsin(v / airspeed)])
    accelerations = degrees[:, 17:20]
    force = log[:, 2:5]
    if boom:  # the stalls hold them at the centre of gravity, as their header says
        force = (
            force
            - np.cross(accelerations, ACCELEROMETER)
            - np.cross(rates, np.cross(rates, ACCELEROMETER))
        )
    left = log[:, 37]
    right = log[:, 38]
    columns = {
        "time": np.arange(len(log)) * 0.04,
        "airspeed": airspeed,
        "alpha": vanes[:, 0],
        "beta": vanes[:, 1],
        **dict(zip(("ax", "ay", "az"), force.T, strict=True)),
        **dict(zip("pqr", rates.T, strict=True)),
        **dict(zip(("p_dot", "q_dot", "r_dot"), accelerations.T, strict=True)),
        **dict(zip(("phi", "theta", "psi"), degrees[:, 10:13].T, strict=True)),
        "altitude": (0.3048 if boom else 1.0) * log[:, 16],  # the stalls hold metres
        "density": log[:, 34],
        "elevator": degrees[:, 22],
        "aileron": 0.5 * (degrees[:, 29] - degrees[:, 28]),
        "rudder": degrees[:, 30],
        "thrust_x": left + right,
        "thrust_m": ENGINE[2] * (left + right),
        "thrust_n": ENGINE[1] * (left - right),
    }
    part = np.cumsum(np.diff(log[:, 1], prepend=log[0, 1]) > 1.0)  # one file holds two manoeuvres
    table = pd.DataFrame(columns).assign(flight=[f"{name} {k + 1}" for k in part])
    from_end = [
        table.groupby("flight").cumcount(ascending=ascending) for ascending in (True, False)
    ]
    return table[np.minimum(*from_end) >= EDGE].reset_index(drop=True)


def uav(record, name):
    """Return the table of one manoeuvre of the UAV."""
    angles = np.radians([record.roll, record.pitch, record.yaw])
    columns = {
        "time": np.arange(len(record.time)) * 0.02,
        "airspeed": record.Va,
        "alpha": np.radians(record.AoA),
        "beta": np.radians(record.beta),
        **{channel: getattr(record, channel) for channel in ("ax", "ay", "az", "p", "q", "r")},
        **dict(zip(("phi", "theta", "psi"), angles, strict=True)),
        "altitude": record.h,
        "v_north": record.VN,
        "v_east": record.VE,
        "v_down": record.VD,
        "density": 1.2682,
        "elevator": TRAVEL * record.delta_e,
        "aileron": TRAVEL * record.delta_a,
        "rudder": TRAVEL * record.delta_r,
        "throttle": record.delta_t / 100.0,
    }
    return pd.DataFrame(columns).assign(flight=name)

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
    table = pd.DataFrame({"time": np.arange(len(log)) * 0.04, "airspeed": airspeed})
    table[["alpha", "beta"]] = vanes
    table[["ax", "ay", "az"]] = force
    table[["p", "q", "r"]] = rates
    table[["p_dot", "q_dot", "r_dot"]] = accelerations
    table[["phi", "theta", "psi"]] = degrees[:, 10:13]
    table["altitude"] = (0.3048 if boom else 1.0) * log[:, 16]  # the stalls hold metres
    table["density"] = log[:, 34]
    table[["elevator", "rudder"]] = degrees[:, [22, 30]]
    table["aileron"] = 0.5 * (degrees[:, 29] - degrees[:, 28])
    table["thrust_x"] = left + right
    table["thrust_m"] = ENGINE[2] * (left + right)
    table["thrust_n"] = ENGINE[1] * (left - right)
    part = np.cumsum(np.diff(log[:, 1], prepend=log[0, 1]) > 1.0)  # one file holds two manoeuvres
    table["flight"] = [f"{name} {k + 1}" for k in part]
    parts = table.groupby("flight")
    from_end = np.minimum(parts.cumcount(), parts.cumcount(ascending=False))
    return table[from_end >= EDGE].reset_index(drop=True)


def uav(record, name):
    """Return the table of one manoeuvre of the UAV."""
    columns = {"time": np.arange(len(record.time)) * 0.02}
    for channel, (field, factor) in UAV_FIELDS.items():
        columns[channel] = factor * getattr(record, field)
    return pd.DataFrame(columns).assign(density=1.2682, flight=name)

"""Laws of sizes: numbers that every aeroplane has within limits, and the question where one is outside.

Errors over the spread of a coefficient are blind to the scale of mass, lengths and airspeed; numbers
without units show it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import THRUST_FORCES
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import SEA_LEVEL_DENSITY, STANDARD_GRAVITY
from skdgp._flight.physics._list import CHANNELS, DRIVES, FOOT, LIFT, SPEED_UNITS, drive_of
from skdgp._flight.physics._regression import Slope
from skdgp._flight.physics._signals import PHYSICS, Signals, signals_of
from skdgp._flight.tables import FlightTable, by_name

#: Sizes of an aircraft and medians of its flights [SI], and coefficients and derivatives, by name
Sizes: TypeAlias = Mapping[str, float]
#: Standard deviations outside of its limits by which a derivative contradicts a law
LEAST_T = 2.0
# At sea level [m/s]
SPEED_OF_SOUND = 340.0
# Columns of the force of the engine in body axes [N]
ENGINE = tuple(f"engine_{name}" for name in THRUST_FORCES)


class SizeLaw(NamedTuple):
    """A number without unit, a product of powers of sizes and derivatives, and its limits."""

    text: str
    powers: Mapping[str, float]
    least: float
    most: float
    #: Aircraft at the limits
    source: str
    #: Coefficient or derivative whose relative standard deviation the number has
    uncertain: str = ""

    def value(self, sizes: Sizes) -> float:
        """Return the number; raise KeyError if a size is not known."""
        factors = []
        for name, power in self.powers.items():
            size = FOLLOWING[name](sizes) if name in FOLLOWING else sizes[name]
            factors.append(abs(size) ** power)
        return float(np.prod(factors))


def usual_lift_slope(sizes: Sizes) -> float:
    """Return CL_alpha of a wing of the aspect ratio A at the Mach number M, 2 pi A / (2 + sqrt(4 + A^2 (1 - M^2))).

    Helmbold 1942, and the rule of Prandtl and Glauert, up to M = 0.8.
    """
    ratio = sizes["span"] ** 2 / sizes["wing_area"]
    mach = min(sizes.get("airspeed", 0.0) / SPEED_OF_SOUND, 0.8)
    return 2 * np.pi * ratio / (2 + np.sqrt(4 + ratio**2 * (1 - mach**2)))


# Sizes that follow from others
FOLLOWING: dict[str, Callable[[Sizes], float]] = {
    "usual lift slope": usual_lift_slope,
    "Ixx + Iyy": lambda sizes: sizes["Ixx"] + sizes["Iyy"],
    "air": lambda sizes: sizes.get("density", SEA_LEVEL_DENSITY),
    "tip speed": lambda sizes: sizes["propeller_speed"] * sizes["propeller.diameter"] / 2,
    "speed of sound": lambda sizes: SPEED_OF_SOUND,
}


def _radius(axis: str) -> dict[str, float]:
    """Return the powers of a radius of gyration over the span."""
    return {f"I{axis}{axis}": 0.5, "mass": -0.5, "span": -1.0}


# Of ten jets (Heffley & Jewell 1972, NASA CR-2144), two small UAVs (Beard & McLain 2012), light
# aircraft and gliders (Raymer, Aircraft Design), with a third of room or more
LAWS = (
    SizeLaw("aspect ratio", {"span": 2, "wing_area": -1}, 0.7, 55.0, "X-24B 1.1, eta 51"),
    SizeLaw("span times chord over wing area", {"span": 1, "chord": 1, "wing_area": -1}, 0.6, 2.2,
        "rectangle 1, triangle 1.33"),
    SizeLaw("relative density m / (rho S c)", {"mass": 1, "air": -1, "wing_area": -1, "chord": -1}, 0.5, 1500.0,
        "Gossamer Albatross 1.2, X-15 at altitude 1000"),
    SizeLaw("radius of gyration in roll over span", _radius("x"), 0.05, 0.35, "F-104 0.12, flying wings 0.19"),
    SizeLaw("radius of gyration in pitch over span", _radius("y"), 0.03, 0.85, "eta 0.05, X-15 0.58"),
    SizeLaw("radius of gyration in yaw over span", _radius("z"), 0.08, 0.9, "gliders 0.13, X-15 0.58"),
    SizeLaw("Ixx / Iyy over the aspect ratio", {"Ixx": 1, "Iyy": -1, "span": -2, "wing_area": 1}, 0.012, 1.0,
        "X-15 0.018, Cessna 310 0.60"),
    SizeLaw("Izz over Ixx + Iyy", {"Izz": 1, "Ixx + Iyy": -1}, 0.5, 1.1, "A-4 0.63, flat bodies 1"),
    SizeLaw("Ixz over the root of Ixx Izz", {"Ixz": 1, "Ixx": -0.5, "Izz": -0.5}, 0.0, 0.4, "gliders 0.04, T-6 0.15"),
    SizeLaw("diameter of the propeller over the span", {"propeller.diameter": 1, "span": -1}, 0.02, 1.2,
        "sustainers of gliders 0.05, V-22 0.83"),
    SizeLaw("Mach number of the propeller's tips", {"tip speed": 1, "speed of sound": -1}, 0.03, 1.2,
        "Gossamer Albatross 0.06, XF-84H 1.0"),
    SizeLaw("airspeed over the tip speed of the propeller", {"airspeed": 1, "tip speed": -1}, 0.01, 1.5,
        "propfans at Mach 0.8 1.1"),
    SizeLaw("upper bound of the drag by the thrust over the weight", {"drag": 1}, 0.01, 10.0, "eta 0.014"),
    SizeLaw("mass times the slope of ax over the thrust", {"mass_by_thrust": 1}, 0.5, 1.8,
        "Newton's second law 1, records of ATTAS 0.80 to 0.90", "mass_by_thrust"),
    SizeLaw("mass times the slope of ax over the thrust of the propeller", {"mass_by_propeller": 1}, 0.5, 1.8,
        "Newton's second law 1, a flight of turns 1.2", "mass_by_propeller"),
    SizeLaw("lift coefficient at the median of the flights", {"CL": 1}, 0.05, 2.3,
        "F-104 at sea level 0.07, flaps 2.2", "CL"),
    SizeLaw("CL_alpha over that of a wing of this aspect ratio", {"CZ_alpha": 1, "usual lift slope": -1}, 0.4, 1.7,
        "Aerosonde 0.63, JetStar at Mach 0.75 1.2", "CZ_alpha"),
    SizeLaw("Cl_p over CL_alpha of a wing of this aspect ratio", {"Cl_p": 1, "usual lift slope": -1}, 0.02, 0.3,
        "0.06 to 0.11", "Cl_p"),
    SizeLaw("Cm_q", {"Cm_q": 1}, 0.1, 150.0, "Skywalker X8 1.3, Aerosonde 38", "Cm_q"),
    SizeLaw("Cn_r", {"Cn_r": 1}, 0.0, 3.0, "Zagi 0.004, X-15 1.0", "Cn_r"),
)  # fmt: skip

# Powers of mass and span in the sizes that are estimated by them
ESTIMATES = {
    "mass": dict.fromkeys(("Ixx", "Iyy", "Izz"), 1.0),
    "span": {"chord": 1.0, "wing_area": 2.0, **dict.fromkeys(("Ixx", "Iyy", "Izz"), 2.0)},
}
# Powers of sizes in the coefficients that follow from a log
OF_LOAD = {"mass": 1.0, "wing_area": -1.0, "airspeed": -2.0}
POWERS = {
    "CL": OF_LOAD,
    "CZ_alpha": OF_LOAD,
    "mass_by_thrust": {"mass": 1.0, "thrust": -1.0},
    "mass_by_propeller": {"mass": 1.0, "propeller.diameter": -4.0, "propeller_speed": -2.0},
    # where the thrust dominates the drag
    "drag": {
        "thrust": 1.0,
        "thrust_line.direction": 1.0,
        "propeller.diameter": 4.0,
        "propeller_speed": 2.0,
    },
    "Cl_p": {"Ixx": 1.0, "wing_area": -1.0, "span": -2.0, "airspeed": -1.0},
    "Cm_q": {"Iyy": 1.0, "wing_area": -1.0, "chord": -2.0, "airspeed": -1.0},
    "Cn_r": {"Izz": 1.0, "wing_area": -1.0, "span": -2.0, "airspeed": -1.0},
}
MOMENTS = ("Ixx", "Iyy", "Izz", "Ixz")
# Sizes that are given together, in one unit
TOGETHER = {"Ixx": MOMENTS[1:]}
POUND = 0.45359237
OF_LENGTHS = {"ft": FOOT, "cm": 0.01, "mm": 0.001, "in": FOOT / 12}
SI_UNITS = {
    "mass": "kg",
    "span": "m",
    "chord": "m",
    "wing_area": "m^2",
    "airspeed": "m/s",
    **dict.fromkeys(MOMENTS, "kg m^2"),
    "thrust": "N",
    "propeller.diameter": "m",
    "propeller_speed": "rad/s",
    "thrust_line.direction": "forward",
}
# Other units of sizes, in the SI unit
UNITS = {
    "mass": {"lb": POUND, "g": 0.001},
    "span": {**OF_LENGTHS, "m of half the span": 2.0},
    "chord": OF_LENGTHS,
    "wing_area": {"ft^2": FOOT**2, "dm^2": 0.01, "cm^2": 1e-4, "m^2 of one wing": 2.0},
    "Ixx": {
        "slug ft^2": 1.3558179,
        "kgf m s^2": STANDARD_GRAVITY,
        "lb ft^2": POUND * FOOT**2,
        "g m^2": 0.001,
        "kg cm^2": 1e-4,
    },
    "thrust": {"lbf": POUND * STANDARD_GRAVITY},
    "airspeed": SPEED_UNITS,
    "propeller.diameter": {**OF_LENGTHS, "m of the radius": 2.0},
    "propeller_speed": {"rpm": np.pi / 30, "1/s": 2 * np.pi},
    "thrust_line.direction": {},
}
# Factors of a slip of the decimal point, which is asked about after units, in sizes that an owner types
SLIPS = {"with a decimal place too many": 0.1, "with a decimal place too few": 10.0}
TYPED = ("mass", "span", "chord", "wing_area")


def question_of_sizes(
    sizes: Sizes, stds: Mapping[str, float], estimated: Collection[str] = ()
) -> Finding | None:
    """Return the finding of numbers that break a law, None if all hold.

    It asks for sizes in these laws: at most three that would keep all laws in another unit or with another decimal
    place, then the others as they are.
    Sizes that were ``estimated`` follow mass and span, and are asked for as they are.
    """
    # the same in all units
    relative = {name: std / max(abs(sizes[name]), 1e-12) for name, std in stds.items()}
    broken = _broken(sizes, relative)
    if not broken:
        return None
    laws = []
    for law in broken:
        numbers = {"value": law.value(sizes), "least": law.least, "most": law.most}
        laws.append(Finding(Code.BROKEN_LAW, channel=law.text, **numbers))
    # a factor of four has exact roots
    quadrupled = {name: _in_other_unit(sizes, name, 4.0, estimated) for name in UNITS}
    asked = [
        name
        for name, other in quadrupled.items()
        if name in sizes and any(law.value(other) != law.value(sizes) for law in broken)
    ]
    given = [name for name in asked if name not in estimated]
    others = [(name, factor, unit) for name in given for unit, factor in UNITS[name].items()]
    if "airspeed" in given:
        indicated = (SEA_LEVEL_DENSITY / FOLLOWING["air"](sizes)) ** 0.5
        others.append(("airspeed", indicated, "m/s of indicated airspeed"))
    typed = [name for name in TYPED if name in given]
    others += [(name, factor, slip) for name in typed for slip, factor in SLIPS.items()]
    likely: list[tuple[str, float, str]] = []
    for name, factor, unit in others:
        changed = _in_other_unit(sizes, name, factor, estimated)
        if len(likely) < 3 and not _broken(changed, relative):
            likely.append((name, factor, unit))
    named = {name for name, *_ in likely}
    if _compares_moments(broken, sizes):
        asked += [name for name in MOMENTS if name in sizes and name not in asked]
    likely += [(name, 1.0, "") for name in asked if name not in named]
    questions = []
    for name, factor, unit in likely:
        remark = ", an estimate" if name in estimated else ""
        questions.append(
            Finding(
                Code.ASKED_SIZE,
                channel=name,
                value=factor * sizes[name],
                si_unit=SI_UNITS[name] + remark,
                given=sizes[name],
                unit=unit,
            )
        )
    return Finding(Code.SIZES_QUESTIONED, laws=laws, asked=questions)


def _compares_moments(broken: Collection[SizeLaw], sizes: Sizes) -> bool:
    """Return whether a law that is broken compares moments of inertia: no unit changes their ratio."""
    other = _in_other_unit(sizes, "Ixx", 4.0, ())
    of_moments = [law for law in broken if not law.powers.keys().isdisjoint(MOMENTS)]
    return any(law.value(other) == law.value(sizes) for law in of_moments)


def _broken(sizes: Sizes, relative: Mapping[str, float]) -> list[SizeLaw]:
    """Return the laws whose numbers are surely outside of their limits, by relative standard deviations.

    The numbers are positive, so their logarithms have the error. It adds to half of the width of the limits as
    independent deviations do, and in full to an upper limit without a lower one.
    """
    broken = []
    for law in LAWS:
        half = np.log(law.most / law.least) / 2 if law.least else 0.0
        width = np.hypot(half, LEAST_T * relative.get(law.uncertain, 0.0))
        # a law of unknown sizes is not broken
        with suppress(KeyError):
            beyond = np.log(max(law.value(sizes), 1e-9) / law.most) + half
            if beyond > width or (law.least and -beyond > width):
                broken.append(law)
    return broken


def _in_other_unit(
    sizes: Sizes, name: str, factor: float, estimated: Collection[str]
) -> dict[str, float]:
    """Return the sizes with one in another unit, and the numbers that follow from it."""
    powers = dict.fromkeys((name, *TOGETHER.get(name, ())), 1.0)
    for follower, power in ESTIMATES.get(name, {}).items():
        if follower in estimated:
            powers[follower] = power
    for quantity, factors in POWERS.items():
        of_sizes = [power * powers.get(size, 0.0) for size, power in factors.items()]
        powers[quantity] = sum(of_sizes)
    return {size: value * factor ** powers.get(size, 0.0) for size, value in sizes.items()}


def sizes_in_flight(
    flights: FlightTable,
    mass: float,
    wing_area: float,
    thrust: Matrix | None = None,
    thrust_std: float = 0.0,
) -> tuple[dict[str, float], dict[str, float]]:
    """Return numbers of flights and their standard deviations, by the channels that they have.

    Median airspeed, density and CL, CZ_alpha by the vane, the mass times the slope of ax over the thrust, and
    the upper bound of the median drag over the weight by the ``thrust`` (n, 3) [N], with the relative
    standard deviation ``thrust_std``.
    """
    if thrust is not None:
        flights = replace(flights, table=flights.table.assign(**by_name(ENGINE, thrust)))
    signals = signals_of(flights, (*CHANNELS, *ENGINE))
    numbers: dict[str, float] = {}
    stds: dict[str, float] = {}
    if "airspeed" not in signals:
        return numbers, stds
    density = SEA_LEVEL_DENSITY
    if "density" in flights.table:
        density = float(np.nanmedian(flights.column("density")))
    numbers |= {"airspeed": float(np.nanmedian(signals["airspeed"])), "density": density}
    load = 2 * mass / (density * wing_area)
    if "az" in signals:
        numbers["CL"] = -load * float(np.nanmedian(signals["az"] / signals["airspeed"] ** 2))
    if {"ax", "az", "alpha", ENGINE[0], ENGINE[2]} <= signals.channels.keys():
        numbers["drag"] = _largest_drag(signals, mass, thrust_std)
    laws = [(drive, "mass_by_thrust", mass) for drive in DRIVES.values() if drive.x in signals]
    if not laws:
        laws = [(drive_of(ENGINE[0], "1/kg"), "mass_by_propeller", mass)]
    for law, name, scale in [*laws, (LIFT, "CZ_alpha", load)]:
        slope = law.slopes(signals).get(0.0)
        if slope is not None and slope.n_effective >= PHYSICS.least_samples:
            middle, std = _in_bounds(slope)
            numbers[name] = scale * middle
            stds[name] = scale * std
            if name == "mass_by_propeller":
                stds[name] = float(np.hypot(stds[name], thrust_std * numbers[name]))
            if name == "mass_by_thrust":
                numbers["thrust"] = float(np.nanmedian(signals[law.x]))
    return numbers, stds


def _largest_drag(signals: Signals, mass: float, thrust_std: float) -> float:
    """Return the upper bound of the median drag over the weight, a millionth if it is negative.

    Standard deviations are that of the thrust, 0.03 rad of alpha and 0.3 m/s^2 of ax (guesses).
    """
    forward, down = np.cos(signals["alpha"]), np.sin(signals["alpha"])
    thrust = (forward * signals[ENGINE[0]] + down * signals[ENGINE[2]]) / mass
    drag = thrust - forward * signals["ax"] - down * signals["az"]
    stds = [thrust_std * np.nanmedian(thrust), 0.03 * np.nanmedian(signals["az"]), 0.3]
    largest = np.nanmedian(drag) + LEAST_T * np.linalg.norm(stds)
    return max(float(largest) / STANDARD_GRAVITY, 1e-6)


def _in_bounds(slope: Slope) -> tuple[float, float]:
    """Return the middle of the bounds of a slope in logarithms, and a standard deviation that covers both.

    Noise of the regressor attenuates the slope; the reverse regression bounds it (Frisch 1934).
    """
    correlation = abs(slope.correlation)
    middle = slope.value / correlation
    relative = slope.std / abs(slope.value) - np.log(correlation) / LEAST_T
    return middle, abs(middle) * relative

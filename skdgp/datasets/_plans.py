"""Plans of the example flights, read from ``example_flights.toml``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skdgp._compute.files import read_toml
from skdgp._flight.excitation import Steps, Wavetrain, doublet, multisine, three_two_one_one

WAVES: dict[str, Callable[..., Any]] = {
    "doublet": doublet,
    "3-2-1-1": three_two_one_one,
    "multisine": multisine,
    "steps": Steps,
}


@dataclass(frozen=True)
class FlightPlan:
    """Plan of one flight: path, wind, and manoeuvres added to the controls."""

    name: str
    # (from time [s], centre north, centre east, radius [m]); a negative radius turns left
    orbits: list[list[float]]
    # (from time [s], altitude [m])
    altitudes: list[list[float]]
    # (from time [s], airspeed [m/s])
    airspeeds: list[list[float]]
    # mean velocity of the air, NED [m/s]
    wind: list[float]
    # wind near the ground [m/s], which sets the turbulence
    wind_at_6m: float
    # additions to elevator, aileron, rudder [rad] and throttle
    manoeuvres: Wavetrain

    @classmethod
    def of(cls, plan: Mapping[str, Any]) -> FlightPlan:
        """Return the plan of a table of the file."""
        inputs = {}
        for axis, entries in plan["manoeuvres"].items():
            inputs[axis] = {entry["start"]: _wave(**entry) for entry in entries}
        return cls(**{**plan, "manoeuvres": Wavetrain(inputs)})


def _wave(wave: str, start: float, **parameters: Any) -> Any:
    """Return an input by its kind and parameters."""
    if wave == "multisine":
        parameters["harmonics"] = range(*parameters["harmonics"])
    return WAVES[wave](**parameters)


PLANS = read_toml(Path(__file__).with_name("example_flights.toml"))["flights"]
FLIGHT_PLANS = tuple(FlightPlan.of(plan) for plan in PLANS)

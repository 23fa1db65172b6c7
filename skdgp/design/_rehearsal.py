"""Rehearsal of manoeuvres: simulations in calm air, and the largest inputs that stay inside the limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.messages import notify
from skdgp._flight.excitation import ROUNDING, Steps, Wavetrain
from skdgp.design._envelope import OPTIONS, Range, quantities, regressors_of
from skdgp.design._library import RATE, RESPONSE, ROW_STEP, Inputs, duration_of, scaled
from skdgp.dynamics import Aerodynamics, Aircraft, Trim, simulate

# Seconds after a manoeuvre without action of the pilot
REACTION = 1.0
# Fraction of the limits below which a manoeuvre is left out
LEAST_SCALE = 0.2
# Least and largest factor of a reduction of a manoeuvre at once
SHRINK = (0.7, 0.98)


class Rehearsed(NamedTuple):
    """A manoeuvre that stays inside the limits, and its flight with the response after it."""

    name: str
    inputs: Inputs
    scale: float  # relative to the limits of the axes
    flight: pd.DataFrame


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """Simulations of manoeuvres of some axes from a trim, by the mean of a model in calm air, inside bounds."""

    model: Aerodynamics
    aircraft: Aircraft
    trim: Trim
    axes: tuple[str, ...]
    bounds: Mapping[str, Range]  #: Lowest and highest value of each limited channel
    margin: float  #: Of responses to the bounds
    thrust: Any

    def inside(
        self, manoeuvres: Mapping[str, Inputs], seconds: float, pause: float
    ) -> list[Rehearsed]:
        """Return the manoeuvres that fit into the time with a pause, each as large as the limits allow."""
        full = _that_last(manoeuvres, seconds - pause)
        centre = self._centre()
        scales = dict.fromkeys(full, 1.0)
        inside = []
        cause = ""
        notify(f"planning: size of {len(scales)} manoeuvres", 0, np.nan)
        while scales:
            sized = {name: scaled(full[name], scale) for name, scale in scales.items()}
            for name, flight in self._flights(sized).items():
                factors = self._factors(sized[name], flight, centre)
                scale = scales.pop(name)
                if factors.min() >= 1.0:
                    inside.append(Rehearsed(name, sized[name], scale, flight))
                    continue
                # responses are nearly proportional to inputs
                scale *= float(np.clip(factors.min(), *SHRINK))
                cause = str(factors.idxmin())
                if scale >= LEAST_SCALE:
                    scales[name] = scale
        if not inside:
            raise ValueError(
                f"Got an envelope that every manoeuvre leaves even at {LEAST_SCALE:.0%} of the limits; the last one "
                f"leaves it by {_with_option(cause)}: widen this limit, or fly another airspeed or altitude."
            )
        return inside

    def _flights(self, manoeuvres: Mapping[str, Inputs]) -> dict[str, pd.DataFrame]:
        """Return the flights of manoeuvres, each with its response after it."""
        longest = max(map(duration_of, manoeuvres.values())) + RESPONSE
        tables = []
        for inputs in manoeuvres.values():
            train = Wavetrain({axis: {0.0: signal} for axis, signal in inputs.items()})
            pause = longest - train.duration
            tables.append(train.table(RATE, trim=self.trim.controls, pause=pause))
        flown = simulate(
            self.model,
            self.aircraft,
            [self.trim] * len(tables),
            tables,
            ROW_STEP,
            duration=ROW_STEP * np.floor(longest / ROW_STEP + ROUNDING),
            thrust=self.thrust,
        )
        flights = {}
        parts = np.array_split(np.arange(len(flown)), len(tables))
        for (name, inputs), rows in zip(manoeuvres.items(), parts, strict=True):
            flight = flown.iloc[rows].reset_index(drop=True)
            flights[name] = flight[flight["time"] <= duration_of(inputs) + RESPONSE + ROUNDING]
        return flights

    def _channels(self, flight: pd.DataFrame) -> pd.DataFrame:
        """Return the values of each of the bounds along one flight."""
        values = quantities(flight)
        names = self.model.regressors
        values[[*names]] = regressors_of(flight, self.aircraft, names)
        return values[[*self.bounds]]

    def _centre(self) -> pd.Series:
        """Return the limited channels in trimmed flight; raise ValueError if they leave their limits."""
        nothing: Inputs = {self.axes[0]: Steps([1.0], [0.0])}
        centre = self._channels(self._flights({"trim": nothing})["trim"]).iloc[0]
        for name, (low, high) in self.bounds.items():
            if centre[name] < low or centre[name] > high:
                raise ValueError(
                    f"Got an envelope that trimmed flight at {self.trim.airspeed:g} m/s and {self.trim.altitude:.0f} m "
                    f"leaves by {_with_option(name)}: widen this limit, or choose another airspeed or altitude."
                )
        return centre

    def _factors(self, inputs: Inputs, flight: pd.DataFrame, centre: pd.Series) -> pd.Series:
        """Return for each limit the factor of the response that meets it, with the margin."""
        if (flight["ended"] != "").any():
            return pd.Series({"the end of the simulation": 0.0})
        unattended = duration_of(inputs) + REACTION + ROUNDING
        response = self._channels(flight[flight["time"] <= unattended]) - centre
        is_response = ~response.columns.isin(self.axes)  # a control has none
        response *= 1.0 + self.margin * is_response
        low, high = np.array([*self.bounds.values()]).T - centre.to_numpy()
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = response.rdiv(1.0) * np.where(response > 0, high, low)
        return factors.where(np.isfinite(factors), np.inf).min()


def _with_option(name: str) -> str:
    """Return a limited channel with the option that changes its limit."""
    return f"{name} ({OPTIONS.get(name, '--growth')})"


def _that_last(manoeuvres: Mapping[str, Inputs], longest: float) -> dict[str, Inputs]:
    """Return the manoeuvres of at most a duration [s]; raise ValueError if there is none."""
    short = {name: inputs for name, inputs in manoeuvres.items() if duration_of(inputs) <= longest}
    if not short:
        shortest = min(map(duration_of, manoeuvres.values()))
        raise ValueError(
            f"Got {max(longest, 0.0):.3g} s for a manoeuvre between its pauses, but expected at least "
            f"{shortest:.3g} s: give {shortest - longest:.3g} s more."
        )
    return short

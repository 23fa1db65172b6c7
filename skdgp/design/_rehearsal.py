"""Manoeuvres in simulation: flown by the mean of a model, and by aircraft that are drawn from it in gusts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._excitation import ROUNDING, Steps, Wavetrain
from skdgp.design._envelope import GROWTH, Envelope, option_of
from skdgp.design._library import MULTISINES, RATE, Inputs
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    Trim,
    UncertainStart,
    as_aerodynamics,
    simulate,
)

ROW_STEP = 0.04  # time between rows of a simulation [s]
ENTRY = {"phi": 0.035, "theta": 0.035}  # standard deviations of angles of entry from trim [rad]
ENTRY_SPEED = 0.02  # standard deviation of the airspeed of entry, relative to it
ENTRY_CONTROLS = 0.02  # standard deviation of held controls, relative to their limits
LEAST = 0.2  # fraction of the limits below which a manoeuvre is left out
RESPONSE = 3.0  # seconds of response after a manoeuvre that the flight records
REACTION = 1.0  # seconds after a manoeuvre without action of the pilot


class Hold(NamedTuple):
    """Trimmed flight of the mean and of aircraft that are drawn, and the envelope around it."""

    centre: Matrix  # channels of the envelope by the mean, (n, c)
    drawn: Array  # the same by each aircraft, (paths, n, c)
    low: Vector  # of the envelope, (c,)
    high: Vector
    margin: Vector  # relative excess of the response, (c,)
    allowed: int  # paths that may leave

    def response(self, values: Matrix) -> Matrix:
        """Return the deviation of channels (n, c) from trimmed flight."""
        return values - self.centre[self._rows(values)]

    def largest(self, responses: Array) -> float:
        """Return the factor of growth of responses (paths or 1, n, c) to inputs, until more paths leave than may."""
        still = self.drawn[:, self._rows(responses[0])]
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = (np.where(responses > 0, self.high, self.low) - still) / responses
        factors = np.where(np.isfinite(factors), factors, np.inf).min(axis=(1, 2))
        return max(0.0, float(np.partition(factors, self.allowed)[self.allowed]))

    def _rows(self, values: Matrix) -> Indices:
        return np.minimum(np.arange(len(values)), len(self.centre) - 1)


class Checked(NamedTuple):
    """What a manoeuvre risks."""

    risk: float
    causes: str  # the limits that it leaves
    flight: pd.DataFrame  # by the mean
    paths: pd.DataFrame  # by aircraft that are drawn, or by the mean without a posterior
    factor: float  # possible growth, if responses grow with it


@dataclass(eq=False)
class Rehearsal:
    """Flights of manoeuvres from a trim."""

    model: Aerodynamics | BaseEstimator
    aircraft: Aircraft
    point: Trim
    limits: Mapping[str, float]
    envelope: Envelope
    pause: float  # at the trim before and after each manoeuvre [s]
    thrust: Any
    seed: int

    def __post_init__(self) -> None:
        self.aerodynamics = as_aerodynamics(self.model)
        self.response = min(RESPONSE, self.pause)  # flown after each manoeuvre too [s]
        self._nothing: Inputs = {
            next(iter(self.limits)): Steps([max((*MULTISINES, self.response))], [0.0])
        }

    @cached_property
    def still(self) -> pd.DataFrame:
        """Trimmed flight of the mean, as long as the longest multisine."""
        return self.flown([self._nothing])[0]

    def flown(self, several: Sequence[Inputs]) -> list[pd.DataFrame]:
        """Return the flights of manoeuvres, each with its response after it, by the mean."""
        trains, tables = self._tables(several)
        shortest = min(table["time"].iloc[-1] for table in tables)
        flown = self._simulated([self.point] * len(tables), tables, shortest)
        parts = (
            [flown] if len(tables) == 1 else [part for _, part in flown.groupby("start", sort=True)]
        )
        return [self._cut(part, train) for part, train in zip(parts, trains, strict=True)]

    def drawn(self, inputs: Inputs, n_paths: int, gusts: Any = None) -> pd.DataFrame:
        """Return flights of a manoeuvre by aircraft and entries that are drawn, or by the mean without a posterior."""
        if not (n_paths and self.aerodynamics.is_uncertain):
            return self.flown([inputs])[0]
        (train,), tables = self._tables([inputs])
        rng, time = np.random.default_rng(self.seed), tables[0].pop("time").to_numpy()
        spreads = {axis: ENTRY_CONTROLS * limit for axis, limit in self.limits.items()}
        beside = {
            axis: spread * rng.standard_normal((n_paths, 1)) for axis, spread in spreads.items()
        }
        columns = {str(name): values.to_numpy() for name, values in tables[0].items()}

        def controls(t: float, state: Any) -> dict[str, Any]:
            return {
                name: np.interp(t, time, values) + beside.get(name, 0.0)
                for name, values in columns.items()
            }

        entry = UncertainStart([self.point], ENTRY | {"u": ENTRY_SPEED * self.point.airspeed})
        options = {"n_paths": n_paths, "random_state": self.seed, "air": Air(gusts=gusts)}
        return self._cut(self._simulated(entry, controls, time[-1], **options), train)

    def _tables(self, several: Sequence[Inputs]) -> tuple[list[Wavetrain], list[pd.DataFrame]]:
        """Return manoeuvres, and the controls of their flights."""
        trains = [
            Wavetrain({axis: {0.0: signal} for axis, signal in inputs.items()})
            for inputs in several
        ]
        longest = max(train.duration for train in trains) + self.response
        tables = [
            train.table(RATE, trim=self.point.controls, pause=longest - train.duration)
            for train in trains
        ]
        return trains, tables

    def _simulated(self, starts: Any, controls: Any, until: float, **options: Any) -> pd.DataFrame:
        options |= {"duration": ROW_STEP * np.floor(until / ROW_STEP + 1e-6), "thrust": self.thrust}
        return simulate(self.model, self.aircraft, starts, controls, ROW_STEP, **options)

    def _cut(self, flight: pd.DataFrame, train: Wavetrain) -> pd.DataFrame:
        return flight[flight["time"] <= train.duration + self.response + 1e-6].reset_index(
            drop=True
        )

    @cached_property
    def hold(self) -> Hold:
        """Trimmed flight and the room around it; raise ValueError if gusts alone leave the envelope."""
        paths = self.drawn(self._nothing, self.envelope.n_paths, self.envelope.gusts)
        begun = paths[paths["time"] <= self.response + 1e-6]
        risk, causes = self.risk(begun)
        if risk > self.envelope.risk:
            raise ValueError(
                f"Got an envelope that trimmed flight at {self.point.airspeed:g} m/s and "
                f"{self.point.altitude:.0f} m "
                f"leaves in {risk:.0%} of cases within {self.response:g} s, by {causes}, but "
                f"expected at most {self.envelope.risk:.0%}: widen this limit, choose another "
                f"airspeed or altitude, or weaker gusts."
            )
        limits = self.envelope.bounds(self.aerodynamics)
        is_set = [
            name.removeprefix(GROWTH) in self.limits for name in limits
        ]  # a control has no response
        margin = np.where(is_set, 0.0, self.envelope.margin)
        low, high = np.array([*limits.values()]).T
        centre, allowed = self.channels(self.still), 0
        if self.aerodynamics.is_uncertain:
            allowed = int(np.floor(self.envelope.risk * (self.envelope.n_paths + 2) - 1 + ROUNDING))
        return Hold(
            centre, self.channels(paths).reshape(-1, *centre.shape), low, high, margin, allowed
        )

    def room(self, flight: pd.DataFrame) -> float:
        """Return the largest factor of a manoeuvre whose response fits into the envelope, for all aircraft drawn."""
        response = self.hold.response(self.channels(self._unattended(flight)))
        return self.hold.largest((1 + self.hold.margin) * response[None])

    def _unattended(self, flight: pd.DataFrame) -> pd.DataFrame:
        """Return flights of a manoeuvre until the pilot acts."""
        return flight[
            flight["time"] <= flight["time"].max() - max(0.0, self.response - REACTION) + 1e-6
        ]

    def channels(self, flight: pd.DataFrame) -> Matrix:
        """Return the limited quantities along flights, one after another, (n, c)."""
        return self.envelope.channels(flight, self.aircraft, self.aerodynamics).to_numpy()

    def checked(self, inputs: Inputs) -> Checked:
        """Return the risk of a manoeuvre and its flights, and how much larger it may be."""
        flight = self.flown([inputs])[0]
        n_paths, gusts = self.envelope.n_paths, self.envelope.gusts
        paths = self.drawn(inputs, n_paths, gusts) if self.aerodynamics.is_uncertain else flight
        margin = self.hold.margin * self.hold.response(self.channels(self._unattended(flight)))
        counted = self._unattended(paths)
        flown = self.channels(counted).reshape(-1, *margin.shape)
        factor = self.hold.largest(flown + margin - self.hold.drawn[:, self.hold._rows(margin)])
        return Checked(*self.risk(counted, np.tile(margin, (len(flown), 1))), flight, paths, factor)

    def risk(self, flight: pd.DataFrame, margin: Matrix | float = 0.0) -> tuple[float, str]:
        """Return the risk that flights leave the envelope, and the limits that they leave, with their options."""
        exceeded = self.envelope.left(flight, self.aircraft, self.aerodynamics, margin)
        by_path = exceeded.groupby(flight["flight"].to_numpy(), sort=False).any()
        shares = by_path.mean().sort_values(ascending=False)
        shares = shares[shares > 0]
        causes = ", ".join(
            f"{name} ({share:.0%}, {option_of(str(name), self.aerodynamics)})"
            for name, share in shares.items()
        )
        n_left = int(by_path.any(axis=1).sum())
        risk = (
            (n_left + 1) / (self.envelope.n_paths + 2)
            if self.aerodynamics.is_uncertain
            else float(n_left)
        )
        return risk, causes.replace(GROWTH, "flown ")

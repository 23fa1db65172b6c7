"""Planned flights: manoeuvres, promised standard deviations, risks, and their file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.files import plain
from skdgp._compute.typing import Matrix
from skdgp._display.page import number, percent, table, text
from skdgp._excitation import Signal, Wavetrain
from skdgp.design._envelope import GROWTH, QUANTITIES, quantities
from skdgp.design._rehearsal import REACTION, RESPONSE
from skdgp.dynamics import Aerodynamics, Aircraft, Trim, stability_derivatives

TRIM = ("airspeed", "altitude", "climb", "alpha", "beta", "phi", "theta", "state", "controls")


@dataclass(frozen=True, eq=False)
class Plan:
    """Flights that `plan` has chosen, with promised standard deviations; `write_flight_card` draws them.

    Parameters
    ----------
    trains : tuple of Wavetrain
        The inputs, a wavetrain for each trim that is flown.
    trims : tuple of Trim
        Where each wavetrain begins, and to which the aircraft is returned before each manoeuvre.
    manoeuvres : DataFrame
        In the order of flight: ``train`` (number of its wavetrain), ``airspeed`` [m/s] of its trim,
        ``start`` [s], ``name``, ``duration`` [s], ``pause`` [s] after it, ``scale`` (relative to
        the limits), ``risk`` (predicted probability of leaving the envelope; NaN without
        posterior), and ``gain`` (relative reduction of the standard errors of the goal by linear
        least squares, on geometric average).
    flight : DataFrame
        Expected: the mean of the model, from its trim for each manoeuvre; ``flight`` numbers them.
        Of a model with a posterior also the band of 95 % of the aircraft drawn: ``alpha_low``,
        ``alpha_high`` and so on.
    errors : DataFrame
        Standard deviations of the derivatives of the goal at the trims, as of
        :func:`skdgp.dynamics.stability_derivatives` (root mean square over the trims): ``before``
        the flight, and ``promised`` of a model learned from this flight too. NaN where the model
        has no posterior, or does not hold its rows.
    limits : DataFrame
        ``low`` and ``high`` limits of all manoeuvres: see :meth:`Envelope.bounds`.
    aircraft : Aircraft
    gusts : tuple of float, optional
        Standard deviations [m/s] of the gusts u, v, w of the predicted risks; None: in calm
        air.
    """

    trains: tuple[Wavetrain, ...]
    trims: tuple[Trim, ...]
    manoeuvres: pd.DataFrame
    flight: pd.DataFrame
    errors: pd.DataFrame
    limits: pd.DataFrame
    aircraft: Aircraft
    gusts: tuple[float, ...] | None = None
    #: Seconds of response after a manoeuvre that the flight records
    response: ClassVar[float] = RESPONSE
    #: Seconds after a manoeuvre without action of the pilot, which its risk includes
    reaction: ClassVar[float] = REACTION

    @property
    def risk(self) -> float:
        """Predicted probability that any manoeuvre leaves the envelope, if they are independent."""
        return float(1.0 - np.prod(1.0 - self.manoeuvres["risk"]))

    @property
    def seconds(self) -> float:
        """Of all flights together, pauses included [s]."""
        first = self.manoeuvres.groupby("train")["start"].first()
        return float(first.sum() + self.manoeuvres[["duration", "pause"]].to_numpy().sum())

    @property
    def remaining(self) -> float:
        """Promised standard deviations over those before, their geometric mean."""
        return float(np.exp(np.log(self.errors["promised"] / self.errors["before"]).mean()))

    def inputs(self, k: int) -> dict[str, Signal]:
        """Return the inputs of a row of ``manoeuvres`` by axis."""
        row = self.manoeuvres.iloc[k]
        events = self.trains[int(row["train"])].events()
        return {axis: signal for axis, start, signal in events if np.isclose(start, row["start"])}

    def expected(self, rows: Sequence[int]) -> pd.DataFrame:
        """Return the ``low`` and ``high`` ends that some rows of ``manoeuvres`` are expected to reach."""
        flight = self.flight[self.flight["flight"].isin(list(rows))]
        means = quantities(flight)
        ends = {
            end: pd.DataFrame({name: flight.get(f"{name}_{end}", means[name]) for name in means})
            for end in ("low", "high")
        }
        return pd.DataFrame({"low": ends["low"].min(), "high": ends["high"].max()})

    @property
    def abort_limits(self) -> pd.DataFrame:
        """``low``, ``high`` and ``source`` of the quantities that have a limit, the narrower of asked and flown."""
        sources = {"asked": "", "flown": GROWTH}
        tables = {
            word: self.limits.reindex([start + name for name in QUANTITIES]).set_axis(QUANTITIES)
            for word, start in sources.items()
        }
        low = pd.concat([table["low"] for table in tables.values()], axis=1).max(axis=1)
        high = pd.concat([table["high"] for table in tables.values()], axis=1).min(axis=1)
        low["airspeed"] = low["airspeed"] if low["airspeed"] > 0 else -np.inf
        limits = pd.DataFrame({"low": low, "high": high})
        finite = limits.where(np.isfinite(limits))
        is_of = {word: finite.eq(table).any(axis=1) for word, table in tables.items()}
        limits["source"] = [
            ", ".join(word for word in sources if is_of[word][name]) for name in QUANTITIES
        ]
        return limits[limits["source"] != ""]

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain values, SI units and radians."""
        return {
            "aircraft": self.aircraft.name,
            "trims": [{name: plain(getattr(trim, name)) for name in TRIM} for trim in self.trims],
            "manoeuvres": self.manoeuvres.to_dict("records"),
            "risk": self.risk,
            "gusts": self.gusts,
            "limits": self.limits.to_dict("index"),
            "errors": self.errors.to_dict("index"),
        }


def std_at(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    trims: Sequence[Mapping[str, Any]],
    thrust: Any,
    added: Matrix | None = None,
) -> pd.Series:
    """Return the standard deviations of `stability_derivatives` by name, root mean square over trims.

    Trims have "state" and "controls". The result is empty for a model without a posterior.
    """
    states = np.array([trim["state"] for trim in trims], dtype=float)
    names = trims[0]["controls"]
    controls = {name: np.array([trim["controls"][name] for trim in trims]) for name in names}
    derivatives = stability_derivatives(
        model, aircraft, states, controls, thrust=thrust, added=added
    )
    if "std" not in derivatives:
        return pd.Series(dtype=float)
    return np.sqrt((derivatives["std"] ** 2).groupby(level=1).mean())


@dataclass(frozen=True, eq=False)
class PlanCheck:
    """Standard deviations of derivatives promised by a plan, and of a model learned after its flight.

    Parameters
    ----------
    errors : DataFrame
        By derivative of the goal: ``before`` and ``promised``, of the plan; ``found``, of the
        model, at the trims of the plan.
    """

    name: ClassVar[str] = "plan"
    errors: pd.DataFrame

    @classmethod
    def from_file(
        cls,
        path: str | os.PathLike[str],
        model: Aerodynamics | BaseEstimator,
        aircraft: Aircraft,
        *,
        thrust: Any = "auto",
    ) -> PlanCheck:
        """Compare a model with the plan.json of ``skdgp plan``.

        Raises FileNotFoundError if there is no such file, ValueError if it is no plan, or the model
        has no standard deviations of a derivative of its goal.

        Parameters
        ----------
        path : path-like
        model, aircraft, thrust
            As for :func:`skdgp.dynamics.stability_derivatives`; the model has learned from the
            planned flight too.

        Returns
        -------
        PlanCheck
        """
        try:
            plan = json.loads(Path(path).read_text(encoding="utf-8"))
            columns = ["before", "promised"]
            rows = [[float(row[name]) for name in columns] for row in plan["errors"].values()]
            errors = pd.DataFrame(rows, index=list(plan["errors"]), columns=columns)
            std = std_at(model, aircraft, plan["trims"], thrust)
        except (KeyError, TypeError, AttributeError, UnicodeDecodeError, json.JSONDecodeError):
            raise ValueError(
                f"Got {path} as the plan, but expected the plan.json that skdgp plan "
                f"writes: copy it again, or plan again."
            ) from None
        if lacking := [name for name in errors.index if name not in std]:
            raise ValueError(
                f"Got a plan for {lacking}, but the model has no standard deviations of them: "
                f"judge a model with the regressors that the plan was made with."
            )
        return cls(errors.assign(found=std.reindex(errors.index)))

    @property
    def remaining(self) -> dict[str, float]:
        """Geometric mean of ``promised`` and ``found`` over ``before``."""
        ratios = self.errors[["promised", "found"]].div(self.errors["before"], axis=0)
        return {str(name): float(value) for name, value in np.exp(np.log(ratios).mean()).items()}

    def summary(self) -> list[str]:
        """Return promised and found values in one line."""
        ratios = ", ".join(f"{name} {value:.0%}" for name, value in self.remaining.items())
        return [f"standard deviations of the plan's goal, of those before it: {ratios}"]

    def section(self) -> str:
        """Return its section of the report, HTML."""
        rows = [
            [text(name), *(number(value, ".2g") for value in row)]
            for name, row in self.errors.iterrows()
        ]
        ratios = ", ".join(f"{k} {percent(v, '.0f')} %" for k, v in self.remaining.items())
        caption = (
            f"Standard deviations of derivatives at the trims of the plan: before its flight, "
            f"promised by the plan, and found in this model. Geometric mean, of those before: "
            f"{ratios}."
        )
        shown = table(["derivative", *self.errors], rows, caption=caption, classes="narrow")
        return f"<section><h2>The plan and this model</h2>{shown}</section>"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"remaining": self.remaining, "errors": self.errors.to_dict("index")}

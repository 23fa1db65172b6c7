"""Planned flights: their manoeuvres, what they will teach, what they risk, and the file that says so."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Array
from skdgp._excitation import UNLIMITED, Signal, Wavetrain
from skdgp._flight.channels import HAT
from skdgp.design._envelope import GROWTH, QUANTITIES, quantities
from skdgp.design._information import Information, errors_of
from skdgp.design._rehearsal import REACTION, RESPONSE, ROW_STEP
from skdgp.dynamics import Aircraft, Trim

# stored samples of the inputs in the shortest period: a flight beside them is late by a fortieth at
# most
SAMPLES = 20
GEOMETRY = ("wing_area", "span", "chord")


@dataclass(frozen=True, eq=False)
class Plan:
    """Flights that `plan` has chosen, and what they will teach; `write_flight_card` draws them.

    Parameters
    ----------
    trains : tuple of Wavetrain
        The inputs, a wavetrain for each trim that is flown.
    trims : tuple of Trim
        Where each wavetrain begins, and to which the aircraft is returned before each manoeuvre.
    goal : tuple of str
        Names of derivatives, such as ``Cm_q``, "function", "free-flight".
    before, after : Information
        About the derivatives, without and with the plan.
    manoeuvres : DataFrame
        In the order of flight: ``train`` (number of its wavetrain), ``airspeed`` [m/s] of its trim,
        ``start`` [s], ``name``, ``duration`` [s], ``pause`` [s] after it, ``scale`` (relative to
        the limits), ``risk`` (predicted probability of leaving the envelope; NaN without
        posterior), ``gain`` (by which part it reduces the errors of the goal, on geometric average)
        and ``gain_per_second`` (of the logarithm of these errors).
    flight : DataFrame
        Expected: the mean of the model, from its trim for each manoeuvre; ``flight`` numbers them.
        Of a model with a posterior also the band of 95 % of the aircraft drawn: ``alpha_low``,
        ``alpha_high`` and so on.
    parts : tuple of Information
        Of each manoeuvre, with ``curvature`` the mean over aircraft and entries that are drawn;
        ``after`` is ``before`` and their sum.
    limits : DataFrame
        ``low`` and ``high`` of what no manoeuvre may leave: see :meth:`Envelope.bounds`.
    aircraft : Aircraft
    at : dict of str to float
        Regressors about which derivatives are meant: the mean of all trims that were asked for.
    weights : dict of str to ndarray (P, 1 + d, 1 + d)
        Of covariances, for the goals "function" and "free-flight".
    merged : dict of str to float
        ``std_merged`` of derivatives at the trims (root mean square), of
        :func:`skdgp.dynamics.stability_derivatives`: what alpha_dot and beta_dot may hold of them.
        No flight lowers it without these regressors.
    gusts : tuple of float, optional
        Standard deviations [m/s] of the gusts u, v, w in which risks were predicted; None: in calm
        air.
    """

    trains: tuple[Wavetrain, ...]
    trims: tuple[Trim, ...]
    goal: tuple[str, ...]
    before: Information
    after: Information
    manoeuvres: pd.DataFrame
    flight: pd.DataFrame
    parts: tuple[Information, ...]
    limits: pd.DataFrame
    aircraft: Aircraft
    at: Mapping[str, float]
    weights: Mapping[str, Array] = field(default_factory=dict)
    merged: Mapping[str, float] = field(default_factory=dict)
    gusts: tuple[float, ...] | None = None
    response: ClassVar[float] = RESPONSE
    reaction: ClassVar[float] = REACTION
    """How long the flight after a manoeuvre tells of the aircraft, and how long nobody acts in it
    [s].
    """

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
    def errors(self) -> pd.DataFrame:
        """Standard errors of the goal ``before`` and ``after`` the flight; before is inf where nothing is known.

        They are without ``merged``. With it, ``std`` is the standard deviation before the flight
        that :func:`skdgp.dynamics.stability_derivatives` returns, whose ``std_unmerged`` is
        ``before``.
        """
        columns = {
            name: errors_of(getattr(self, name), self.weights) for name in ("before", "after")
        }
        found = pd.DataFrame({name: errors[list(self.goal)] for name, errors in columns.items()})
        if self.merged:
            found["std"] = np.hypot(
                found["before"], pd.Series(self.merged, dtype=float).reindex(found.index)
            )
        return found

    def inputs(self, k: int) -> dict[str, Signal]:
        """Return the inputs of a row of ``manoeuvres`` by axis."""
        row = self.manoeuvres.iloc[k]
        events = self.trains[int(row["train"])].events()
        return {axis: signal for axis, start, signal in events if np.isclose(start, row["start"])}

    def expected(self, rows: Sequence[int]) -> pd.DataFrame:
        """Return the ``low`` and ``high`` ends that some rows of ``manoeuvres`` are expected to reach."""
        flight = self.flight[self.flight["flight"].isin(list(rows))]
        low, high = (
            {name: flight.get(f"{name}_{end}", mean) for name, mean in quantities(flight).items()}
            for end in ("low", "high")
        )
        return pd.DataFrame({"low": pd.DataFrame(low).min(), "high": pd.DataFrame(high).max()})

    def to_dict(self) -> dict[str, Any]:
        """Return what a check after the flight needs, as plain values; inputs are what surfaces do, every ``step``."""
        names = ("airspeed", "altitude", "climb", "alpha", "beta", "phi", "theta", "controls")
        step = min(
            ROW_STEP,
            *(signal.period / SAMPLES for train in self.trains for _, _, signal in train.events()),
        )
        rows = []
        for k, row in enumerate(self.manoeuvres.to_dict("records")):
            limits = self.trains[int(row["train"])].limits
            lag = max((limit.lag for limit in limits.values()), default=0.0)
            time = np.arange(0.0, row["duration"] + 3 * lag + step, step)
            inputs = {
                axis: limits.get(axis, UNLIMITED).followed(signal(time), step).round(6).tolist()
                for axis, signal in self.inputs(k).items()
            }
            rows.append(row | {"inputs": inputs, "expected": self.expected([k]).to_dict("index")})
        return {
            "curvature": self.after.fisher.shape[1] > 1 + len(self.before.regressors),
            "aircraft": self.aircraft.to_dict(),
            "trims": [{name: getattr(one, name) for name in names} for one in self.trims],
            "at": dict(self.at), "step": step, "manoeuvres": rows, "risk": self.risk, "gusts": self.gusts,
            "limits": self.limits.to_dict("index"), "errors": self.errors.to_dict("index"),
            "confounded": self.confounded.to_dict("records"),
            "weights": {name: value.tolist() for name, value in self.weights.items()},
            "known": {name: np.asarray(value).tolist() for name, value in vars(self.before).items()},
        }  # fmt: skip

    @property
    def abort_limits(self) -> pd.DataFrame:
        """``low``, ``high`` and ``source`` of the quantities that have a limit, the narrower of asked and flown."""
        both = self.limits.groupby(lambda name: name.removeprefix(GROWTH)).agg(
            {"low": "max", "high": "min"}
        )
        found = both.loc[list(QUANTITIES)]
        found["low"] = found["low"].mask(
            (found.index == "airspeed") & (found["low"] == 0.0), -np.inf
        )
        finite, names = found.where(np.isfinite(found)), found.index
        sources = {"asked": "", "flown": GROWTH}
        same = {
            word: finite.eq(self.limits.reindex(start + names).set_axis(names))
            for word, start in sources.items()
        }
        found["source"] = [
            ", ".join(word for word, is_of in same.items() if is_of.loc[name].any())
            for name in names
        ]
        return found[found["source"] != ""]

    @property
    def confounded(self) -> pd.DataFrame:
        """Pairs with a derivative of the goal that are still not told apart: see :meth:`Information.confounded`."""
        pairs = self.after.confounded()
        names = pairs[["first", "second"]].apply(
            lambda one: pairs["coefficient"] + "_" + one.str.removesuffix(HAT)
        )
        return pairs[names.isin(self.goal).any(axis=1)].reset_index(drop=True)


class Record(NamedTuple):
    """What `Plan.to_dict` says of a plan, read again."""

    aircraft: Mapping[str, Any]
    before: Information
    at: list[float]  # regressors about which derivatives are meant, in the order of ``before``
    step: float  # of the inputs [s]
    curvature: bool
    weights: dict[str, Array]
    errors: pd.DataFrame
    limits: dict[str, tuple[float, float]]  # lowest and highest value; NaN: no limit
    manoeuvres: list[dict[str, Any]]


def read_plan(plan: Plan | str | os.PathLike[str]) -> Record:
    """Return the record of a plan, or of the plan.json of ``skdgp plan``; errors are as of `flown_plan`."""
    if isinstance(plan, Plan):
        return record_of(plan.to_dict())
    if not Path(plan).is_file():
        raise FileNotFoundError(f"Got {plan} as the plan, but there is no such file.")
    try:
        found = json.loads(Path(plan).read_text(encoding="utf-8"))
    except (ValueError, RecursionError):  # no JSON, too deep, or no text
        found = None
    return record_of(found, str(plan))


def record_of(plan: Any, source: str = "a dictionary") -> Record:
    """Return the record of what `Plan.to_dict` returns; raise ValueError if a part is missing or damaged."""
    part = "aircraft"
    try:
        aircraft = plan[part]
        _finite([aircraft[name] for name in GEOMETRY])
        part = "known"
        known = plan[part]
        before = Information(
            _finite(known["fisher"]), tuple(known["coefficients"]), tuple(known["regressors"])
        )
        errors_of(before)
        part = "at"
        at = _finite([plan[part][name] for name in before.regressors]).tolist()
        part = "step"
        if (step := float(_finite(plan[part]))) <= 0:
            raise ValueError
        part = "curvature"
        curvature = bool(plan[part])
        part = "weights"
        weights = {name: np.asarray(value, dtype=float) for name, value in plan[part].items()}
        told = errors_of(before, weights)
        part = "errors"
        errors = (
            pd.DataFrame.from_dict(plan[part], orient="index")[["before", "after"]]
            .astype(float)
            .fillna(np.inf)
        )
        told[[*errors.index]]
        part = "limits"
        pairs = {
            name: np.array([limit["low"], limit["high"]], dtype=float)
            for name, limit in plan[part].items()
        }
        limits = {name: (float(low), float(high)) for name, (low, high) in pairs.items()}
        part = "manoeuvres"
        for one in plan[part]:
            expected = [
                one["expected"][name][end] for name in QUANTITIES for end in ("low", "high")
            ]
            _finite([len(one["name"]), one["duration"], one["pause"], len(expected)])
            for values in one["inputs"].values():
                _finite(values)
        if not (plan[part] and all(one["inputs"] for one in plan[part])):
            raise ValueError
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):
        what = (
            f"whose {part!r} is missing or damaged"
            if isinstance(plan, dict) and plan
            else "which is none"
        )
        raise ValueError(
            f"Got {source} as the plan, {what}, but expected the plan.json that skdgp "
            f"plan writes: copy it "
            "again, or plan again."
        ) from None
    return Record(
        aircraft, before, at, step, curvature, weights, errors, limits, plan["manoeuvres"]
    )


def _finite(values: Any) -> Array:
    """Return numbers; raise ValueError if there is none, or one that is not finite."""
    found = np.asarray(values, dtype=float)
    if not (found.size and np.isfinite(found).all()):
        raise ValueError
    return found

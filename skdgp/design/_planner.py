"""The next flight: manoeuvres that teach most about a goal inside an envelope, their promises and risks, their file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator
from sklearn.utils import check_random_state

from skdgp._compute.files import plain
from skdgp._compute.messages import notify, warn, without_warnings
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Matrix, Seed
from skdgp._display.page import number, percent, table, text
from skdgp._excitation import Signal, Wavetrain, wavetrain
from skdgp._flight.channels import COEFFICIENTS, HAT
from skdgp._flight.checks import check_names, check_number
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp.design._manoeuvres import (
    GROWTH,
    LEAST,
    OPTIONS,
    QUANTITIES,
    RESPONSE,
    ROW_STEP,
    WHOLE_RANGE,
    Checked,
    Envelope,
    Inputs,
    Rehearsal,
    duration_of,
    input_bands,
    library,
    quantities,
    regressors_of,
    scaled,
    with_band,
)
from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    SimulationWarning,
    Trim,
    as_aerodynamics,
    linearize,
    stability_derivatives,
)

TRIM = ("airspeed", "altitude", "climb", "alpha", "beta", "phi", "theta", "state", "controls")


@dataclass(frozen=True, eq=False)
class Plan:
    """Flight that `plan` has chosen, with promised standard deviations; `write_flight_card` draws it.

    Parameters
    ----------
    train : Wavetrain
        The inputs.
    trim : Trim
        Where the flight begins, and to which the aircraft is returned before each manoeuvre.
    manoeuvres : DataFrame
        In the order of flight: ``start`` [s], ``name``, ``duration`` [s], ``pause`` [s] after it,
        ``scale`` (relative to the limits), ``risk`` (predicted probability of leaving the envelope;
        NaN without posterior).
    flight : DataFrame
        Expected: the mean of the model, from its trim for each manoeuvre; ``flight`` numbers them.
        Of a model with a posterior also the band of 95 % of the aircraft drawn: ``alpha_low``,
        ``alpha_high`` and so on.
    errors : DataFrame
        Standard deviations of the derivatives of the goal at the trim, as of
        :func:`skdgp.dynamics.stability_derivatives`: ``before`` the flight, and ``promised`` of a
        model learned from this flight too. NaN where the model has no posterior, or does not hold
        its rows.
    limits : DataFrame
        ``low`` and ``high`` limits of all manoeuvres: see :meth:`Envelope.bounds`.
    aircraft : Aircraft
    gusts : tuple of float, optional
        Standard deviations [m/s] of the gusts u, v, w of the predicted risks; None: in calm
        air.
    servo_lag : float, default=0.0
        Of the surfaces behind the inputs, which are commands [s].
    """

    train: Wavetrain
    trim: Trim
    manoeuvres: pd.DataFrame
    flight: pd.DataFrame
    errors: pd.DataFrame
    limits: pd.DataFrame
    aircraft: Aircraft
    gusts: tuple[float, ...] | None = None
    servo_lag: float = 0.0

    @property
    def risk(self) -> float:
        """Predicted probability that any manoeuvre leaves the envelope, if they are independent."""
        return float(1.0 - np.prod(1.0 - self.manoeuvres["risk"]))

    @property
    def seconds(self) -> float:
        """Of the flight, pauses included [s]."""
        first = self.manoeuvres["start"].iloc[0]
        return float(first + self.manoeuvres[["duration", "pause"]].to_numpy().sum())

    @property
    def remaining(self) -> float:
        """Promised standard deviations over those before, their geometric mean."""
        return float(np.exp(np.log(self.errors["promised"] / self.errors["before"]).mean()))

    def inputs(self, k: int) -> dict[str, Signal]:
        """Return the inputs of a row of ``manoeuvres`` by axis."""
        begin = self.manoeuvres["start"].iloc[k]
        events = self.train.events()
        return {axis: signal for axis, start, signal in events if np.isclose(start, begin)}

    @property
    def expected(self) -> pd.DataFrame:
        """The ``low`` and ``high`` ends that the quantities are expected to reach."""
        means = quantities(self.flight)
        ends = {
            end: pd.DataFrame(
                {name: self.flight.get(f"{name}_{end}", means[name]) for name in means}
            )
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
            "trim": {name: plain(getattr(self.trim, name)) for name in TRIM},
            "manoeuvres": self.manoeuvres.to_dict("records"),
            "risk": self.risk,
            "gusts": self.gusts,
            "limits": self.limits.to_dict("index"),
            "errors": self.errors.to_dict("index"),
        }


def std_at(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    trim: Mapping[str, Any],
    thrust: Any,
    added: Matrix | None = None,
) -> pd.Series:
    """Return the standard deviations of `stability_derivatives` by name, empty for a model without a posterior.

    The trim has "state" and "controls".
    """
    state = np.array(trim["state"], dtype=float)
    derivatives = stability_derivatives(
        model, aircraft, state, trim["controls"], thrust=thrust, added=added
    )
    return derivatives.get("std", pd.Series(dtype=float))


@dataclass(frozen=True, eq=False)
class PlanCheck:
    """Standard deviations of derivatives promised by a plan, and of a model learned after its flight.

    Parameters
    ----------
    errors : DataFrame
        By derivative of the goal: ``before`` and ``promised``, of the plan; ``found``, of the
        model, at the trim of the plan.
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
            std = std_at(model, aircraft, plan["trim"], thrust)
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
            f"Standard deviations of derivatives at the trim of the plan: before its flight, "
            f"promised by the plan, and found in this model. Geometric mean, of those before: "
            f"{ratios}."
        )
        shown = table(["derivative", *self.errors], rows, caption=caption, classes="narrow")
        return f"<section><h2>The plan and this model</h2>{shown}</section>"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"remaining": self.remaining, "errors": self.errors.to_dict("index")}


def information(X: Matrix) -> Matrix:
    """Return the Fisher information (1 + d, 1 + d) of rows X (n, d) for noise of unit variance.

    It concerns a constant and the slopes of a coefficient that is linear in the regressors. The
    noise of a coefficient is a factor of all its variances, so the information serves all six.
    """
    rows = np.column_stack([np.ones(len(X)), X])
    return rows.T @ rows


def derivative_names(model: Aerodynamics) -> dict[str, int]:
    """Return the number of the regressor of each derivative of the model, such as ``Cm_q``."""
    short = [name.removesuffix(HAT) for name in model.regressors]
    return {
        f"{coefficient}_{name}": k for coefficient in COEFFICIENTS for k, name in enumerate(short)
    }


def check_goal(goal: Sequence[str] | None, model: Aerodynamics) -> tuple[str, ...]:
    """Return the names of a goal, by default all derivatives; raise ValueError if the model cannot tell of one."""
    derivatives = derivative_names(model)
    names = (goal,) if isinstance(goal, str) else tuple(derivatives if goal is None else goal)
    lacking = [name for name in names if name not in derivatives]
    if lacking or not names or isinstance(goal, str):
        raise ValueError(
            f"Got the goal {lacking or goal!r}, but the model has the regressors "
            f"{list(model.regressors)}: give a list of derivatives such as {next(iter(derivatives))!r}, "
            f"or learn a model with that regressor."
        )
    if model.limits is not None:
        still = np.ptp(model.limits, axis=0) == 0
        if unmoved := [name for name in goal or () if still[derivatives[name]]]:
            raise ValueError(
                f"Got the goal {unmoved}, but {model.regressors[derivatives[unmoved[0]]]} did not move "
                f"in the flights that the model was learned from: learn from a flight in which it "
                f"moves, or ask for another goal."
            )
    return names


SHRINK = 0.7  # least factor by which a check makes a manoeuvre smaller: responses are not linear
TRIES = 6  # largest number of checks of a manoeuvre
NEAR = 0.03  # relative tolerance of the largest safe size
MOST = np.pi / 2  # deflection that no surface has [rad]
UNBOUNDED = ("thrust", "propeller_speed")  # axes that are no deflections
MOST_SECONDS = 1800.0  # duration of a plan
WORTH = 0.002  # least relative reduction of the errors of the goal
UNMOVED = 1e-6  # information of a manoeuvre below which motion is rounding
VAGUE = 1e-8  # information assumed of everything, relative to the largest of a manoeuvre


def plan(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    trim: Trim,
    *,
    seconds: float,
    axes: Sequence[str],
    goal: Sequence[str] | None = None,
    limits: Mapping[str, float] | None = None,
    envelope: Envelope | None = None,
    thrust: Any = "auto",
    random_state: Seed = 0,
) -> Plan:
    r"""Return the flight that teaches most about derivatives in a given time, inside an envelope.

    The library holds doublets, 3-2-1-1s and multisines, with times and bands from the modes. Each
    is simulated from a trim with the mean of the model. With the rows X of the training
    flights and of manoeuvres, :math:`[(X^T X)^{-1}]_{kk}` is the variance of a slope by linear
    least squares in units of the noise. Manoeuvres are chosen one by one for the largest reduction
    per second of its mean logarithm over the goal; then each is exchanged while that helps.

    The flight promises the standard deviation that
    :func:`skdgp.dynamics.stability_derivatives` states for the rows of both flights. The targets of
    the planned rows are the model's means and the residuals of its training rows, so the promise
    holds what more rows do not lower: noise of the regressors, and what alpha_dot and beta_dot may
    hold.

    Each chosen manoeuvre is flown by aircraft drawn from the posterior, each in gusts of its own,
    from an entry beside the trim (standard deviations: bank and pitch 2 degrees, airspeed 2 %, held
    controls 2 % of their limits). If K of N leave the envelope, the predicted risk is (K + 1) / (N
    + 2) (Laplace's rule of succession). A manoeuvre is as large as limits and allowed risk let it
    be, or left out, and the choice is made again. Controls are open loop during a manoeuvre and a
    second after it, the time of the predicted risk. Before and after it is a pause at the trim, a
    quarter of the phugoid's period (Lanchester's, :math:`\sqrt{2} \pi V / g`), at least 3 s.

    Ctrl-C ends the search with the best checked manoeuvres. :func:`skdgp.listening` shows the
    progress.

    Raises ValueError if the trim has not an axis, the model has not a regressor of the goal or did
    not see it move, no manoeuvre fits into the time, or no manoeuvre stays in the envelope. Warns
    if the model does not know the turbulence of its flights, or the range of a quantity, and
    neither is given.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        As for :func:`skdgp.dynamics.as_aerodynamics`. Without a posterior only its mean is checked,
        and nothing is promised.
    aircraft : Aircraft
    trim : Trim
        Where manoeuvres begin, of :func:`skdgp.dynamics.trim`.
    seconds : float
        Of the flight, pauses included; it ends 3 s after its last manoeuvre.
    axes : sequence of str
        Controls to move, such as ``["elevator", "aileron", "rudder"]``.
    goal : sequence of str, optional
        Derivatives such as ``Cm_q`` or ``Cn_rudder``, of body-axis coefficients, rates
        non-dimensional. By default all of the model.
    limits : mapping of str to float, optional
        Largest deviations of the axes from trim [rad, or 1 of the throttle]; by default the
        deviations that the model was learned from.
    envelope : Envelope, optional
        By default that which was flown, and a fifth more; no lower than was flown.
    thrust
        As for :func:`skdgp.dynamics.simulate`.
    random_state : int, RandomState instance or None, default=0
        Of the draws.

    Returns
    -------
    Plan

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.design import plan
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, trim
    >>> def linear(X):
    ...     alpha, q, elevator = X.T
    ...     none, lift = 0 * alpha, 0.3 + 4.5 * alpha
    ...     return np.stack([-0.02 * lift, none, -lift, none, 0.02 - 0.6 * alpha - 9 * q - elevator, none], axis=-1)
    >>> model = Aerodynamics(linear, ["alpha", "q_hat", "elevator"])
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> found = plan(model, aircraft, trim(model, aircraft, 20.0), seconds=16.0, axes=["elevator"],
    ...              goal=["Cm_alpha", "Cm_q"], limits={"elevator": 0.04})
    >>> found.manoeuvres["name"].tolist()
    ['elevator doublet 0.23 s', 'elevator 3-2-1-1 0.39 s', 'elevator doublet 0.23 s']
    """
    with one_blas_thread(), without_warnings(SimulationWarning):  # leaving the envelope is a risk
        envelope = envelope or Envelope()
        _check_options(seconds, axes, limits or {}, envelope)
        aerodynamics = as_aerodynamics(model)
        if aerodynamics.is_uncertain:
            _check_uncertain(envelope, aerodynamics)
        names = check_goal(goal, aerodynamics)
        check_names(axes, trim.controls, "controls of the trim")
        seed = int(check_random_state(random_state).randint(2**31 - 1))
        pause = max(RESPONSE, np.pi * trim.airspeed / (2.0 * np.sqrt(2.0) * STANDARD_GRAVITY))
        checked = _checked_limits(trim, aerodynamics, axes, limits or {})
        rehearsal = Rehearsal(model, aircraft, trim, checked, envelope, pause, thrust, seed)
        planner = _Planner(rehearsal, float(seconds), names)
        return planner.plan_of(planner.searched())


def _check_options(seconds: Any, axes: Any, limits: Any, envelope: Envelope) -> None:
    """Raise ValueError where an option of `plan` is none."""
    if isinstance(axes, str) or not len(axes) or len({*axes}) < len(axes):
        raise ValueError(
            f"Got axes={axes!r}, but expected different controls in a list, such as ['elevator', "
            f"'rudder']."
        )
    if not (np.ndim(seconds) == 0 and 0 < seconds <= MOST_SECONDS):
        raise ValueError(
            f"Got seconds={seconds!r}, but expected a number > 0 and at most {MOST_SECONDS:g}: "
            f"plan a shorter flight, and fly it again."
        )
    check_number("n_paths", envelope.n_paths, is_open=False)
    check_names(limits, axes, "axes to move")
    for axis, limit in limits.items():
        most = np.inf if axis in UNBOUNDED else MOST
        if not check_number(f"limit of the {axis}", limit) < most:
            raise ValueError(
                f"Got a limit of {limit:g} for the {axis}, but expected less than {most:.3g}: "
                f"rad, not degrees, or 0 to 1 of the throttle."
            )


def _check_uncertain(envelope: Envelope, model: Aerodynamics) -> None:
    """Warn of gusts and ranges that a model with a posterior does not know; raise ValueError at too few paths."""
    if envelope.gusts == "auto" and model.turbulence is None:
        warn(
            "The model does not know the turbulence of its flights, so risks are those "
            "without gusts. Give Envelope(gusts=Turbulence.low_altitude(height, wind_at_6m)).",
            stacklevel=3,
        )
    if free := envelope.unlimited(model):
        options = ", ".join(OPTIONS[name] for name in free)
        warn(
            f"The model does not know the flown range of {', '.join(free)}, so nothing limits "
            f"them: a manoeuvre may turn the aircraft over or dive. Limit them by the "
            f"envelope ({options}), or fit the model again.",
            UserWarning,
            stacklevel=3,
        )
    n_paths = envelope.n_paths
    if 1 / (n_paths + 2) > envelope.risk:
        raise ValueError(
            f"Got n_paths={n_paths}, too few to show a risk of {envelope.risk:g}, but "
            f"expected at least {int(np.ceil(1 / envelope.risk)) - 2}, better three times "
            f"as many."
        )


def _checked_limits(
    trim: Trim, model: Aerodynamics, axes: Sequence[str], limits: Mapping
) -> dict[str, float]:
    """Return the limits of the axes, by default the training ranges; the throttle ends at 0 and 1."""
    ranges = np.empty((2, 0)) if model.limits is None else model.limits
    flown = dict(zip(model.regressors, ranges.T.tolist(), strict=False))
    checked = {}
    for axis in axes:
        if axis not in limits and axis not in flown:
            raise ValueError(
                f"Got no limit of the {axis}, and the model does not say what was flown: give "
                f"limits={{{axis!r}: ...}} (--limits)."
            )
        low, high = (-np.inf, np.inf) if axis in limits else flown[axis]
        least, most = WHOLE_RANGE.get(axis, (-np.inf, np.inf))
        value = trim.controls[axis]
        room = min(value - max(low, least), min(high, most) - value)
        if not room > 0:
            raise ValueError(
                f"Got a trim with the {axis} at {value:.3g}, but a range of {max(low, least):.3g} "
                f"to {min(high, most):.3g}, which leaves it no room: give limits={{{axis!r}: ...}} "
                f"(--limits), leave it out of the axes, or choose another trim."
            )
        checked[axis] = float(min(limits.get(axis, np.inf), room))
    return checked


@dataclass(frozen=True, eq=False)
class _Manoeuvre:
    """A manoeuvre of the library."""

    name: str
    full: Inputs  # as large as the limits allow
    seconds: float  # of the manoeuvre and a pause beside it
    information: Matrix
    flight: pd.DataFrame
    scale: float = 1.0
    risk: float | None = None  # None: not checked


class _Planner:
    """Manoeuvres and risks of the flights that may be planned."""

    def __init__(self, rehearsal: Rehearsal, seconds: float, goal: Sequence[str]) -> None:
        self.rehearsal = rehearsal
        self.seconds = seconds
        self.goal = goal
        self.aerodynamics = rehearsal.aerodynamics
        numbers = derivative_names(self.aerodynamics)
        self.slopes = [numbers[name] for name in goal]
        of_model = self.aerodynamics.training_rows
        self.learned = None if of_model is None else of_model()  # regressors (n, d) learned from
        self.interval = ROW_STEP  # between rows of a log [s]
        if self.learned is not None and self.aerodynamics.training_seconds is not None:
            self.interval = self.aerodynamics.training_seconds / len(self.learned)
        self.library = {item.name: item for item in self._library()}
        if not self.library:
            raise ValueError(
                f"Got {seconds:g} s, but no manoeuvre with pauses of "
                f"{rehearsal.pause:.3g} s is that short and can be flown: give more seconds "
                f"or smaller limits."
            )
        peak = np.max([np.diag(item.information) for item in self.library.values()], axis=0)
        self.known = VAGUE * np.diag(np.maximum(peak, UNMOVED))
        if self.learned is not None:
            self.known += information(self.learned)

    def _rows(self, flight: pd.DataFrame) -> Matrix:
        """Return the regressors (n, d) of a simulated flight at the rate of the model's own rows."""
        X = regressors_of(flight, self.rehearsal.aircraft, self.aerodynamics.regressors)
        time = flight["time"].to_numpy(float)
        times = np.arange(time[0], time[-1] + 0.5 * self.interval, self.interval)
        return np.column_stack([np.interp(times, time, column) for column in X.T])

    def _library(self) -> list[_Manoeuvre]:
        """Return manoeuvres that fit into the time, as large as the envelope seems to allow the mean."""
        rehearsal = self.rehearsal
        notify("planning: library", 0, 0.0)
        of_aircraft = rehearsal.model, rehearsal.aircraft, rehearsal.point
        modes = linearize(*of_aircraft, thrust=rehearsal.thrust).modes()
        most = self.seconds - rehearsal.pause - rehearsal.response
        named = {
            name: item
            for name, item in library(input_bands(modes, rehearsal.limits), rehearsal.limits)
            if duration_of(item) <= most
        }
        scales: dict[str, float] = {}
        for factor in (1.0, 0.5, LEAST):
            remaining = {n: scaled(item, factor) for n, item in named.items() if n not in scales}
            scales |= {
                name: float(np.clip(factor * rehearsal.room(flight), LEAST, 1.0))
                for name, flight in self._flights(remaining).items()
            }
        inputs = {name: scaled(named[name], scale) for name, scale in scales.items()}
        return [
            _Manoeuvre(
                name=name, full=named[name], seconds=duration_of(named[name]) + rehearsal.pause,
                information=information(self._rows(item)), flight=item, scale=scales[name],
            )
            for name, item in self._flights(inputs).items()
        ]  # fmt: skip

    def _flights(self, named: Mapping[str, Inputs]) -> dict[str, pd.DataFrame]:
        """Return the flights of manoeuvres that the mean completes."""
        flights = self.rehearsal.flown([*named.values()]) if named else []
        pairs = zip(named, flights, strict=True)
        return {name: flight for name, flight in pairs if (flight["ended"] == "").all()}

    def _gain(self, chosen: Sequence[_Manoeuvre]) -> float:
        """Return the mean of minus the logarithm of the errors of the goal."""
        fisher = sum((manoeuvre.information for manoeuvre in chosen), self.known)
        scale = np.sqrt(np.diag(fisher))
        variances = np.diag(np.linalg.inv(fisher / np.outer(scale, scale))) / scale**2
        return float(-0.5 * np.mean(np.log(variances[1:][self.slopes])))

    def _fits(self, chosen: Sequence[_Manoeuvre]) -> bool:
        seconds = sum(manoeuvre.seconds for manoeuvre in chosen) + self.rehearsal.response
        return seconds <= self.seconds + 1e-9

    def _filled(self, chosen: list, library: Sequence[_Manoeuvre]) -> list[_Manoeuvre]:
        """Return manoeuvres, and more with the largest gain per second until the time is used."""
        while options := [manoeuvre for manoeuvre in library if self._fits([*chosen, manoeuvre])]:
            now = self._gain(chosen)
            gains = [
                (self._gain([*chosen, manoeuvre]) - now) / manoeuvre.seconds
                for manoeuvre in options
            ]
            chosen = [*chosen, options[int(np.argmax(gains))]]
        return chosen

    def _sequence(self, library: Sequence[_Manoeuvre]) -> list[_Manoeuvre]:
        """Return the best sequence that is found: greedy, or one repeated, with exchanges while they help."""
        starts = [
            self._filled([], library),
            *(self._filled([], [manoeuvre]) for manoeuvre in library),
        ]
        best = self._filled(max(starts, key=self._gain), library)
        while True:
            swaps = [
                [*best[:k], manoeuvre, *best[k + 1 :]]
                for k, old in enumerate(best)
                for manoeuvre in library
                if manoeuvre is not old
            ]
            swaps = [sequence for sequence in swaps if self._fits(sequence)]
            better = self._filled(max(swaps, key=self._gain), library) if swaps else best
            if self._gain(better) <= self._gain(best) + 1e-6:
                return best
            best = better

    def searched(self) -> list[_Manoeuvre]:
        """Return the chosen manoeuvres, all safe."""
        library = self.library
        causes = ""
        try:
            while chosen := self._sequence([*library.values()]):
                gain = self._gain(chosen) - self._gain([])
                if gain < WORTH:
                    raise ValueError(
                        f"Got the goal {list(self.goal)}, but {self.seconds:g} s of manoeuvres of "
                        f"{list(self.rehearsal.limits)} within their limits lower its errors by "
                        f"{gain:.2%}: move other axes, raise their limits, or ask for another goal."
                    )
                n_checked = sum(manoeuvre.risk is not None for manoeuvre in library.values())
                notify(f"planning: {len(chosen)} manoeuvres, {n_checked} kinds checked", 0, 0.0)
                unchecked = next(
                    (manoeuvre for manoeuvre in chosen if manoeuvre.risk is None), None
                )
                if unchecked is None:
                    break
                safe, causes = self._safe(unchecked)
                del library[unchecked.name]
                if safe is not None:
                    library[safe.name] = safe
        except KeyboardInterrupt:
            chosen = self._sequence(
                [manoeuvre for manoeuvre in library.values() if manoeuvre.risk is not None]
            )
            if not chosen:
                raise
        if not chosen:
            raise ValueError(
                f"Got an envelope that every manoeuvre leaves in more than "
                f"{self.rehearsal.envelope.risk:.0%} of cases, even at {LEAST:.0%} of the limits; the "
                f"last one by {causes}: widen this limit, allow more risk, plan for weaker gusts, or "
                f"fly another airspeed or altitude."
            )
        return chosen

    def _safe(self, manoeuvre: _Manoeuvre) -> tuple[_Manoeuvre | None, str]:
        """Return a manoeuvre as large as is safe, or None and the limits that it leaves."""
        scale = manoeuvre.scale
        safe = 0.0
        unsafe = np.inf
        causes = ""
        best: Checked | None = None
        for _ in range(TRIES):  # until the largest safe size is known to a few parts in a hundred
            checked = self.rehearsal.checked(scaled(manoeuvre.full, scale))
            if checked.risk <= self.rehearsal.envelope.risk:
                safe = scale
                best = checked
            else:
                unsafe = scale
                causes = checked.causes
            most = np.sqrt(safe * unsafe) if best and np.isfinite(unsafe) else (1 - NEAR) * unsafe
            scale = min(1.0, scale * max(checked.factor, SHRINK), most)
            if best is None and unsafe > (1 + NEAR) * LEAST:
                scale = max(scale, LEAST)
            if scale < max((1 + NEAR) * safe, LEAST):
                break
        if best is None:
            return None, causes
        flight = best.flight
        risk = np.nan
        if self.aerodynamics.is_uncertain:
            flight = with_band(flight, best.paths)
            risk = best.risk
        taught = information(self._rows(flight))
        return replace(manoeuvre, information=taught, flight=flight, scale=safe, risk=risk), causes

    def plan_of(self, chosen: list[_Manoeuvre]) -> Plan:
        """Return the plan of manoeuvres."""
        rehearsal = self.rehearsal
        pause = rehearsal.pause
        inputs = [scaled(item.full, item.scale) for item in chosen]
        train = wavetrain(inputs, pause=pause, limits=rehearsal.limits)
        seconds = [item.seconds for item in chosen]
        manoeuvres = pd.DataFrame({
            "start": pause + np.cumsum([0.0, *seconds[:-1]]),
            "name": [item.name for item in chosen],
            "duration": [duration_of(item.full) for item in chosen],
            "pause": [*[pause] * (len(chosen) - 1), rehearsal.response],
            "scale": [item.scale for item in chosen],
            "risk": [item.risk for item in chosen],
        })  # fmt: skip
        flight = [manoeuvre.flight.assign(flight=k) for k, manoeuvre in enumerate(chosen)]
        gusts: Any = rehearsal.envelope.gusts
        if gusts == "auto":
            gusts = self.aerodynamics.turbulence
        is_still = gusts is None or not self.aerodynamics.is_uncertain
        return Plan(
            train=train,
            trim=rehearsal.point,
            manoeuvres=manoeuvres,
            flight=pd.concat(flight, ignore_index=True),
            errors=self._errors(chosen),
            limits=pd.DataFrame(rehearsal.envelope.bounds(self.aerodynamics), ["low", "high"]).T,
            aircraft=rehearsal.aircraft,
            gusts=None if is_still else tuple(map(float, gusts.intensity)),
            servo_lag=self.aerodynamics.servo_lag,
        )

    def _errors(self, chosen: Sequence[_Manoeuvre]) -> pd.DataFrame:
        """Return standard deviations of the goal before the flight, and promised after it."""
        notify("planning: promise", 0, 0.0)
        rehearsal = self.rehearsal
        of_aircraft = rehearsal.model, rehearsal.aircraft, vars(rehearsal.point), rehearsal.thrust
        before = std_at(*of_aircraft)
        promised = pd.Series(dtype=float)
        if self.learned is not None and len(before):
            added = np.concatenate([self._rows(item.flight) for item in chosen])
            promised = std_at(*of_aircraft, added)
        errors = pd.DataFrame({"before": before, "promised": promised}, dtype=float)
        return errors.reindex(list(self.goal))

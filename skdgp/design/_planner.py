"""The next flight: manoeuvres that teach most about a goal inside an envelope, and their promises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.files import plain
from skdgp._compute.messages import notify, warn, without_warnings
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Matrix, Vector
from skdgp._excitation import Signal, Steps, Wavetrain, wavetrain
from skdgp._flight.channels import COEFFICIENTS, HAT
from skdgp._flight.checks import check_names, check_number
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp.design._check import std_at
from skdgp.design._choice import Choice, information
from skdgp.design._envelope import (
    GROWTH,
    OPTIONS,
    QUANTITIES,
    UNLIMITED,
    WHOLE_RANGE,
    Envelope,
    option_of,
    quantities,
    regressors_of,
)
from skdgp.design._library import (
    SETTINGS,
    Inputs,
    PlanSettings,
    duration_of,
    input_bands,
    library,
    scaled,
)
from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    SimulationWarning,
    Trim,
    as_aerodynamics,
    linearize,
    simulate,
)

# Deflection that no surface has [rad]
MOST_DEFLECTION = np.pi / 2
# Axes that are no deflections
UNBOUNDED = ("thrust", "propeller_speed")
# Duration of a plan [s]
MOST_SECONDS = 1800.0
# Facts of the trim in plan.json
TRIM = ("airspeed", "altitude", "climb", "alpha", "beta", "phi", "theta", "state", "controls")
# Information of a manoeuvre below which motion is rounding
UNMOVED = 1e-6
ROUNDING = 1e-6


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
        ``scale`` (relative to the limits).
    flight : DataFrame
        Expected: the mean of the model in calm air, from its trim for each manoeuvre; ``flight``
        numbers them.
    errors : DataFrame
        Standard deviations of the derivatives of the goal at the trim, as of
        :func:`skdgp.dynamics.stability_derivatives`: ``before`` the flight, and ``promised`` of a
        model learned from this flight too. NaN where the model has no posterior, or does not hold
        its rows.
    limits : DataFrame
        ``low`` and ``high`` limits of all manoeuvres: see :meth:`Envelope.bounds`.
    aircraft : Aircraft
    margin : float
        Of the responses to the limits: see `Envelope`.
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
    margin: float
    servo_lag: float = 0.0

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
        values = quantities(self.flight)
        return pd.DataFrame({"low": values.min(), "high": values.max()})

    @property
    def abort_limits(self) -> pd.DataFrame:
        """The ``low`` and ``high`` ends of the quantities, the narrower of asked and flown."""
        requested = self.limits.reindex(QUANTITIES)
        flown = self.limits.reindex([GROWTH + name for name in QUANTITIES]).set_axis(QUANTITIES)
        low = np.fmax(requested["low"], flown["low"])
        high = np.fmin(requested["high"], flown["high"])
        low["airspeed"] = low["airspeed"] if low["airspeed"] > 0 else -np.inf
        return pd.DataFrame({"low": low, "high": high})

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain values, SI units and radians."""
        point = vars(self.trim)
        trim = {name: plain(point[name]) for name in TRIM}
        return {
            "aircraft": self.aircraft.name,
            "trim": trim,
            "manoeuvres": self.manoeuvres.to_dict("records"),
            "margin": self.margin,
            "limits": self.limits.to_dict("index"),
            "errors": self.errors.to_dict("index"),
        }


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
    settings: PlanSettings = SETTINGS,
) -> Plan:
    r"""Return the flight that teaches most about derivatives in a given time, inside an envelope.

    The library holds doublets, 3-2-1-1s and multisines, with times and bands from the modes. Each
    is simulated from a trim with the mean of the model in calm air. It is as large as the limits
    of the axes and the envelope with its margin let it be, or left out. Controls are open loop
    during a manoeuvre and a second after it. Before and after it is a pause at the trim, a
    quarter of the phugoid's period (Lanchester's, :math:`\sqrt{2} \pi V / g`), at least 3 s.

    With the rows X of the training flights and of manoeuvres, :math:`[(X^T X)^{-1}]_{kk}` is the
    variance of a slope by linear least squares in units of the noise. Manoeuvres are chosen one by
    one for the largest reduction per second of its mean logarithm over the goal; then each is
    exchanged while that helps.

    The flight promises the standard deviation that
    :func:`skdgp.dynamics.stability_derivatives` states for the rows of both flights. The targets of
    the planned rows are the model's means and the residuals of its training rows, so the promise
    holds what more rows do not lower: noise of the regressors, and what alpha_dot and beta_dot may
    hold.

    :func:`skdgp.listening` shows the progress.

    Raises ValueError if the trim has not an axis or is outside the envelope, the model has not a
    regressor of the goal or did not see it move, no manoeuvre fits into the time, or no manoeuvre
    stays in the envelope. Warns if the model does not know the range of a quantity, and the
    envelope does not limit it.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        As for :func:`skdgp.dynamics.as_aerodynamics`. Without a posterior nothing is promised.
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
    settings : PlanSettings
        Numbers of the search.

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
    with one_blas_thread(), without_warnings(SimulationWarning):
        envelope = envelope or Envelope()
        aerodynamics = as_aerodynamics(model)
        _check_options(seconds, axes, limits or {})
        _warn_unlimited(envelope, aerodynamics)
        names = _check_goal(goal, aerodynamics)
        check_names(axes, trim.controls, "controls of the trim")
        amplitudes = _amplitudes(trim, aerodynamics, axes, limits or {})
        planner = _Planner(
            model, aircraft, trim, amplitudes, envelope, thrust, names, float(seconds), settings
        )
        return planner.plan()


def _check_options(seconds: Any, axes: Any, limits: Mapping[str, float]) -> None:
    """Raise ValueError where an option of `plan` is none."""
    if isinstance(axes, str) or not len(axes) or len({*axes}) < len(axes):
        raise ValueError(
            f"Got axes={axes!r}, but expected different controls in a list, such as ['elevator', 'rudder']."
        )
    if not (np.ndim(seconds) == 0 and 0 < seconds <= MOST_SECONDS):
        raise ValueError(
            f"Got seconds={seconds!r}, but expected a number > 0 and at most {MOST_SECONDS:g}: "
            f"plan a shorter flight, and fly it again."
        )
    check_names(limits, axes, "axes to move")
    for axis, limit in limits.items():
        most = np.inf if axis in UNBOUNDED else MOST_DEFLECTION
        if not check_number(f"limit of the {axis}", limit) < most:
            raise ValueError(
                f"Got a limit of {limit:g} for the {axis}, but expected less than {most:.3g}: "
                f"rad, not degrees, or 0 to 1 of the throttle."
            )


def _warn_unlimited(envelope: Envelope, model: Aerodynamics) -> None:
    """Warn of quantities with neither a limit nor a known range."""
    if not model.is_uncertain:
        return
    if free := envelope.unlimited(model):
        options = ", ".join(OPTIONS[name] for name in free)
        warn(
            f"The model does not know the flown range of {', '.join(free)}, so nothing limits "
            f"them: a manoeuvre may turn the aircraft over or dive. Limit them by the "
            f"envelope ({options}), or fit the model again.",
            UserWarning,
            stacklevel=3,
        )


def _derivative_places(model: Aerodynamics) -> dict[str, int]:
    """Return the place of the regressor of each derivative of the model, such as ``Cm_q``."""
    places = {}
    for coefficient in COEFFICIENTS:
        for k, name in enumerate(model.regressors):
            places[f"{coefficient}_{name.removesuffix(HAT)}"] = k
    return places


def _check_goal(goal: Sequence[str] | None, model: Aerodynamics) -> list[str]:
    """Return the names of a goal, by default all derivatives; raise ValueError if the model cannot tell of one."""
    places = _derivative_places(model)
    names = list(places) if goal is None else list(goal)
    lacking = [name for name in names if name not in places]
    if lacking or not names or isinstance(goal, str):
        shown = goal if isinstance(goal, str) or not names else lacking
        raise ValueError(
            f"Got the goal {shown!r}, but the model has the regressors {list(model.regressors)}: "
            f"give a list of derivatives such as {next(iter(places))!r}, or learn a model with that "
            f"regressor."
        )
    if goal is not None and model.limits is not None:
        is_still = np.ptp(model.limits, axis=0) == 0
        unmoved = [name for name in names if is_still[places[name]]]
        if unmoved:
            regressor = model.regressors[places[unmoved[0]]]
            raise ValueError(
                f"Got the goal {unmoved}, but {regressor} did not move in the flights that the model "
                f"was learned from: learn from a flight in which it moves, or ask for another goal."
            )
    return names


def _amplitudes(
    trim: Trim, model: Aerodynamics, axes: Sequence[str], limits: Mapping[str, float]
) -> dict[str, float]:
    """Return the largest deviations of the axes, by default within the training ranges."""
    flown = {}
    if model.limits is not None:
        flown = dict(zip(model.regressors, model.limits.T.tolist(), strict=True))
    amplitudes = {}
    for axis in axes:
        if axis not in limits and axis not in flown:
            raise ValueError(
                f"Got no limit of the {axis}, and the model does not say what was flown: give "
                f"limits={{{axis!r}: ...}} (--limits)."
            )
        low, high = UNLIMITED if axis in limits else flown[axis]
        least, most = WHOLE_RANGE.get(axis, UNLIMITED)
        low = max(low, least)
        high = min(high, most)
        value = trim.controls[axis]
        room = min(value - low, high - value)
        if not room > 0:
            raise ValueError(
                f"Got a trim with the {axis} at {value:.3g}, but a range of {low:.3g} to {high:.3g}, "
                f"which leaves it no room: give limits={{{axis!r}: ...}} (--limits), leave it out of "
                f"the axes, or choose another trim."
            )
        amplitudes[axis] = float(min(limits.get(axis, np.inf), room))
    return amplitudes


@dataclass(frozen=True, eq=False)
class _Manoeuvre:
    """A manoeuvre that stays in the envelope."""

    name: str
    inputs: Inputs
    scale: float  # relative to the limits of the axes
    seconds: float  # of the manoeuvre and a pause beside it
    flight: pd.DataFrame
    rows: Matrix  # regressors (n, d) of the flight at the rate of the model's own rows


@dataclass(eq=False)
class _Planner:
    """Search for the manoeuvres of a flight."""

    model: Aerodynamics | BaseEstimator
    aircraft: Aircraft
    point: Trim
    limits: Mapping[str, float]
    envelope: Envelope
    thrust: Any
    goal: Sequence[str]
    seconds: float
    settings: PlanSettings

    def __post_init__(self) -> None:
        self.aerodynamics = as_aerodynamics(self.model)
        quarter = np.pi * self.point.airspeed / (2.0 * np.sqrt(2.0) * STANDARD_GRAVITY)
        self.pause = max(self.settings.response, quarter)  # at the trim beside a manoeuvre [s]
        self.bounds = self.envelope.bounds(self.aerodynamics)
        training_rows = self.aerodynamics.training_rows
        self.learned = None if training_rows is None else training_rows()  # regressors (n, d)
        self.interval = self.settings.row_step  # between rows of a log [s]
        if self.learned is not None and self.aerodynamics.training_seconds is not None:
            self.interval = self.aerodynamics.training_seconds / len(self.learned)
        places = _derivative_places(self.aerodynamics)
        self.slopes = [1 + places[name] for name in self.goal]

    def plan(self) -> Plan:
        """Return the plan."""
        notify("planning: library", 0, 0.0)
        available = self._library()
        notify(f"planning: choice from {len(available)} manoeuvres", 0, 0.0)
        chosen = self._choice(available)
        notify("planning: promise", 0, 0.0)
        rows = []
        flights = []
        start = self.pause
        for k, item in enumerate(chosen):
            duration = duration_of(item.inputs)
            rows.append({
                "start": start, "name": item.name, "duration": duration,
                "pause": self.pause, "scale": item.scale,
            })  # fmt: skip
            flights.append(item.flight.assign(flight=k))
            start += duration + self.pause
        rows[-1]["pause"] = self.settings.response
        return Plan(
            train=wavetrain([item.inputs for item in chosen], pause=self.pause, limits=self.limits),
            trim=self.point,
            manoeuvres=pd.DataFrame(rows),
            flight=pd.concat(flights, ignore_index=True),
            errors=self._errors(chosen),
            limits=pd.DataFrame(self.bounds, ["low", "high"]).T,
            aircraft=self.aircraft,
            margin=self.envelope.margin,
            servo_lag=self.aerodynamics.servo_lag,
        )

    # -- manoeuvres inside the envelope

    def _library(self) -> list[_Manoeuvre]:
        """Return the manoeuvres that fit into the time, each as large as the envelope allows."""
        full = self._candidates()
        centre = self._trimmed_channels()
        scales = dict.fromkeys(full, 1.0)
        inside = []
        cause = ""
        while scales:
            sized = {name: scaled(full[name], scale) for name, scale in scales.items()}
            flights = self._flights(sized)
            for name, inputs in sized.items():
                room = self._room(inputs, flights[name], centre)
                if room.min() >= 1.0:
                    inside.append(self._manoeuvre(name, inputs, scales.pop(name), flights[name]))
                    continue
                # Responses are nearly proportional to inputs
                scales[name] *= float(np.clip(room.min(), *self.settings.shrink))
                if scales[name] < self.settings.least_scale:
                    del scales[name]
                    cause = str(room.idxmin())
        if not inside:
            raise ValueError(
                f"Got an envelope that every manoeuvre leaves even at "
                f"{self.settings.least_scale:.0%} of the limits; the last one leaves it by "
                f"{self._named(cause)}: widen this limit, or fly another airspeed or altitude."
            )
        return inside

    def _candidates(self) -> dict[str, Inputs]:
        """Return the manoeuvres that fit into the time, as large as the limits of the axes."""
        modes = linearize(self.model, self.aircraft, self.point, thrust=self.thrust).modes()
        bands = input_bands(modes, self.limits, self.settings.band)
        longest = self.seconds - self.pause - self.settings.response
        candidates = {}
        for name, inputs in library(bands, self.limits, self.settings).items():
            if duration_of(inputs) <= longest:
                candidates[name] = inputs
        if not candidates:
            raise ValueError(
                f"Got {self.seconds:g} s, but no manoeuvre with pauses of {self.pause:.3g} s is that "
                f"short: give more seconds."
            )
        return candidates

    def _named(self, limit: str) -> str:
        """Return the words and the option of a limit."""
        return f"{limit.replace(GROWTH, 'flown ')} ({option_of(limit, self.aerodynamics)})"

    def _manoeuvre(
        self, name: str, inputs: Inputs, scale: float, flight: pd.DataFrame
    ) -> _Manoeuvre:
        seconds = duration_of(inputs) + self.pause
        X = regressors_of(flight, self.aircraft, self.aerodynamics.regressors)
        time = flight["time"].to_numpy(float)
        times = np.arange(time[0], time[-1] + 0.5 * self.interval, self.interval)
        rows = np.column_stack([np.interp(times, time, column) for column in X.T])
        return _Manoeuvre(name, inputs, scale, seconds, flight, rows)

    def _flights(self, manoeuvres: Mapping[str, Inputs]) -> dict[str, pd.DataFrame]:
        """Return the flights of manoeuvres by the mean in calm air, each with its response after it."""
        durations = {name: duration_of(inputs) for name, inputs in manoeuvres.items()}
        longest = max(durations.values()) + self.settings.response
        tables = []
        for name, inputs in manoeuvres.items():
            train = Wavetrain({axis: {0.0: signal} for axis, signal in inputs.items()})
            pause = longest - durations[name]
            tables.append(train.table(self.settings.rate, trim=self.point.controls, pause=pause))
        step = self.settings.row_step
        flown = simulate(
            self.model,
            self.aircraft,
            [self.point] * len(tables),
            tables,
            step,
            duration=step * np.floor(longest / step + ROUNDING),
            thrust=self.thrust,
        )
        parts = [flown]
        if len(tables) > 1:
            parts = [flight for _, flight in flown.groupby("start", sort=True)]
        flights = {}
        for (name, duration), flight in zip(durations.items(), parts, strict=True):
            is_recorded = flight["time"] <= duration + self.settings.response + ROUNDING
            flights[name] = flight[is_recorded].reset_index(drop=True)
        return flights

    def _trimmed_channels(self) -> Vector:
        """Return the channels of the envelope in trimmed flight, (c,); raise ValueError if they leave it."""
        nothing: Inputs = {next(iter(self.limits)): Steps([1.0], [0.0])}
        flight = self._flights({"trim": nothing})["trim"]
        centre = self.envelope.channels(flight, self.aircraft, self.aerodynamics).iloc[0]
        for name, (low, high) in self.bounds.items():
            if centre[name] < low or centre[name] > high:
                raise ValueError(
                    f"Got an envelope that trimmed flight at {self.point.airspeed:g} m/s and "
                    f"{self.point.altitude:.0f} m leaves by {self._named(name)}: widen this limit, or "
                    f"choose another airspeed or altitude."
                )
        return centre.to_numpy()

    def _room(self, inputs: Inputs, flight: pd.DataFrame, centre: Vector) -> pd.Series:
        """Return for each limit the factor of a response that meets it, with the margin."""
        if (flight["ended"] != "").any():
            return pd.Series({"the end of the simulation": 0.0})
        is_unattended = flight["time"] <= duration_of(inputs) + self.settings.reaction + ROUNDING
        values = self.envelope.channels(flight[is_unattended], self.aircraft, self.aerodynamics)
        is_set = [name.removeprefix(GROWTH) in self.limits for name in self.bounds]
        margin = np.where(is_set, 0.0, self.envelope.margin)  # a control has no response
        response = (1.0 + margin) * (values.to_numpy() - centre)
        low, high = np.array([*self.bounds.values()]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = (np.where(response > 0, high, low) - centre) / response
        factors = np.where(np.isfinite(factors), factors, np.inf)
        return pd.Series(factors.min(axis=0), index=values.columns)

    # -- choice

    def _choice(self, available: Sequence[_Manoeuvre]) -> list[_Manoeuvre]:
        """Return the sequence that reduces the errors most; raise ValueError if it hardly does."""
        informations = [information(item.rows) for item in available]
        largest = np.max([np.diag(matrix) for matrix in informations], axis=0)
        prior = self.settings.vague * np.diag(np.maximum(largest, UNMOVED))
        if self.learned is not None:
            prior += information(self.learned)
        seconds = np.array([item.seconds for item in available])
        time = self.seconds - self.settings.response
        choice = Choice(informations, seconds, prior, self.slopes, time)
        chosen = choice.best()
        worth = choice.gain(chosen) - choice.gain([])
        if worth < self.settings.worth:
            raise ValueError(
                f"Got the goal {list(self.goal)}, but {self.seconds:g} s of manoeuvres of "
                f"{list(self.limits)} within their limits lower its errors by {worth:.2%}: move "
                f"other axes, raise their limits, or ask for another goal."
            )
        return [available[k] for k in chosen]

    def _errors(self, chosen: Sequence[_Manoeuvre]) -> pd.DataFrame:
        """Return standard deviations of the goal before the flight, and promised after it."""
        point = vars(self.point)
        before = std_at(self.model, self.aircraft, point, self.thrust)
        promised = pd.Series(dtype=float)
        if self.learned is not None and len(before):
            added = np.concatenate([item.rows for item in chosen])
            promised = std_at(self.model, self.aircraft, point, self.thrust, added)
        errors = pd.DataFrame({"before": before, "promised": promised}, dtype=float)
        return errors.reindex(list(self.goal))

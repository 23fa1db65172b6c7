"""The next flight: manoeuvres that teach most about a goal inside an envelope, and their promises."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.messages import notify, warn
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, HAT, SURFACES
from skdgp._flight.excitation import ROUNDING, Wavetrain, wavetrain
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp._flight.tables import by_name, check_names, check_number, interpolated
from skdgp.design._envelope import (
    QUANTITIES,
    UNLIMITED,
    WHOLE_RANGE,
    Envelope,
    Range,
    common_range,
    regressors_of,
)
from skdgp.design._manoeuvres import (
    RESPONSE,
    ROW_STEP,
    Rehearsal,
    Rehearsed,
    duration_of,
    input_bands,
    library,
)
from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    Motion,
    SimulationWarning,
    Trim,
    as_aerodynamics,
    linearize,
    stability_derivatives,
)
from skdgp.plotting import TimeHistoryDisplay

# Controls whose effects only their own motion teaches
CONTROLS = (*SURFACES, "throttle")
# Axes that are no deflections
UNBOUNDED = ("thrust", "propeller_speed")
# Responses that are drawn
RESPONSES = ("alpha", "airspeed", "phi", "beta")
# Least relative reduction of the errors of the goal
WORTH = 0.002
# Information assumed of everything, relative to the largest of a manoeuvre
VAGUE = 1e-8
# Information of a manoeuvre below which motion is rounding
UNMOVED = 1e-6
# Longest flight [s], and deflection that no surface has [rad]
MOST_SECONDS = 1800.0
MOST_DEFLECTION = 0.5 * np.pi


@dataclass(frozen=True, eq=False)
class Plan:
    """Flight that `plan` has chosen, with expected standard deviations.

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
        :func:`skdgp.dynamics.stability_derivatives`: ``before`` the flight, and ``expected`` of a model
        learned from this flight too, if errors fall as those of linear least squares. NaN where the model has
        no posterior, or does not hold its rows.
    limits : DataFrame
        ``low`` and ``high`` limits of all manoeuvres: see :meth:`Envelope.bounds`.
    """

    train: Wavetrain
    trim: Trim
    manoeuvres: pd.DataFrame
    flight: pd.DataFrame
    errors: pd.DataFrame
    limits: pd.DataFrame

    @property
    def seconds(self) -> float:
        """Of the flight, pauses included [s]."""
        last = self.manoeuvres.iloc[-1]
        return float(last["start"] + last["duration"] + last["pause"])

    def plot(self, ax: Any = None) -> TimeHistoryDisplay:
        """Draw the moved controls and the expected responses; for ``ax`` see :mod:`skdgp.plotting`."""
        number = self.flight["flight"].to_numpy(int)
        starts = self.manoeuvres["start"].to_numpy(float)
        names = (*self.train.inputs, *RESPONSES)
        display = TimeHistoryDisplay(
            time=starts[number] + self.flight["time"].to_numpy(float),
            names=names,
            mean=self.flight[[*names]].to_numpy(float),
            estimate="expected",
        )
        return display.plot(ax)


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
) -> Plan:
    r"""Return the flight that teaches most about derivatives in a given time, inside an envelope.

    The library holds doublets, 3-2-1-1s and multisines, with times and bands from the modes. Each
    is simulated from a trim with the mean of the model in calm air. It is as large as the limits
    of the axes and the envelope with its margin let it be, or left out. Controls are open loop
    during a manoeuvre and a second after it. Before and after it is a pause at the trim, a
    quarter of the phugoid's period (Lanchester's, :math:`\sqrt{2} \pi V / g`), at least 3 s.

    With the rows X of the training flights and of manoeuvres, :math:`[(X^T X)^{-1}]_{kk}` is the
    variance of a slope by linear least squares in units of the noise. Manoeuvres are chosen one by
    one for the largest reduction per second of its mean logarithm over the goal.

    The standard deviation expected of a model that learns from both flights is the present one times the
    root of the ratio of these variances: errors by gusts and of the log do not fall as they do.
    :func:`skdgp.listening` shows the progress.

    Raises ValueError if the trim has not an axis or is outside the envelope, the model has not a
    regressor of the goal or did not see it move, no manoeuvre fits into the time, or no manoeuvre
    stays in the envelope. Warns if the model does not know the range of a quantity, and the
    envelope does not limit it.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        As for :func:`skdgp.dynamics.as_aerodynamics`. Without a posterior nothing is expected.
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
    envelope = envelope or Envelope()
    limits = limits or {}
    aerodynamics = as_aerodynamics(model)
    _check_options(seconds, axes, limits)
    check_names(axes, trim.controls, "controls of the trim")
    bounds = envelope.bounds(aerodynamics)
    if aerodynamics.is_uncertain and not np.isinf(envelope.growth):
        _warn_unlimited(bounds)
    motion = Motion(aerodynamics, aircraft, thrust=thrust)
    rehearsal = Rehearsal(motion, trim, axes, bounds, envelope.margin)
    goal = _check_goal(goal, aerodynamics, axes)
    amplitudes = _amplitudes(trim, aerodynamics, axes, limits)
    # a quarter of Lanchester's phugoid, or more
    pause = max(RESPONSE, np.pi * trim.airspeed / (2.0 * np.sqrt(2.0) * STANDARD_GRAVITY))
    time = seconds - RESPONSE
    with one_blas_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)
        modes = linearize(model, aircraft, trim, thrust=thrust).modes()
        bands = input_bands(modes, amplitudes)
        available = rehearsal.inside(library(bands, amplitudes), time, pause)
        notify(f"planning: choice from {len(available)} manoeuvres", 0, 0.0)
        rows = [_rows(item, motion) for item in available]
        lasting = [pause + duration_of(item.inputs) for item in available]
        chosen = _chosen(aerodynamics, rows, np.array(lasting), time, goal)
        if not chosen:
            raise ValueError(
                f"Got the goal {goal}, but {seconds:g} s of manoeuvres of {list(axes)} within their limits lower its "
                "errors too little: move other axes, raise their limits, or ask for another goal."
            )
        derivatives = stability_derivatives(model, aircraft, trim, thrust=thrust)
    before = derivatives.get("std", pd.Series(dtype=float))
    errors = _errors(before, aerodynamics, np.concatenate([rows[k] for k in chosen]))
    flown = [available[k] for k in chosen]
    flights = [item.flight.assign(flight=k) for k, item in enumerate(flown)]
    return Plan(
        train=wavetrain([item.inputs for item in flown], pause=pause, limits=amplitudes),
        trim=trim,
        manoeuvres=_timetable(flown, pause, RESPONSE),
        flight=pd.concat(flights, ignore_index=True),
        errors=errors.reindex(goal),
        limits=pd.DataFrame(bounds, ["low", "high"]).T,
    )


def _check_options(seconds: Any, axes: Any, limits: Mapping[str, float]) -> None:
    """Raise ValueError where an option of `plan` is none."""
    if isinstance(axes, str) or not len(axes) or len({*axes}) < len(axes):
        raise ValueError(
            f"Got axes={axes!r}, but expected different controls in a list, such as ['elevator', 'rudder']."
        )
    if check_number("seconds", seconds) > MOST_SECONDS:
        raise ValueError(
            f"Got seconds={seconds!r}, but expected at most {MOST_SECONDS:g}: plan a shorter flight, and fly it again."
        )
    check_names(limits, axes, "axes to move")
    for axis, limit in limits.items():
        check_number(f"limit of the {axis}", limit)
        if axis not in UNBOUNDED and not limit < MOST_DEFLECTION:
            raise ValueError(
                f"Got a limit of {limit:g} for the {axis}, but expected less than "
                f"{MOST_DEFLECTION:.3g}: rad, not degrees, or 0 to 1 of the throttle."
            )


def _warn_unlimited(bounds: Mapping[str, Range]) -> None:
    """Warn of quantities with neither a limit nor a known range."""
    free = [name for name in QUANTITIES if np.isinf(bounds[name]).all()]
    if free:
        warn(
            f"The model does not know the flown range of {', '.join(free)}, so nothing limits them: a manoeuvre may "
            "turn the aircraft over or dive. Limit them by the envelope, or fit the model again."
        )


def _derivatives(model: Aerodynamics) -> dict[str, str]:
    """Return the regressor of each derivative of the model, such as ``Cm_q``."""
    names = model.regressors
    return {f"{C}_{name.removesuffix(HAT)}": name for C in COEFFICIENTS for name in names}


def _check_goal(goal: Sequence[str] | None, model: Aerodynamics, axes: Sequence[str]) -> list[str]:
    """Return the names of a goal, by default all derivatives but those by controls that are not moved.

    Raises ValueError if the model cannot tell of one.
    """
    regressors = _derivatives(model)
    if goal is None:
        still = {*CONTROLS} - {*axes}
        return [name for name, regressor in regressors.items() if regressor not in still]
    if isinstance(goal, str) or not len(goal) or not {*goal} <= regressors.keys():
        raise ValueError(
            f"Got the goal {goal!r}, but the model has the regressors {list(model.regressors)}: give a list of "
            f"derivatives such as {next(iter(regressors))!r}, or learn a model with that regressor."
        )
    for name in goal:
        low, high = model.training_ranges.get(regressors[name], UNLIMITED)
        if low == high:
            raise ValueError(
                f"Got the goal {name}, but its regressor did not move in the flights that the model was learned "
                "from: learn from a flight in which it moves, or ask for another goal."
            )
    return list(goal)


def _amplitudes(
    trim: Trim, model: Aerodynamics, axes: Sequence[str], limits: Mapping[str, float]
) -> dict[str, float]:
    """Return the largest deviations of the axes, by default within the training ranges."""
    flown = model.training_ranges
    amplitudes = {}
    for axis in axes:
        if axis not in limits and axis not in flown:
            raise ValueError(
                f"Got no limit of the {axis}, and the model does not say what was flown: give "
                f"limits={{{axis!r}: ...}} (--limits)."
            )
        ends = UNLIMITED if axis in limits else flown[axis]
        low, high = common_range(ends, WHOLE_RANGE.get(axis, UNLIMITED))
        value = trim.controls[axis]
        room = min(value - low, high - value)
        if not room > 0:
            raise ValueError(
                f"Got a trim with the {axis} at {value:.3g}, but a range of {low:.3g} to {high:.3g}, which leaves it "
                f"no room: give limits={{{axis!r}: ...}} (--limits), leave it out of the axes, or choose another trim."
            )
        amplitudes[axis] = float(min(limits.get(axis, np.inf), room))
    return amplitudes


def _rows(item: Rehearsed, motion: Motion) -> Matrix:
    """Return the regressors (n, d) of a manoeuvre at the rate of the model's own rows."""
    interval = ROW_STEP
    learned = motion.aerodynamics.learned
    if learned is not None and learned.seconds is not None:
        interval = learned.seconds / len(learned.training_rows())
    time = item.flight["time"].to_numpy(float)
    times = np.arange(time[0], time[-1] + 0.5 * interval, interval)
    return interpolated(times, time, regressors_of(item.flight, motion))


def _chosen(
    model: Aerodynamics,
    rows: Sequence[Matrix],
    seconds: Vector,
    time: float,
    goal: Sequence[str],
) -> list[int]:
    """Return the sequence of manoeuvres that lowers the errors of the goal most; none if it hardly does."""
    informations = np.array([information(X) for X in rows])
    moved = np.einsum("kii->ki", informations).max(axis=0)
    fisher = VAGUE * np.diag(np.maximum(moved, UNMOVED))
    if model.learned is not None:
        fisher += information(model.learned.training_rows())
    regressors = _derivatives(model)
    slopes = [1 + model.regressors.index(regressors[name]) for name in goal]  # behind the constant
    error = before = _mean_error(fisher, slopes)
    left = time + ROUNDING
    chosen: list[int] = []
    # greedy: exchanges of single manoeuvres afterwards would lower errors by 1 %
    while (seconds <= left).any():
        fitting = np.flatnonzero(seconds <= left)
        errors = [_mean_error(fisher + informations[k], slopes) for k in fitting]
        best = int(np.argmax(np.subtract(error, errors) / seconds[fitting]))
        chosen.append(int(fitting[best]))
        fisher += informations[chosen[-1]]
        left -= seconds[chosen[-1]]
        error = errors[best]
    return chosen if before - error >= WORTH else []


def _mean_error(fisher: Matrix, slopes: list[int]) -> float:
    """Return the mean logarithm of the standard deviations of some slopes by their information."""
    return float(0.5 * np.mean(np.log(variances(fisher)[slopes])))


def information(X: Matrix) -> Matrix:
    """Return the Fisher information (1 + d, 1 + d) of rows X (n, d) for noise of unit variance.

    It concerns a constant and the slopes of a coefficient that is linear in the regressors. The
    noise of a coefficient is a factor of all its variances, so the information serves all six.
    """
    rows = np.column_stack([np.ones(len(X)), X])
    return rows.T @ rows


def variances(fisher: Matrix) -> Vector:
    """Return the variances (1 + d,) of constant and slopes by their information."""
    scale = np.sqrt(np.diag(fisher))
    inverse = np.linalg.inv(fisher / np.outer(scale, scale))
    return np.diag(inverse) / scale**2


def _errors(before: pd.Series, model: Aerodynamics, rows: Matrix) -> pd.DataFrame:
    """Return standard deviations of derivatives before the flight, and those expected with its rows (k, d) too."""
    expected = pd.Series(dtype=float)
    if model.learned is not None:
        known = information(model.learned.training_rows())
        ratio = np.sqrt(variances(known + information(rows)) / variances(known))[1:]
        expected = before * pd.Series(_derivatives(model)).map(by_name(model.regressors, ratio))
    return pd.DataFrame({"before": before, "expected": expected}, dtype=float)


def _timetable(flown: Sequence[Rehearsed], pause: float, end: float) -> pd.DataFrame:
    """Return the manoeuvres one after another, with the pause after each and at the end."""
    table = pd.DataFrame({"name": [item.name for item in flown]})
    table["duration"] = [duration_of(item.inputs) for item in flown]
    table["pause"] = [*[pause] * (len(flown) - 1), end]
    table["scale"] = [item.scale for item in flown]
    ends = (table["duration"] + pause).cumsum()
    table.insert(0, "start", pause + ends.shift(fill_value=0.0))
    return table

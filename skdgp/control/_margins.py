r"""Margins of control loops around a linear model and its paths, and gains that have wanted margins.

The loop transfer function of a loop, opened at its control with the other loops closed, is

.. math:: L_i = M_{ii} - M_{io} (I + M_{oo})^{-1} M_{oi}, \quad M = -K(s) G(s) e^{-s \tau}

with the response G of the linear model, the laws K of all loops and the delay tau of commands and servos
(Skogestad & Postlethwaite 2005, sections 2.4 and 4.9).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array, Mask, Matrix, Vector
from skdgp.control._loops import FEEDBACK, LOOP_AXES, Loop
from skdgp.dynamics import (
    LATERAL,
    LONGITUDINAL,
    LinearModel,
)

# States that neither loads nor outputs of interest depend on: their modes are at zero
UNUSED = ("north", "east", "down", "psi")
# Range [rad/s] and number of frequencies, and their number in a search for gains
FREQUENCIES = (0.02, 1000.0)
N_FREQUENCIES = 1400
N_SEARCHED = 400
# Growth [1/s] below which a slow mode does not count as unstable, a spiral that doubles in seven seconds
GROWTH = 0.1
# Interval of values over the paths
INTERVAL = (0.05, 0.95)
# Usual requirements [dB], [deg]: least gain and phase, largest sensitivity
REQUIRED = {"gain": 6.0, "phase": 45.0, "sensitivity": 2.0}
# Margins of a loop that is not stable
OF_UNSTABLE = {"gain": -np.inf, "phase": -np.inf, "sensitivity": np.inf}
# Largest factor of suggested gains [dB], up or down, and the two steps of the search
LARGEST_FACTOR = 26.0
STEPS = (2.0, 0.25)
# Ends of the ranges of parameters in ArduPilot Plane 4.5, and in PX4 1.14
LARGEST = {"_RATE_P": 0.35, "_RATE_I": 0.6, "_RATE_D": 0.03, "YAW2SRV_DAMP": 2.0}
LARGEST |= dict.fromkeys(("R_P", "R_I", "R_D"), 10.0)
# Most rounds over the loops, since each changes the others
ROUNDS = 10


def margins(linear: LinearModel, loops: Sequence[Loop]) -> pd.DataFrame:
    r"""Return the margins of each loop, opened at its control with the other loops closed.

    The gain margin is the smallest rise of all gains of the loop, and the phase margin the smallest
    turn of L at a crossover, negative for a lead, that makes the aircraft unstable. The sensitivity is
    the largest :math:`|1 / (1 + L)|`. Delays are exact. A closed loop with an unstable mode has margins
    of minus infinity; growth of a mode of frequency w up to :math:`0.1 / (1 + w^2)` 1/s does not count, nor
    does a lateral mode, such as the spiral, for a pitch loop alone, nor a longitudinal one for loops of roll and yaw.
    Each deflection has the sign that turns the aircraft of the mean in the positive direction.

    Parameters
    ----------
    linear : LinearModel
        Of :func:`skdgp.dynamics.linearize`, with ``n_paths`` for intervals and ``delay``.
    loops : sequence of Loop
        Of `autopilot_loops`.

    Returns
    -------
    DataFrame
        Rows (loop, quantity) with the quantities ``gain`` [dB], ``phase`` [deg], ``sensitivity`` and
        ``crossover`` [rad/s]; columns ``value``, of the mean, ``lower`` and ``upper``, which hold 90 % of the
        paths, ``probability`` that the gain margin is at least 6 dB, the phase margin 45 deg, and the
        sensitivity at most 2. ``attrs["unstable"]`` has the loops whose motion, along or across the plane of symmetry,
        has a growing mode, with the fraction of the paths, or of the mean.

    Raises
    ------
    ValueError
        If there are no loops, two of a control, or one of a control that the linear model has not.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.control import autopilot_loops, margins
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, linearize, trim
    >>> def roll(X):
    ...     alpha, p, aileron, elevator = X.T
    ...     zero = np.zeros_like(p)
    ...     lift = 0.3 + 4.5 * alpha
    ...     moments = [-0.4 * p + 0.1 * aileron, -elevator - alpha, zero]
    ...     return np.stack([-0.03 + lift * alpha, zero, -lift, *moments], axis=-1)
    >>> model = Aerodynamics(roll, ["alpha", "p_hat", "aileron", "elevator"])
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> linear = linearize(model, aircraft, trim(model, aircraft, 20.0), delay=0.02)
    >>> px4 = {"FW_RR_P": 0.5, "FW_RR_I": 0.2, "FW_RR_FF": 0.0, "FW_R_TC": 0.5, "FW_ARSP_SCALE_EN": 0}
    >>> px4 |= {"FW_AIRSPD_TRIM": 15.0, "FW_AIRSPD_STALL": 7.0, "FW_AIRSPD_MAX": 20.0}
    >>> px4 |= {"IMU_GYRO_CUTOFF": 40.0, "IMU_DGYRO_CUTOFF": 30.0}
    >>> loops = autopilot_loops(px4, full={"aileron": 0.42})
    >>> margins(linear, loops).loc["roll", "value"].round(1).to_dict()
    {'gain': 13.2, 'phase': 124.4, 'sensitivity': 1.3, 'crossover': 2.8}
    """
    _check(linear, loops)
    s: Any = 1j * _frequencies(N_FREQUENCIES)
    transfer = _of_loops(_responses(linear, _models(linear), loops, s), linear, loops, s)
    unstable = _stability(linear, loops, N_FREQUENCIES)(loops)
    rows = []
    for k, loop in enumerate(loops):
        loop_margins = _margins_of(transfer[..., k], s.imag)
        for quantity, values in loop_margins.items():
            if quantity in OF_UNSTABLE:
                values[unstable[:, k]] = OF_UNSTABLE[quantity]
            rows.append({"loop": loop.name, "quantity": quantity} | _spread(quantity, values))
    table = pd.DataFrame(rows).set_index(["loop", "quantity"])
    table.attrs["unstable"] = _fractions(unstable, loops)
    return table


def _fractions(unstable: Mask, loops: Sequence[Loop]) -> dict[str, float]:
    """Return the loops of growing modes, and in which fraction of the paths, or of the mean, these grow."""
    first = min(1, len(unstable) - 1)  # the mean where there are no paths
    fractions = unstable[first:].mean(axis=0).tolist()
    return {loop.name: part for loop, part in zip(loops, fractions, strict=True) if part}


def suggest_gains(
    linear: LinearModel,
    loops: Sequence[Loop],
    *,
    gain_margin: float = 6.0,
    phase_margin: float = 45.0,
    probability: float = 0.95,
) -> list[Loop]:
    """Return the loops with the largest gains that have both margins with a probability.

    P, I and D of a loop keep their ratios. FF and D_FF stay as they are: FF follows from the rate of turn that
    a deflection causes. The loops are taken in turn, each with the others closed
    at their new gains, until none changes.

    Parameters
    ----------
    linear : LinearModel
        With paths, see `margins`.
    loops : sequence of Loop
    gain_margin, phase_margin : float
        Wanted [dB], [deg].
    probability : float

    Returns
    -------
    list of Loop
        `Loop.parameters` has the values to set, by name.

    Raises
    ------
    ValueError
        If `margins` refuses the loops, the linear model has no paths, the probability is not between 0 and 1,
        no gains between a twentieth and twenty times the present ones have the margins, or gains still
        change after ten rounds.

    Warns
    -----
    UserWarning
        Of values above the ranges that the firmware documents.
    """
    _check(linear, loops)
    if linear.paths is None:
        raise ValueError(
            "Got a linear model without paths, but expected linearize(..., n_paths=200)."
        )
    if not 0 < probability < 1:
        raise ValueError(f"Got probability={probability!r}, but expected a number between 0 and 1.")
    s: Any = 1j * _frequencies(N_SEARCHED)
    responses = _responses(linear, _models(linear)[1:], loops, s)
    unstable = _stability(linear, loops, N_SEARCHED)

    def is_enough(rises: Vector, k: int) -> bool:
        """Return whether enough paths have both margins of loop k, and are stable, with rises of all gains [dB]."""
        risen = _risen(loops, rises)
        found = _margins_of(_of_loops(responses, linear, risen, s)[..., k], s.imag)
        is_good = (found["gain"] >= gain_margin) & (found["phase"] >= phase_margin)
        if np.mean(is_good) < probability:
            return False
        return bool(np.mean(is_good & ~unstable(risen)[1:, k]) >= probability)

    rises = np.zeros(len(loops))  # dB, of the gains given
    for _ in range(ROUNDS):
        before = rises.copy()
        for k, loop in enumerate(loops):
            rises[k] = _largest_rise(is_enough, rises, k)
            if np.isnan(rises[k]):
                part = np.mean(unstable(loops)[1:, k])
                raise ValueError(
                    f"Got no gains of the {loop.name} loop with {gain_margin:g} dB and {phase_margin:g} deg in "
                    f"{probability:.0%} of the paths; the gains given are unstable in {part:.0%}. Lower the wanted "
                    "margins, shorten the delay, start from stable gains, or fly manoeuvres that tell the derivatives."
                )
        if np.array_equal(rises, before):
            suggested = _risen(loops, rises)
            _warn_of_ranges(suggested)
            return suggested
    changing = [loops[k].name for k in np.flatnonzero(rises != before).tolist()]
    raise ValueError(
        f"Got gains of {changing} that still change after {ROUNDS} rounds over the loops, but expected that they "
        "settle: lower the wanted margins, or suggest gains of fewer loops."
    )


def _largest_rise(is_enough: Callable[[Vector, int], bool], rises: Vector, k: int) -> float:
    """Return the largest rise [dB] of the gains of loop k that is enough beside those of the others, NaN if none is."""
    coarse, fine = STEPS
    trial = rises.copy()
    trial[k] = LARGEST_FACTOR
    while not is_enough(trial, k):
        trial[k] -= coarse
        if trial[k] < -LARGEST_FACTOR:
            return np.nan
    best = trial[k]
    while best < LARGEST_FACTOR:
        trial[k] = best + fine
        if not is_enough(trial, k):
            break
        best = trial[k]
    return float(best)


def _warn_of_ranges(loops: Sequence[Loop]) -> None:
    """Warn of parameters above the ranges that the firmware documents."""
    above = []
    for loop in loops:
        for name, value in (loop.parameters or {}).items():
            most = next((most for ending, most in LARGEST.items() if name.endswith(ending)), np.inf)
            if value > most:
                above.append(f"{name} {value:.3g} (up to {most:g})")
    if above:
        warn(
            f"The firmware's documentation has smaller values of {', '.join(above)}: a linear model has no limits of "
            "rates and deflections. Raise these parameters in steps, or ask for larger margins."
        )


def _risen(loops: Sequence[Loop], rises: Vector) -> list[Loop]:
    """Return the loops with gains that are higher by ``rises`` [dB]."""
    return [loop.scaled(_factor(rise), FEEDBACK) for loop, rise in zip(loops, rises, strict=True)]


def _factor(decibels):
    return float(10 ** (decibels / 20))


def _check(linear, loops):
    """Raise ValueError if loops are none, two of a control, or of controls that are no inputs."""
    inputs = [*linear.B.columns]
    controls = [loop.control for loop in loops]
    moved = controls + ["rudder" for loop in loops if loop.rudder]
    missing = sorted({*moved} - {*inputs})
    if missing:
        raise ValueError(f"Got loops of {missing}, but the linear model has the inputs {inputs}.")
    if not loops or len(set(controls)) < len(controls):
        raise ValueError(
            f"Got loops of {controls}, but expected at least one, each of its own control."
        )


def _frequencies(n: int) -> Vector:
    return np.geomspace(*FREQUENCIES, n)


def _inputs(linear, loops):
    """Return the deflections of the inputs for one of each loop's control, (n_inputs, n_loops).

    Positive ones turn the aircraft of the mean in the positive direction. The rudder follows by its mix.
    """
    inputs = pd.DataFrame(0.0, linear.B.columns, range(len(loops)))
    for k, loop in enumerate(loops):
        inputs.loc[loop.control, k] = _sign(linear, loop.control, LOOP_AXES[loop.name][0])
        if loop.rudder:
            inputs.loc["rudder", k] = _sign(linear, "rudder", "r") * loop.rudder / loop.full
    return inputs.to_numpy()


def effect_of(linear: LinearModel, control: str, rate: str) -> float:
    """Return the angular acceleration of a rate by a deflection of a control."""
    position = f"{control}_position"
    # behind a servo the deflection is a state
    table, name = (linear.A, position) if position in linear.A else (linear.B, control)
    return float(table.loc[rate, name])


def _sign(linear, control, rate):
    """Return the sign of the effect of a control on a rate."""
    return -1.0 if effect_of(linear, control, rate) < 0 else 1.0


def _models(linear) -> list[tuple]:
    """Return A, B, C, D and the delay of the servos of the mean and of each path."""
    models = [(linear.A, linear.B, linear.C, linear.D, linear.servos.delay)]
    if linear.paths is not None:
        models += zip(*linear.paths, strict=True)
    return models


def _responses(linear, models, loops, s, unused=UNUSED) -> Array:
    """Return the responses (n_models, n, n_outputs, n_loops) of `_models` to commands with their delay and signs.

    They are without the motion of ``unused`` states.
    """
    inputs = _inputs(linear, loops)
    kept = [k for k, name in enumerate(linear.A.index) if name not in unused]
    responses = []
    # one by one: the resolvents of all would fill the memory
    for *matrices, delay in models:
        A, B, C, D = map(np.asarray, matrices)
        late = np.exp(-s * (linear.delay + delay))[:, None, None]
        resolvent = s[:, None, None] * np.eye(len(kept)) - A[np.ix_(kept, kept)]
        states = np.linalg.solve(resolvent, (B @ inputs)[None, kept])
        responses.append((C[:, kept] @ states + D @ inputs) * late)
    return np.array(responses)


def _gains(linear, loops, s):
    """Return the laws K (n, n_loops, n_outputs)."""
    outputs = [*linear.C.index]
    K = np.zeros((len(s), len(loops), len(outputs)), dtype=complex)
    for k, loop in enumerate(loops):
        for name, law in loop.feedback(s, linear.airspeed, linear.density).items():
            K[:, k, outputs.index(name)] = law
    return K


def _of_loops(responses, linear, loops, s):
    """Return the loop transfer functions, each with the other loops closed, (n_models, n, n_loops).

    Sensitivity 1 / (1 + L) and L / (1 + L) of loop i are the entries (i, i) of S = (I + M)^-1 and M S.
    """
    M = -_gains(linear, loops, s) @ responses
    S = np.linalg.inv(np.eye(len(loops)) + M)
    return np.einsum("...ii->...i", M @ S) / np.einsum("...ii->...i", S)


def _stability(
    linear: LinearModel, loops: Sequence[Loop], n_frequencies: int
) -> Callable[[Sequence[Loop]], Mask]:
    r"""Return a function of loops that tells whether a closed mode grows faster than a bound, (1 + n_paths, n_loops).

    By the argument principle :math:`\det(s I - A) \det(I + M)` over :math:`(s + 1)^n` turns once around zero for each
    root to the right of the curve :math:`s = g / (1 + w^2) + j w`, as it is one at infinity: g is the growth that a
    slow mode may have. Motions along and across the plane of symmetry are judged apart, each by its loops, as a pitch
    loop does not move the spiral. Modes of both together count where neither alone has one.
    """
    beyond = FREQUENCIES[1] * np.geomspace(1.0, 10.0, n_frequencies // 5)[1:]
    w = np.concatenate([[0.0], _frequencies(n_frequencies), beyond])
    s: Any = GROWTH / (1.0 + w**2) + 1j * w
    axes = _axes(linear, loops, s)

    def unstable(closed: Sequence[Loop]) -> Mask:
        K = _gains(linear, closed, s)
        unstable = np.zeros((len(_models(linear)), len(loops)), dtype=bool)
        for numbers, (aircraft, responses) in axes.items():
            M = -K[:, numbers] @ responses
            angle = np.angle(aircraft * np.linalg.det(np.eye(len(numbers)) + M))
            angle = np.unwrap(angle, axis=-1)
            # half a turn for each root, as the curve is the upper half
            grows = angle[:, 0] - angle[:, -1] > 0.5 * np.pi
            if len(numbers) == len(loops):
                grows &= ~unstable.any(axis=1)
            unstable[:, numbers] |= grows[:, None]
        return unstable

    return unstable


def _axes(
    linear: LinearModel, loops: Sequence[Loop], s: Array
) -> dict[tuple[int, ...], tuple[Array, Array]]:
    """Return motions along and across the plane of symmetry, and both together, by the numbers of their loops.

    For the mean and each path det(s I - A) / (s + 1)^n of the aircraft without loops, (1 + n_paths, n), and its
    responses to the commands of the loops, (1 + n_paths, n, n_outputs, n_loops).
    """
    models = _models(linear)
    A = np.array([model[0] for model in models])
    axes: dict[tuple[int, ...], tuple[Array, Array]] = {}
    for others in (LATERAL, LONGITUDINAL, ()):
        moved = [LOOP_AXES[loop.name][0] not in others for loop in loops]
        numbers = tuple(np.flatnonzero(moved).tolist())
        if numbers and numbers not in axes:
            unused = {*UNUSED, *others}
            kept = ~linear.A.index.isin(unused)
            roots = np.linalg.eigvals(A[:, kept][:, :, kept])
            aircraft = np.prod((s[:, None] - roots[:, None, :]) / (s[:, None] + 1.0), axis=-1)
            axes[numbers] = aircraft, _responses(linear, models, loops, s, unused)[..., numbers]
    return axes


def _margins_of(transfer: Matrix, w: Vector) -> dict[str, Vector]:
    """Return the margins of loop transfer functions (n_models, n) at frequencies w [rad/s], as of `margins`.

    Of several crossings the smallest phase margin counts, and the smallest rise of the gain. Without a
    crossing the margin is infinite, and the frequency unknown.
    """
    places = np.arange(len(w))
    rows = []
    for L in transfer:
        size = 20 * np.log10(np.abs(L))
        crossings = _zeros(size)
        # angles from -180 deg: positive is a margin
        phases = np.rad2deg(np.angle(-np.interp(crossings, places, L)))
        smallest = np.argmin(np.abs([*phases, np.inf]))
        phase, crossover = [*phases, np.inf][smallest], [*crossings, np.nan][smallest]
        # at -180 deg the angle falls; where it rises, a larger gain makes a mode stable
        falling = _zeros(-L.imag, falling=True)
        at_180 = falling[np.interp(falling, places, L.real) < 0]
        gains = -np.interp(at_180, places, size)
        rows.append([gains[gains > 0].min(initial=np.inf), phase, crossover])
    gain, phase, crossings = np.transpose(rows)
    return {
        "gain": gain,
        "phase": phase,
        "sensitivity": (1 / np.abs(1 + transfer)).max(axis=-1),
        "crossover": np.exp(np.interp(crossings, places, np.log(w))),
    }


def _zeros(values, *, falling=False):
    """Return the places, fractions of an index, where values (n,) cross zero, or fall below it."""
    signs = values > 0
    is_before = signs[:-1] & ~signs[1:] if falling else signs[:-1] != signs[1:]
    first = np.flatnonzero(is_before)
    return first - values[first] / (values[first + 1] - values[first])


def _spread(quantity, values):
    """Return the columns of a quantity from its values of the mean and of the paths (1 + n_paths,)."""
    value, paths = float(values[0]), values[1:]
    lower = upper = probability = np.nan
    known = paths[~np.isnan(paths)]
    if len(known):
        lower, upper = np.quantile(known, INTERVAL, method="nearest").tolist()
    if len(paths) and quantity in REQUIRED:
        sign = -1.0 if quantity == "sensitivity" else 1.0
        probability = float(np.mean(sign * paths >= sign * REQUIRED[quantity]))
    return {"value": value, "lower": lower, "upper": upper, "probability": probability}

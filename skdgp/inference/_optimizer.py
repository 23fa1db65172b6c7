r"""The maximisation of a likelihood from one starting point: a quasi-Newton method with average information.

The curvature of the likelihood is the average information A (``log_likelihood``) plus a correction S,
which the gradients of two points show (Dennis, Gay & Welsch 1981, "An adaptive nonlinear
least-squares algorithm", with A in place of their Gauss-Newton matrix). With the gradient g a step s
is

.. math:: (A + S + \lambda\, (\mathrm{diag}(A) + 1))\, s = g

for the hyperparameters that are not at a bound which g points out of. The damping lambda falls after
steps that raise the likelihood as predicted, and rises after others (Nocedal & Wright 2006,
algorithm 4.1). Steps end on grids: where a likelihood is flat they multiply rounding errors, which
would choose between its maxima otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from skdgp._compute.messages import Progress, notify
from skdgp._compute.typing import Mask, Matrix, Vector
from skdgp.inference._likelihood import Likelihood


@dataclass(frozen=True)
class OptimizerSettings:
    """When a maximisation has converged, and how steps are damped."""

    #: Slope by every hyperparameter, for its standard error, below which the point is stationary [nats]
    gradient: float = 1e-3
    #: First, least and largest damping, beyond which rounding hides every rise
    damping: tuple[float, float, float] = (0.1, 1e-5, 1e6)
    #: Longest step of a hyperparameter: a factor of e^2 of a width
    longest: float = 2.0
    #: Spacing of the grid, over the standard error of a hyperparameter (trials with regressors that
    #: differ by 1e-12)
    grid: float = 0.05
    #: Least fraction of the predicted rise that a step keeps on the grid; otherwise the grid is refined (guess)
    kept: float = 0.9
    #: Fractions of the predicted rise: above which a step is taken, below which the damping rises,
    #: and above which it falls
    accepted: float = 1e-4
    poor: float = 0.25
    good: float = 0.75
    #: A climb may still rise by so many times what its quadratic model promises (of 30 climbs at most 10
    #: times from the start, where half rise by less than 2.5 times), and by so many nats from a saddle
    times: float = 10.0
    spare: float = 3.0


SETTINGS = OptimizerSettings()
GRIDS = 30  # the finest has the spacing of rounding errors
ROUNDING = 1e-9  # distance from a bound at which a step ends there


class Optimum(NamedTuple):
    """The result of a maximisation; ``converged`` is whether it is a stationary point, up to rounding, or at bounds."""

    theta: Vector
    value: float
    n_determined: int
    n_iter: int
    converged: bool


def maximize(
    objective: Callable[[Vector], Likelihood],
    theta: Vector,
    bounds: Matrix,
    *,
    max_iter: int,
    stage: str = "fit",
    least: Callable[[Likelihood], float] = lambda point: -np.inf,
) -> Optimum:
    """Return the end of a search that starts at ``theta``.

    Parameters
    ----------
    objective : callable
        theta (n,) -> `Likelihood`, or LinAlgError where it is not defined.
    theta : ndarray (n,)
        Starting point; values outside the bounds move to them.
    bounds : ndarray (n, 2)
    max_iter : int
        Largest number of steps, each with one evaluation.
    stage : str
        Name of the stage for progress listeners.
    least : callable
        point -> the value that the end must reach to count. The search ends, not converged, where
        its quadratic model does not promise that: from the optimum of a simpler model this is the
        score test of the hyperparameters that are added (Rao 1948).

    Returns
    -------
    Optimum

    Raises
    ------
    numpy.linalg.LinAlgError
        If the likelihood is not defined at the start.
    """
    theta = np.clip(theta, *bounds.T)
    origin = theta
    point = objective(theta)
    correction = np.zeros_like(point.information)
    damping, smallest, largest = SETTINGS.damping
    n_iter = 0
    while not _is_stationary(theta, point, bounds):
        curvature = point.information + correction
        if damping > largest:
            # rounding hides whether the likelihood rises, but it would hardly
            is_flat = _promise(theta, point, bounds) < SETTINGS.gradient
            return Optimum(theta, point.value, point.n_determined, n_iter, is_flat)
        if n_iter == max_iter or _is_hopeless(theta, point, bounds, least):
            return Optimum(theta, point.value, point.n_determined, n_iter, False)
        n_iter += 1
        end, predicted = _proposed(theta, point, curvature, bounds, damping, origin)
        step = end - theta
        other = _evaluated(objective, end) if predicted > 0 else None
        if other is None:
            damping *= 4.0
            continue
        rise = other.value - point.value
        is_taken = rise > SETTINGS.accepted * predicted
        information = other.information if is_taken else point.information
        change = point.gradient - other.gradient
        correction = _corrected(correction, information, step, change)
        if rise < SETTINGS.poor * predicted:
            damping *= 4.0
        elif rise > SETTINGS.good * predicted:
            damping = max(smallest, damping / 3.0)
        if is_taken:
            theta, point = end, other
        notify(_counted(stage, n_iter, max_iter), n_iter, point.value)
    return Optimum(theta, point.value, point.n_determined, n_iter, True)


def _is_hopeless(theta, point, bounds, least):
    """Return whether the likelihood will hardly reach the least that counts."""
    missing = least(point) - point.value - SETTINGS.spare
    return missing > 0.0 and SETTINGS.times * _promise(theta, point, bounds) < missing


def _counted(stage: str, n_iter: int, max_iter: int) -> str:
    """Return a stage with its number of steps, unless it is a step of a longer one."""
    return stage if isinstance(stage, Progress) else Progress(stage, n_iter, max_iter)


def _free(theta: Vector, gradient: Vector, bounds: Matrix) -> Mask:
    """Return the mask of the hyperparameters that are not at a bound which the gradient points out of."""
    below = (theta <= bounds[:, 0]) & (gradient <= 0)
    above = (theta >= bounds[:, 1]) & (gradient >= 0)
    return ~(below | above)


def _is_stationary(theta, point, bounds):
    free = _free(theta, point.gradient, bounds)
    error = _standard_errors(point.information)
    return bool(np.all(np.abs(point.gradient * error)[free] <= SETTINGS.gradient))


def _promise(theta, point, bounds):
    """Return the rise of the likelihood that its damped quadratic model promises, without a correction."""
    step = _step(theta, point, point.information, bounds, SETTINGS.damping[0])
    return 0.5 * float(step @ point.gradient)


def _proposed(theta, point, curvature, bounds, damping, origin):
    """Return the end of a step on the coarsest grid that keeps most of its predicted rise, and this rise.

    Grids lie about the ``origin``, where the search began, so that units of the regressors do not matter.
    """
    step = _step(theta, point, curvature, bounds, damping)
    promised = _predicted_rise(step, point, curvature)
    if promised <= 0.0:
        return theta + step, promised
    spacing = SETTINGS.grid * _standard_errors(point.information)
    for _ in range(GRIDS):
        end = _on_grid(theta + step, spacing, bounds, origin)
        predicted = _predicted_rise(end - theta, point, curvature)
        if predicted > SETTINGS.kept * promised:
            return end, predicted
        spacing /= 3.0
    return theta + step, promised


def _step(theta, point, curvature, bounds, damping):
    """Return the damped step inside the bounds, of which none is longer than ``SETTINGS.longest``.

    Hyperparameters that the step would take beyond these limits end there, and the others follow.
    Where the curvature is not positive definite the damping is larger. A hyperparameter by whose unit the
    likelihood hardly changes keeps its value, as rounding errors would move it.
    """
    moves = np.abs(point.gradient) + np.diag(point.information) > SETTINGS.gradient
    free = _free(theta, point.gradient, bounds) & moves
    step = np.zeros(len(theta))
    lowest, highest = np.clip((bounds - theta[:, None]).T, -SETTINGS.longest, SETTINGS.longest)
    unit = np.diag(point.information) + 1.0
    while free.any():
        gradient = point.gradient - curvature @ step
        of_free = curvature[np.ix_(free, free)]
        try:
            factor = cho_factor(of_free + np.diag(damping * unit[free]))
        except np.linalg.LinAlgError:
            damping = max(4.0 * damping, 1e-6)
            continue
        target = step.copy()
        target[free] = cho_solve(factor, gradient[free])
        step = np.clip(target, lowest, highest)
        limited = free & (step != target)
        if not limited.any():
            return step
        step[free & ~limited] = 0.0
        free = free & ~limited
    return step


def _standard_errors(information):
    """Return the standard error of each hyperparameter beside known others, at most one unit."""
    return 1.0 / np.sqrt(np.diag(information) + 1.0)


def _predicted_rise(step, point, curvature):
    """Return the rise of the likelihood by a step, of its quadratic model."""
    return step @ point.gradient - 0.5 * step @ curvature @ step


def _on_grid(theta, spacing, bounds, origin):
    """Return the centre of the cell of a grid about the origin that theta is in, or a bound.

    The spacing is a power of three, as the standard errors have rounding errors too: a centre is also
    one of a finer grid, so that no step begins between two cells.
    """
    low, high = bounds.T
    spacing = 3.0 ** np.round(np.log(spacing) / np.log(3.0))
    centre = np.clip(origin + spacing * np.rint((theta - origin) / spacing), low, high)
    is_low, is_high = theta <= low + ROUNDING, theta >= high - ROUNDING
    return np.where(is_low, low, np.where(is_high, high, centre))


def _corrected(S, A, step, change):
    """Return the correction with which A + S maps a step to the change of the gradient along it.

    Sizing and update of Dennis, Gay & Welsch (1981, equations 2.6 and 2.9).
    """
    slope = change @ step
    if slope <= 1e-8 * np.linalg.norm(change) * np.linalg.norm(step):
        return S  # the likelihood is not concave along the step
    missing = change - A @ step
    along = step @ S @ step
    if along != 0.0:
        S = min(1.0, abs(step @ missing / along)) * S
    missing = missing - S @ step
    cross = np.multiply.outer(missing, change) / slope
    square = (missing @ step) / slope**2 * np.multiply.outer(change, change)
    return S + cross + cross.T - square


def _evaluated(objective, theta):
    """Return the likelihood, None where it is not defined."""
    try:
        point = objective(theta)
    except np.linalg.LinAlgError:
        return None
    is_finite = np.isfinite(point.value) and np.isfinite(point.gradient).all()
    return point if is_finite else None

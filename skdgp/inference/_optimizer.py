"""The maximisation of a likelihood from one starting point, by L-BFGS-B."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Event
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import LbfgsInvHessProduct, minimize

from skdgp._compute.messages import keeps_best, notify
from skdgp._compute.typing import Matrix, Vector


@dataclass(frozen=True)
class OptimizerSettings:
    """When a maximisation ends, and where it evaluates."""

    #: Rise of the value in one iteration, as a fraction of the value, below which it is the last
    tolerance: float = 1e-5
    #: Slope below which the maximum is reached [nats]
    gradient: float = 1e-4
    #: Spacing of the points that are evaluated, from the lower bounds on, over the width of the
    #: bounds, so that rounding does not choose the optimum; zero: any points
    grid: float = 0.0
    #: Largest width of bounds that counts for the grid
    widest: float = 16.0
    #: Last evaluations, whose rise is extrapolated
    recent: int = 10
    #: Pairs of steps and changes of the gradient that L-BFGS keeps
    corrections: int = 20
    #: Whether parameters may be searched in units of their information at the start: the same maximum
    #: after half to a third of the evaluations, of several outputs with more regressors
    by_information: bool = True


STOPPED = 99  # status of SciPy's minimisers after StopIteration in the callback


class Optimum(NamedTuple):
    """The result of a maximisation."""

    theta: np.ndarray
    value: float
    n_iter: int
    remaining: float  # expected rise of the likelihood in as many iterations again [nats]
    converged: bool  # stopped because the likelihood no longer rose
    earlier: np.ndarray | None = None  # best point some evaluations before the end
    n_since: int = 0  # number of evaluations since then


class _Loss:
    """The negative log likelihood for a minimiser; it keeps the best point and reports progress."""

    def __init__(self, objective: Callable, theta: Vector, stage: str, stop: Event) -> None:
        self.objective = objective
        self.stage = stage
        self.stop = stop
        self.theta = np.array(theta)
        self.value = -np.inf
        self.latest = -np.inf
        self.best_values: list[float] = []  # after each evaluation
        self.best_points: list[Vector] = []

    def __call__(self, theta):
        if self.stop.is_set():
            raise KeyboardInterrupt
        try:
            value, gradient = self.objective(theta)
        except np.linalg.LinAlgError:
            value, gradient = -np.inf, np.zeros_like(theta)
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            # A large finite value, so that the line search turns back.
            value = -1e6
            if np.isfinite(self.value):
                value -= 2 * abs(self.value)
            gradient = np.zeros_like(theta)
        elif value > self.value:
            self.theta = np.array(theta)
            self.value = value
        self.latest = value
        self.best_values.append(self.value)
        self.best_points.append(self.theta)
        notify(self.stage, len(self.best_values), self.value)
        return -value, -gradient

    def rise_per_evaluation(self, n_recent: int) -> float:
        """Return the mean rise of the best value in the last evaluations, infinite if there is only one."""
        recent = [value for value in self.best_values[-n_recent:] if np.isfinite(value)]
        if len(recent) < 2:
            return np.inf
        return (recent[-1] - recent[0]) / (len(recent) - 1)


def maximize(
    objective: Callable,
    theta: Vector,
    bounds: Matrix,
    stop: Event,
    *,
    max_iter: int = 100,
    stage: str = "fit",
    scale: Callable[[Vector], Vector] | None = None,
    settings: OptimizerSettings | None = None,
) -> Optimum:
    """Return the best point of a search that starts at ``theta``.

    Parameters
    ----------
    objective : callable
        theta (n,) -> value and gradient (n,).
    theta : ndarray (n,)
        Starting point.
    bounds : ndarray (n, 2)
    stop : threading.Event
        Stops the search before the next evaluation when it is set. Ctrl-C sets it inside
        ``listening(..., keep_best=True)``.
    max_iter : int
        Zero: the starting point is evaluated.
    stage : str
        Name of the stage for progress listeners.
    scale : callable or None
        theta (n,) -> lengths (n,) over which the value changes by about one. L-BFGS searches in units of
        those at the start, so that its first guess of the curvature is about right. None: ones.
    settings : OptimizerSettings or None

    Returns
    -------
    Optimum
        If ``stop`` is set the best point so far; the caller warns.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C, unless the best so far is kept.
    """
    settings = settings or OptimizerSettings()
    step = settings.grid * np.minimum(np.ptp(bounds, axis=1), settings.widest)
    step[step == 0.0] = 1.0

    def rounded(theta):
        if settings.grid:
            n_steps = np.round((theta - bounds[:, 0]) / step)
            theta = bounds[:, 0] + step * n_steps
        return np.clip(theta, *bounds.T)

    start = rounded(theta)
    loss = _Loss(objective, start, stage, stop)
    end = _End(0, np.inf, False)
    try:
        unit = np.ones(len(start))
        if scale is not None and settings.by_information and max_iter:
            unit = scale(start)
        end = _minimized(loss, start, bounds, unit, rounded, max_iter, settings)
    except KeyboardInterrupt:
        if not keeps_best():
            raise
        stop.set()
    n_since = min(settings.recent, len(loss.best_points)) - 1
    earlier = loss.best_points[-1 - n_since] if n_since > 0 else None
    return Optimum(loss.theta, loss.value, *end, earlier, max(n_since, 0))


class _End(NamedTuple):
    """How a minimisation ended, see `Optimum`."""

    n_iter: int
    remaining: float
    converged: bool


def _minimized(loss, theta, bounds, unit, rounded, max_iter, settings):
    """Return how the minimisation of a loss from ``theta``, in ``unit`` (n,) of each parameter, ended."""
    first_value, first_gradient = loss(theta)
    if max_iter == 0:  # SciPy would make one
        return _End(0, np.inf, False)
    before = loss.latest
    # so that the first step has length one
    nats = float(np.linalg.norm(unit * first_gradient)) or 1.0

    def scaled_loss(z):
        other = rounded(unit * z)
        if np.array_equal(other, theta):
            return first_value / nats, unit * first_gradient / nats
        value, gradient = loss(other)
        return value / nats, unit * gradient / nats

    def end_of_iteration(z):
        nonlocal before
        rise = loss.latest - before
        size = max(1.0, abs(loss.latest), abs(before))
        before = loss.latest
        if rise <= settings.tolerance * size:
            raise StopIteration

    scaled_bounds = bounds / unit[:, None]
    end = minimize(
        scaled_loss,
        theta / unit,
        jac=True,
        method="L-BFGS-B",
        bounds=scaled_bounds,
        callback=end_of_iteration,
        options={
            "maxiter": max_iter,
            "maxfun": 2 * max_iter + 10,
            "maxcor": settings.corrections,
            "ftol": 0.0,
            "gtol": settings.gradient / nats,
        },
    )
    if end.success or end.status == STOPPED:
        return _End(end.nit, 0.0, True)
    extrapolated = max(max_iter, 1) * loss.rise_per_evaluation(settings.recent)
    return _End(end.nit, min(_newton_rise(end, nats, scaled_bounds), extrapolated), False)


def _newton_rise(end: Any, unit: float, bounds: Matrix) -> float:
    """Return g^T H^-1 g / 2 with the gradient g inside the bounds and the H of L-BFGS, half the Newton decrement.

    ``end`` is of a loss in units of ``unit`` nats. Where L-BFGS has seen no curvature, H is one
    nat.
    """
    downhill = -unit * end.jac
    below = (end.x <= bounds[:, 0]) & (downhill < 0)
    above = (end.x >= bounds[:, 1]) & (downhill > 0)
    free = np.where(below | above, 0.0, downhill)
    inverse = LbfgsInvHessProduct(end.hess_inv.sk, unit * end.hess_inv.yk)
    return float(0.5 * free @ inverse(free))

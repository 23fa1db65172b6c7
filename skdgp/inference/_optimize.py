"""Maximisation of the log marginal likelihood by bounded L-BFGS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import LbfgsInvHessProduct, minimize

from skdgp._compute.progress import notify
from skdgp._compute.typing import Vector

RECENT = 10  # evaluations from which the rise of the likelihood is extrapolated
PATIENCE = 5  # iterations over which the held-out error must fall
LEAST_GAIN = 0.01  # by this fraction
GRID = 2.0**-14
"""Spacing of the hyperparameters that a search evaluates, over the width of their bounds.

Far from an optimum, each iteration of L-BFGS multiplies a difference between two searches by about 1.6. So data that
differ by rounding alone, on another processor or of a mirrored flight, would lead to different optima within 60
iterations. On the grid the difference is gone before it grows. The likelihood of 600 values at 234 hyperparameters
changed by at most 0.005 nats in six roundings.
"""
WIDEST = 16.0  # width of bounds that counts
GRADIENT = 1e-4  # [nats] below which a search has converged
STOPPED = 99  # status of SciPy's minimisers after StopIteration in the callback


class Optimum(NamedTuple):
    """The result of a maximisation."""

    theta: np.ndarray
    value: float
    n_iter: int
    n_evaluations: int
    interrupted: bool
    remaining: float  # expected rise of the likelihood in as many iterations again [nats]
    converged: bool  # stopped because the likelihood no longer rose, or the held-out error no longer fell


class _Objective:
    """Negative log likelihood for a minimiser; it keeps the best point and reports progress."""

    def __init__(self, log_likelihood, theta, stage, stop):
        self.log_likelihood, self.stage, self.stop = log_likelihood, stage, stop
        self.theta, self.value, self.latest, self.n_evaluations = np.array(theta), -np.inf, -np.inf, 0
        self.values: list[float] = []

    def __call__(self, theta, eval_gradient=True):
        if self.stop is not None and self.stop.is_set():
            raise KeyboardInterrupt
        try:
            value, gradient = self.log_likelihood(theta)
        except np.linalg.LinAlgError:
            value, gradient = -np.inf, np.zeros_like(theta)
        self.n_evaluations += 1
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            # A large finite value, so that the line search turns back.
            value, gradient = -1e6 - 2 * abs(self.value if np.isfinite(self.value) else 0.0), np.zeros_like(theta)
        elif value > self.value:
            self.theta, self.value = np.array(theta), value
        self.latest = value
        self.values.append(self.value)
        notify(self.stage, self.n_evaluations, self.value)
        return (-value, -gradient) if eval_gradient else -value

    def rise_per_evaluation(self) -> float:
        """Return the mean rise of the best value in the last evaluations, infinite if there is only one."""
        last = [value for value in self.values[-RECENT:] if np.isfinite(value)]
        return (last[-1] - last[0]) / (len(last) - 1) if len(last) > 1 else np.inf


def maximize(
    log_likelihood: Callable,
    theta: Vector,
    bounds: Any,
    *,
    optimizer: Any = "fmin_l_bfgs_b",
    max_iter: int = 100,
    tolerance: Any = 1e-5,
    stage: str = "fit",
    stop: Any = None,
    held_out_error: Any = None,
    grid: float = 0.0,
) -> Optimum:
    """Return the best point of a search that starts at ``theta``.

    Parameters
    ----------
    log_likelihood : callable
        theta (n,) -> value and gradient (n,).
    theta : ndarray (n,)
        Starting point.
    bounds : ndarray (n, 2)
    optimizer : "fmin_l_bfgs_b" or callable
        A callable has scikit-learn's signature: (obj_func, initial_theta, bounds) -> theta, minimum.
    max_iter : int
    tolerance : float
        Stop when one iteration raises the likelihood by less than this fraction.
    stage : str
        Name of the stage for progress listeners.
    stop : threading.Event or None
        Stops the search before the next evaluation when it is set. Ctrl-C sets it.
    held_out_error : callable or None
        theta (n,) -> error at data that ``log_likelihood`` does not know. The search stops when it has not fallen by
        1 % over 5 iterations. It is not called for an ``optimizer`` of the user.
    grid : float
        Spacing of the points that are evaluated, over the width of the bounds, see ``GRID``. Zero: any points.

    Returns
    -------
    Optimum
        After Ctrl-C the best point so far, with ``interrupted``; the caller warns.
    """
    step = grid * np.minimum(np.ptp(bounds, axis=1), WIDEST)
    step[step == 0.0] = 1.0

    def rounded(theta):
        nearest = step * np.round(theta / step) if grid else theta
        return np.clip(nearest, bounds[:, 0], bounds[:, 1])

    theta = rounded(theta)
    if stop is not None and stop.is_set():
        return Optimum(theta, -np.inf, 0, 0, True, np.inf, False)
    objective = _Objective(log_likelihood, theta, stage, stop)
    n_iter, interrupted, remaining, converged = 0, False, np.inf, False
    errors: list[float] = []
    before = -np.inf

    def watch(theta):
        nonlocal before
        rise, before = objective.latest - before, objective.latest
        if rise <= tolerance * max(1.0, abs(before), abs(before - rise)):
            raise StopIteration
        if held_out_error is None:
            return
        errors.append(held_out_error(rounded(theta)))
        if len(errors) > PATIENCE and min(errors[-PATIENCE:]) > (1 - LEAST_GAIN) * min(errors[:-PATIENCE]):
            raise StopIteration

    try:
        if callable(optimizer):
            optimizer(objective, theta, bounds)
            remaining, converged = 0.0, True  # an optimiser of the user has its own stopping rule
        else:
            first = objective(theta)
            before = objective.latest
            unit = float(np.linalg.norm(first[1])) or 1.0  # so that the first step has length one

            def loss(other):
                other = rounded(other)
                value, gradient = first if np.array_equal(other, theta) else objective(other)
                return value / unit, gradient / unit

            options: Any = {"maxiter": max_iter, "maxfun": 2 * max_iter + 10, "maxcor": 20, "ftol": 0.0}
            options["gtol"] = GRADIENT / unit
            end = minimize(loss, theta, jac=True, method="L-BFGS-B", bounds=bounds, options=options, callback=watch)
            n_iter, converged = end.nit, bool(end.success) or end.status == STOPPED
            remaining = 0.0
            if not converged:
                remaining = min(_newton_rise(end, unit, bounds), max(max_iter, 1) * objective.rise_per_evaluation())
    except KeyboardInterrupt:
        interrupted = True
        if stop is not None:
            stop.set()
    return Optimum(objective.theta, objective.value, n_iter, objective.n_evaluations, interrupted, remaining, converged)


def _newton_rise(end: Any, unit: float, bounds: Any) -> float:
    """Return g^T H^-1 g / 2 with the gradient g inside the bounds and the H of L-BFGS, half the Newton decrement.

    ``end`` is of a loss in units of ``unit`` nats. Where L-BFGS has seen no curvature, H is one nat.
    """
    downhill = -unit * end.jac
    blocked = ((end.x <= bounds[:, 0]) & (downhill < 0)) | ((end.x >= bounds[:, 1]) & (downhill > 0))
    free = np.where(blocked, 0.0, downhill)
    return float(0.5 * free @ LbfgsInvHessProduct(end.hess_inv.sk, unit * end.hess_inv.yk)(free))

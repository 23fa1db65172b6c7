"""Servos: delay, first-order lag and rate limit between commands and deflections of the control surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.typing import Array

Deflections = Mapping[str, Any]
# Durations that are equal but for rounding [s]
ROUNDING = 1e-9
# Lag of the fastest servos [s]; guess
LEAST_LAG = 0.01


class Ramp(NamedTuple):
    """Commands of the surfaces that change linearly over a duration."""

    duration: float  #: [s]
    first: Deflections
    last: Deflections

    def cut(self, duration: float) -> tuple[Ramp, Ramp]:
        """Return the commands before and after a ``duration`` [s], which is shorter."""
        fraction = duration / self.duration
        between = {}
        for name, first in self.first.items():
            between[name] = first + fraction * (self.last[name] - first)
        before = Ramp(duration, self.first, between)
        return before, Ramp(self.duration - duration, between, self.last)


class ServoState(NamedTuple):
    """Deflections of the surfaces, and the commands that wait for the end of the delay, oldest first."""

    deflections: Deflections
    waiting: tuple[Ramp, ...] = ()


@dataclass(frozen=True)
class Servos:
    r"""Servos of the control surfaces, from the commands that are logged to the deflections.

    .. math:: T \dot\delta(t) = c(t - \tau) - \delta(t), \quad |\dot\delta| \le R

    Parameters
    ----------
    lag : float, default=0.0
        Time constant T [s].
    delay : float, default=0.0
        :math:`\tau` [s], with half of the time for which the autopilot holds a command.
    rate_limit : float, default=inf
        R, in the unit of the surfaces per second, [rad/s].
    lag_std, delay_std : float, default=0.0
        Standard deviations [s]. A longer lag looks like a longer delay, so the errors are opposite.

    Examples
    --------
    >>> from skdgp.dynamics import Servos
    >>> Servos(lag=0.04, delay=0.03)
    Servos(lag=0.04, delay=0.03, rate_limit=inf, lag_std=0.0, delay_std=0.0)
    """

    lag: float = 0.0
    delay: float = 0.0
    rate_limit: float = np.inf
    lag_std: float = 0.0
    delay_std: float = 0.0

    @property
    def are_ideal(self) -> bool:
        """Whether deflections are the commands."""
        return self == IDEAL

    @property
    def settling_time(self) -> float:
        """Time [s] after which less than a hundredth is left of an unknown deflection."""
        return self.delay + float(np.log(100)) * self.lag

    @property
    def words(self) -> str:
        """Lag, delay and, if there is one, rate limit as text."""
        lag, lag_std, delay, delay_std = (
            f"{1e3 * seconds:.0f}"
            for seconds in (self.lag, self.lag_std, self.delay, self.delay_std)
        )
        text = f"lag {lag} ± {lag_std} ms, delay {delay} ± {delay_std} ms"
        if np.isfinite(self.rate_limit):
            text += f", at most {self.rate_limit:.2g} rad/s"
        return text

    def completed(self, others: Servos) -> Servos:
        """Return these servos with what only ``others`` have, such as a lag."""
        lag = self if self.lag else others
        delay = self if self.delay else others
        limit = min(self.rate_limit, others.rate_limit)
        return Servos(lag.lag, delay.delay, limit, lag.lag_std, delay.delay_std)

    def drawn(self, n_paths: int, random_state: Any) -> tuple[Array, Array]:
        """Return lags and delays (n_paths,) [s] with their errors, which are opposite.

        A lag is drawn above 10 ms, or above itself where it is shorter; servos without a lag have none.
        """
        errors = np.random.default_rng(random_state).standard_normal(n_paths)
        lags = np.zeros(n_paths)
        if self.lag > 0.0:
            fastest = min(self.lag, LEAST_LAG)
            # reflected there: what a lag cannot be shorter it may be longer
            lags = fastest + np.abs(self.lag + errors * self.lag_std - fastest)
            if self.lag_std > 0:
                errors = (lags - self.lag) / self.lag_std
        return lags, np.maximum(self.delay - errors * self.delay_std, 0.0)

    def at_rest(self, commands: Deflections) -> ServoState:
        """Return the state of servos that have had these ``commands`` for long."""
        waiting = (Ramp(self.delay, commands, commands),) if self.delay > 0 else ()
        return ServoState(commands, waiting)

    def moved(self, state: ServoState, commands: Ramp) -> ServoState:
        """Return the state after the duration of further ``commands``."""
        waiting = [*state.waiting, commands]
        left = commands.duration
        deflections = None
        while deflections is None or left > ROUNDING:
            ramp = waiting.pop(0)
            if ramp.duration > left + ROUNDING:
                ramp, rest = ramp.cut(left)
                waiting.insert(0, rest)
            deflections = self._response(deflections or state.deflections, ramp)
            left -= ramp.duration
        return ServoState(deflections, tuple(waiting) if self.delay > 0 else ())

    def _response(self, begun: Deflections, ramp: Ramp) -> dict[str, Array]:
        """Return the deflections behind a ramp of delayed commands, by those at its beginning."""
        kept, of_first, of_last = ramp_weights(self.lag, ramp.duration)
        reach = self.rate_limit * ramp.duration
        deflections = {}
        for name, first in ramp.first.items():
            wanted = kept * begun[name] + of_first * first + of_last * ramp.last[name]
            deflections[name] = limited_change(begun[name], wanted, reach)
        return deflections


def ramp_weights(lag: float, duration: float) -> tuple[float, float, float]:
    r"""Return the weights of deflection and command at the beginning of a ramp, and of the command at its end.

    The deflection there is, for commands that change linearly over a duration t,

    .. math:: \delta(t) = e^{-t / T} \delta_0 + (m - e^{-t / T}) \, c_0 + (1 - m) \, c(t), \quad
              m = \frac{T}{t} (1 - e^{-t / T}).
    """
    if lag <= 0:
        return 0.0, 0.0, 1.0
    if duration <= 0:
        return 1.0, 0.0, 0.0
    kept = float(np.exp(-duration / lag))
    mean = (1 - kept) * lag / duration
    return kept, mean - kept, 1 - mean


def limited_change(begun: Any, wanted: Any, reach: float) -> Any:
    """Return the deflections that are wanted, by which they change by at most ``reach``."""
    return np.clip(wanted, begun - reach, begun + reach) if np.isfinite(reach) else wanted


IDEAL = Servos()

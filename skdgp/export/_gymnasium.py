"""A learned aircraft as an environment of Gymnasium, for reinforcement learning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.checks import check_names
from skdgp._mechanics.air import CEILING
from skdgp._mechanics.loads import Thrust
from skdgp._mechanics.motion import DEFLECTION
from skdgp.dynamics import Aircraft, Simulator, Trim, as_aerodynamics, dryden_wind
from skdgp.export._text import extra

OBSERVED = ("airspeed", "alpha", "beta", "phi", "theta", "psi", "p", "q", "r", "altitude")
TRACKED = {"airspeed": 2.0, "altitude": 5.0, "phi": 0.1}
"""Errors [m/s, m, rad] at which a term of the reward is one half."""
SIDESLIP, RATE = np.pi / 6, 2 * np.pi
"""Limits of beta [rad] of a model that does not know it, and of p, q and r [rad/s]."""


def gymnasium_env(
    model: Any,
    aircraft: Aircraft,
    start: Trim,
    *,
    posterior: bool = True,
    duration: float = 20.0,
    dt: float = 0.02,
    wind_at_6m: float = 0.0,
    initial_std: Mapping[str, float] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    reward: Callable[[dict[str, Any], dict[str, float]], float] | None = None,
    thrust: Thrust = "auto",
) -> Any:
    r"""Return a ``gymnasium.Env`` that flies a learned aircraft from a trim.

    An observation is (airspeed [m/s], alpha, beta, phi, theta, psi [rad], p, q, r [rad/s], altitude
    [m]). An action holds ``start.solved`` controls, in their units and order: elevator, aileron,
    rudder [rad, or parts of the full throw], and thrust [N], throttle or propeller_speed [rad/s];
    the others stay as in the trim. A step holds them for ``dt``. An episode terminates when an
    observation leaves ``observation_space``, to which the last one is clipped, or the flight
    diverges; it is truncated after ``duration``. ``step`` raises ``gymnasium.error.ResetNeeded``
    before the first reset, ValueError for an action of another shape or NaN. Raises ImportError if
    Gymnasium is not installed; ValueError if the trim is not within the limits, a name is unknown,
    or ``duration`` is too short.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        As for :func:`skdgp.dynamics.simulate`.
    aircraft : Aircraft
    start : Trim
        From :func:`skdgp.dynamics.trim`; every episode begins there, and the default reward asks to
        stay.
    posterior : bool, default=True
        Whether each reset draws another aircraft, a function of the posterior. False: the mean of
        the model.
    duration, dt : float
        Of an episode and of a step [s].
    wind_at_6m : float, default=0.0
        [m/s]; each reset draws the gusts of :func:`skdgp.dynamics.dryden_wind`. 0: the air is at
        rest.
    initial_std : mapping of str to float, optional
        Standard deviations of the start, of observations by name.
    limits : mapping of str to pair of float, optional
        Of observations and controls by name. Default: alpha, beta and surfaces as the model was
        learned from, airspeed half to twice the dynamic pressure of the trim, altitude 0 to twice
        that of the trim, p, q, r one turn a second, throttle 0 to 1, and thrust at most twice that
        of the trim.
    reward : callable, optional
        (seen, controls) to float after each step. ``seen`` holds every channel of the state by
        name, and ``ended``, why the episode terminated, or "". By default, with the trim
        :math:`x_0`,

        .. math:: r = \frac{1}{3} \sum_k \frac{1}{1 + (x_k - x_{0,k})^2 / s_k^2}

        of airspeed, altitude and phi with s = 2 m/s, 5 m, 0.1 rad.
    thrust
        As for :func:`skdgp.dynamics.simulate`.

    Returns
    -------
    gymnasium.Env
        Its ``info`` is ``seen``, with ``beyond``: the regressor farthest outside of what the model
        was learned from, or "". That of a reset has ``random_state``, with which `simulate` draws
        the same aircraft.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, trim
    >>> from skdgp.export import gymnasium_env
    >>> def linear(X):
    ...     alpha, beta, p, q, r, elevator, aileron, rudder = X.T
    ...     lift = 0.3 + 4.5 * alpha
    ...     return np.stack([-0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift,
    ...                      -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
    ...                      0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder], axis=-1)
    >>> names = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> model = Aerodynamics(linear, names)
    >>> steady = trim(model, aircraft, 20.0, altitude=100.0)
    >>> env = gymnasium_env(model, aircraft, steady, posterior=False)
    >>> observation, info = env.reset(seed=0)
    >>> action = [steady.controls[name] for name in ("elevator", "aileron", "rudder", "thrust")]
    >>> observation, reward, terminated, truncated, info = env.step(action)
    >>> round(reward, 6), terminated, truncated
    (1.0, False, False)
    """
    Env: Any = extra("gymnasium").Env

    class AircraftEnv(_Episodes, Env):
        metadata: dict[str, Any] = {"render_modes": []}

    return AircraftEnv(
        model,
        aircraft,
        start,
        posterior,
        duration,
        dt,
        wind_at_6m,
        initial_std,
        limits,
        reward,
        thrust,
    )


class _Episodes:
    """The methods of the environment, to be joined with ``gymnasium.Env``."""

    def __init__(
        self,
        model,
        aircraft,
        start,
        posterior,
        duration,
        dt,
        wind_at_6m,
        initial_std,
        limits,
        reward,
        thrust,
    ) -> None:
        if not (np.isfinite(duration) and duration >= dt):
            raise ValueError(
                f"Got duration={duration!r}, but expected at least one step of {dt:g} s."
            )
        self.model, self.aircraft, self.posterior, self.thrust = (
            as_aerodynamics(model),
            aircraft,
            posterior,
            thrust,
        )
        self.duration, self.dt, self.wind_at_6m = duration, dt, wind_at_6m
        rates = dict(zip("pqr", start.rates, strict=True))
        self.trim = {name: float(rates.get(name, getattr(start, name, 0.0))) for name in OBSERVED}
        self.held, self.controls = (
            start.controls,
            tuple(name for name in start.solved if name in start.controls),
        )
        self.initial_std, self.reward = dict(initial_std or {}), reward or self._tracking
        check_names(self.initial_std, OBSERVED, "observations")
        check_names(
            limits or {}, (*OBSERVED, *self.controls), "observations and controls of this aircraft"
        )
        self.limits = self._limits() | dict(limits or {})
        self.observation_space, self.action_space = self._box(OBSERVED), self._box(self.controls)
        self.simulator: Any = None
        begin = self.trim | self.held
        outside = {
            n: (begin[n], *pair)
            for n, pair in self.limits.items()
            if not pair[0] < begin[n] < pair[1]
        }
        if outside:
            raise ValueError(
                f"Got a trim that is not within its limits, (value, smallest, largest) {outside}: "
                f"choose another trim, "
                "such as trim(..., altitude=100.0) above the ground, or give limits={name: "
                "(smallest, largest)}."
            )

    def _limits(self) -> dict[str, tuple[float, float]]:
        start, half, turn = self.trim, np.sqrt(0.5), np.pi
        found = {
            "airspeed": (half * start["airspeed"], start["airspeed"] / half),
            "alpha": (-turn / 6, turn / 4), "beta": (-SIDESLIP, SIDESLIP),
            "phi": (-turn, turn), "theta": (-turn / 2, turn / 2), "psi": (-turn, turn),
            "p": (-RATE, RATE), "q": (-RATE, RATE), "r": (-RATE, RATE),
            "altitude": (0.0, 2 * start["altitude"]),
        }  # fmt: skip
        engine = {"throttle": (0.0, 1.0)} | {
            n: (0.0, 2 * self.held.get(n, 0.0)) for n in ("thrust", "propeller_speed")
        }
        found |= {name: engine.get(name, (-DEFLECTION, DEFLECTION)) for name in self.controls}
        if self.model.limits is not None:
            flown = zip(self.model.regressors, self.model.limits.T.tolist(), strict=True)
            surfaces = set(self.controls) - set(engine)
            found |= {
                name: (low, high)
                for name, (low, high) in flown
                if name in {"alpha", "beta"} | surfaces
            }
        return found

    def _box(self, names: tuple[str, ...]) -> Any:
        """Return the space of the smallest to the largest values."""
        low, high = np.array([self.limits[name] for name in names], dtype=float).T
        return extra("gymnasium").spaces.Box(low, high, dtype=np.float64)

    def reset(
        self, *, seed: int | None = None, options: Any = None
    ) -> tuple[Array, dict[str, Any]]:
        """Return the first observation and info of an episode."""
        super().reset(seed=seed)  # type: ignore[misc]
        rng: np.random.Generator = self.np_random  # type: ignore[attr-defined]
        path, gusts = rng.integers(2**31 - 1, size=2).tolist()
        random_state = path if self.posterior else None
        off = rng.standard_normal(len(OBSERVED)) * [
            self.initial_std.get(name, 0.0) for name in OBSERVED
        ]
        begin = self._clipped(np.add(list(self.trim.values()), off))
        wind = self._gusts(gusts) if self.wind_at_6m else None
        self.simulator = Simulator(self.model, self.aircraft, self.dt, air=wind, thrust=self.thrust)
        named = dict(zip(OBSERVED, begin.tolist(), strict=True))
        observation, info = self._seen(
            self.simulator.reset(named, random_state=random_state) | {"beyond": ""}
        )
        return observation, info | {"random_state": random_state}

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Return what a step of Gymnasium returns; raise ValueError if the action is not a number for each control."""
        if self.simulator is None:
            raise extra("gymnasium").error.ResetNeeded(
                "Got a step before an episode: call reset() first."
            )
        asked = np.asarray(action, dtype=float)
        if asked.shape != (len(self.controls),) or np.isnan(asked).any():
            raise ValueError(
                f"Got the action {action!r}, but expected a number for each of "
                f"{', '.join(self.controls)}."
            )
        asked = np.clip(asked, self.action_space.low, self.action_space.high).tolist()
        controls = self.held | dict(zip(self.controls, asked, strict=True))
        seen: dict[str, Any] = self.simulator.step(controls)
        if self.simulator.ended:
            seen = {name: self.last.get(name, value) for name, value in seen.items()} | {
                "time": seen["time"]
            }
        observation, info = self._seen(seen | {"beyond": self.simulator.beyond})
        over = bool(info["time"] > self.duration - 0.5 * self.dt)
        return (
            observation,
            float(self.reward(info, controls)),
            bool(info["ended"]),
            over,
            dict(info),
        )

    def _seen(self, seen: dict[str, Any]) -> tuple[Array, dict[str, Any]]:
        """Return the observation, and what is seen with the reason why the episode ended."""
        values = np.array([seen[name] for name in OBSERVED])
        clipped = self._clipped(values)
        left = [name for name, out in zip(OBSERVED, values != clipped, strict=True) if out]
        seen["ended"] = self.simulator.ended or (left[0] if left else "")
        self.last = seen
        return clipped, dict(seen)

    def _clipped(self, observation: Array) -> Array:
        return np.clip(observation, self.observation_space.low, self.observation_space.high)

    def _gusts(self, seed: int) -> Callable:
        """Return the wind of an episode as a function of time and position."""
        table = dryden_wind(
            self.duration + self.dt, self.trim["airspeed"], min(self.trim["altitude"], CEILING),
            wind_at_6m=self.wind_at_6m, span=self.aircraft.span, random_state=seed,
        )  # fmt: skip
        time, *columns = table.to_numpy().T.copy()
        return lambda t, position: np.array([np.interp(t, time, column) for column in columns])

    def _tracking(self, seen: dict[str, Any], controls: dict[str, float]) -> float:
        return float(
            np.mean([1 / (1 + ((seen[n] - self.trim[n]) / s) ** 2) for n, s in TRACKED.items()])
        )

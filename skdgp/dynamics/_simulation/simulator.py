"""Step-by-step simulation, for controllers and reinforcement learning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skdgp._compute.typing import Array, Seed
from skdgp.dynamics._air.air import as_air
from skdgp.dynamics._air.turbulence import Turbulence
from skdgp.dynamics._equations.motion import Motion
from skdgp.dynamics._equations.rigid_body import rk4_step
from skdgp.dynamics._simulation.inputs import as_starts, initial_states, perturbed
from skdgp.dynamics._simulation.simulate import FLYING, end_reasons
from skdgp.dynamics._simulation.trajectory import beyond, channels
from skdgp.dynamics._simulation.wind import wind_field
from skdgp.dynamics._vehicle.aircraft import Aircraft
from skdgp.dynamics._vehicle.loads import Thrust


class Simulator:
    """Step-by-step simulation of an aircraft with a controller: call ``reset``, then ``step`` repeatedly.

    Each step holds the controls for ``dt`` and integrates the equations of `simulate` (RK4). Several starts are
    simulated as one batch.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    dt : float, default=0.02
        Time step [s].
    air, thrust
        As for :func:`skdgp.dynamics.simulate`; the wind is constant or a function, no gusts are drawn besides it.

    Attributes
    ----------
    ended : str or ndarray of str
        Why the flight, or each, is over; "" while it is not.
    beyond : str or ndarray of str
        After a step: the regressor that is farthest outside of what the model was learned from, or "".

    Examples
    --------
    A controller that holds the bank angle:

    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, Simulator
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> def coefficients(X):
    ...     alpha, beta, p, q, r, aileron = X.T
    ...     Cl = -0.05 * beta - 0.4 * p + 0.1 * aileron
    ...     return np.stack([-0.02 + 2 * alpha**2, -0.4 * beta, -0.2 - 4.5 * alpha, Cl,
    ...                      0.02 - 0.4 * alpha - 8 * q, 0.08 * beta - 0.1 * r], axis=-1)
    >>> model = Aerodynamics(coefficients, ["alpha", "beta", "p_hat", "q_hat", "r_hat", "aileron"])
    >>> simulator = Simulator(model, glider, thrust=None)
    >>> seen = simulator.reset({"airspeed": 12.0, "alpha": 0.05, "phi": 0.0, "altitude": 100.0})
    >>> for _ in range(150):
    ...     seen = simulator.step({"aileron": 1.5 * (0.4 - seen["phi"]) - 0.3 * seen["p"]})
    >>> round(float(seen["time"]), 2), bool(abs(seen["phi"] - 0.4) < 0.05)
    (3.0, True)
    """

    def __init__(
        self, model: Any, aircraft: Aircraft, dt: float = 0.02, *, air: Any = None, thrust: Thrust = "auto"
    ) -> None:
        if not (np.isfinite(dt) and dt > 0):
            raise ValueError(f"Got dt={dt!r}, but expected a time step > 0 [s].")
        air = as_air(air)
        if isinstance(air.gusts, Turbulence):
            raise ValueError("Got a Turbulence, but a Simulator draws no gusts: give a wind, as a function.")
        self.motion = Motion(model, aircraft, thrust=thrust, air=air)
        self.dt, self._steps, self._mean, self._air = float(dt), 0, self.motion.aerodynamics, wind_field(air.wind)
        self.ended: Any = FLYING
        self.beyond: Any = ""
        self._state: Any = None

    @property
    def time(self) -> float:
        """Since the reset [s]."""
        return self._steps * self.dt

    @property
    def state(self) -> Array:
        """The state (13,), or states (n, 13), see `STATE_NAMES`; NaN where a flight has ended."""
        if self._state is None:
            raise ValueError("Got no start yet: call reset(x0) first.")
        shown = np.where((self._ended == FLYING)[..., None], self._state, np.nan)
        return shown.reshape(-1, 13)[0] if self._single else shown

    def reset(
        self, x0: Any, *, random_state: Seed = None, initial_std: Mapping[str, float] | None = None
    ) -> dict[str, Any]:
        """Begin a flight, or several, and return ``time``, position, velocities, angles, rates, air data, altitude.

        ``x0`` and ``initial_std`` are as for :func:`skdgp.dynamics.simulate`. Without a ``random_state`` the mean of
        the model flies, else functions drawn from its posterior, one for each start.
        """
        starts = as_starts(x0)
        states = initial_states(starts, lambda at: self._air(0.0, at))
        states = perturbed(states, initial_std, 1, random_state)[0]
        single, mean_flies = len(states) == 1, random_state is None
        drawn = None if mean_flies else self._mean.sample(len(states), random_state, correlated=True)
        self.motion.aerodynamics = drawn or self._mean
        self._state = states[0] if single and mean_flies else states
        self._single, self._start, self._steps = single, self._state, 0
        self._ended = np.full(self._state.shape[:-1], FLYING, dtype=object)
        self._implicit: Any = None
        self.beyond = "" if single else np.full(len(states), "", dtype=object)
        return self._seen()

    def step(self, controls: Mapping) -> dict[str, Any]:
        """Return what is seen after a step with controls by name; raises ValueError before `reset` or after the end."""
        if self._state is None or not (self._ended == FLYING).any():
            what = "no start yet" if self._state is None else f"a flight that has ended ({self.ended})"
            raise ValueError(f"Got {what}, but expected one that flies: call reset(x0).")
        controls = self.motion.mixed(controls)

        def at(t, state):
            now = self.motion.at(state, controls, self._air(t, state), self._implicit)
            self._implicit = now.implicit
            return now

        with np.errstate(all="ignore"):  # what diverges is ended
            state = rk4_step(lambda t, x: at(t, x).derivative, self.time, self._state, self.dt)
            self._steps += 1
            now = at(self.time, state)
            for reason, where in end_reasons(state, now).items():
                self._ended[np.broadcast_to(where, self._ended.shape) & (self._ended == FLYING)] = reason
        names = np.array(["", *self.motion.regressors], dtype=object)[beyond(self.motion, now.regressors)]
        self.beyond = str(np.reshape(names, -1)[0]) if self._single else names
        flying = self._ended == FLYING
        self._state = state if flying.all() else np.where(flying[..., None], state, self._start)
        return self._seen()

    def _seen(self) -> dict[str, Any]:
        air = self._air(self.time, self._state)
        seen: dict[str, Any] = {"time": self.time} | channels(self._state, None if air is None else air.wind)
        over = self._ended != FLYING
        if over.any():
            seen = {name: np.where(over, np.nan, value) if name != "time" else value for name, value in seen.items()}
        if not self._single:
            self.ended = self._ended.copy()
            return seen
        self.ended = str(self._ended.reshape(-1)[0])
        return {name: float(np.reshape(value, -1)[0]) for name, value in seen.items()}

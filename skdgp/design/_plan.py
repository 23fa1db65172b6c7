"""The next flight: manoeuvres that teach most about a goal, and stay in an envelope."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Literal, NamedTuple, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state

from skdgp._compute.progress import notify
from skdgp._compute.threads import one_blas_thread
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp._flight.channels import HAT
from skdgp._flight.checks import check_names
from skdgp.design._bands import input_bands
from skdgp.design._envelope import (
    GROWTH,
    OPTIONS,
    QUANTITIES,
    Envelope,
    flown_quantities,
    option_of,
    quantities,
    with_band,
)
from skdgp.design._goals import WHOLE, check_goal, goal_weights, weighted_error
from skdgp.design._information import (
    Information,
    coefficient_noise,
    expected_information,
    noise_table,
    posterior_information,
    regressors_of,
)
from skdgp.design._multisines import orthogonal_multisines
from skdgp.design._signals import ROUNDING, Limits, Signal, Steps, doublet, three_two_one_one
from skdgp.design._wavetrain import Wavetrain, wavetrain
from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    SimulationWarning,
    Trim,
    Turbulence,
    as_aerodynamics,
    linearize,
    simulate,
    trim,
)

STEP = 0.04
"""Of simulations, and between the rows that count as independent measurements [s]."""
WIDTHS = (1.0, 2.5)
"""Of pulses, in units of the suggested width."""
MULTISINES = (5.0, 10.0)
"""Durations [s]."""
TICK = 0.5
"""Of the steps of a pilot [s]."""
MOST_TONES = 8
STARTS = 2
"""Searches for the phases of a multisine."""
SPREAD = 1.5
"""Standard deviations, by gusts and posterior, that are left to the envelope where a scale is predicted."""
ENTRY = {"phi": 0.035, "theta": 0.035}
"""Standard deviations of the angles from trim in which a manoeuvre begins [rad]."""
ENTRY_SPEED, ENTRY_CONTROLS = 0.02, 0.02
"""The same of the airspeed, relative to it, and of the controls that are held, relative to their limits."""
ENTRIES = 12
"""Number of aircraft and entries drawn, over which the information of a manoeuvre is averaged."""
SHRINK, LEAST = 0.85, 0.2
"""Factor by which a manoeuvre is made smaller until it is safe, and the least scale."""
VAGUE = 1e-8
"""Information that is assumed of everything, relative to the largest of a manoeuvre: its errors are finite."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Flights that `plan` has chosen, and what they will teach; `skdgp.report.write_flight_card` draws them.

    Parameters
    ----------
    trains : tuple of Wavetrain
        The inputs, a wavetrain for each trim that is flown.
    trims : tuple of Trim
        Where each wavetrain begins, and to which the aircraft is returned before each manoeuvre.
    goal : tuple of str
        Names of derivatives, such as ``Cm_q``, "function", "free-flight".
    before, after : Information
        About the derivatives, without and with the plan.
    manoeuvres : DataFrame
        In the order of flight: ``train`` (number of its wavetrain), ``airspeed`` [m/s] of its trim, ``start`` [s],
        ``name``, ``duration`` [s], ``scale`` (its amplitude relative to the limits), ``risk`` (predicted probability of
        leaving the envelope; NaN of a model without posterior), ``gain`` (by which part it reduces the errors of the
        goal, on geometric average) and ``gain_per_second`` (of the logarithm of these errors).
    alone : DataFrame
        What each manoeuvre of the library would teach if it were repeated for the whole time: ``name``, ``scale``,
        ``risk`` (NaN: not simulated), ``gain``.
    flight : DataFrame
        Expected: the mean of the model, from its trim for each manoeuvre; ``flight`` numbers them. Of a model with a
        posterior also what holds 95 % of the aircraft drawn: ``alpha_low``, ``alpha_high`` and so on for beta,
        load_factor, bank, airspeed and altitude.
    parts : tuple of Information
        Of each manoeuvre, with ``curvature`` the mean over aircraft and entries that are drawn; ``after`` is ``before``
        and their sum.
    limits : DataFrame
        ``low`` and ``high`` of what no manoeuvre may leave: see :meth:`Envelope.bounds`.
    aircraft : Aircraft
    weights : dict of str to ndarray (P, 1 + d, 1 + d)
        Of covariances, for the goals "function" and "free-flight".
    """

    trains: tuple[Wavetrain, ...]
    trims: tuple[Trim, ...]
    goal: tuple[str, ...]
    before: Information
    after: Information
    manoeuvres: pd.DataFrame
    alone: pd.DataFrame
    flight: pd.DataFrame
    parts: tuple[Information, ...]
    limits: pd.DataFrame
    aircraft: Aircraft
    weights: Mapping[str, Array] = field(default_factory=dict)

    @property
    def errors(self) -> pd.DataFrame:
        """Standard errors of the goal ``before`` and ``after`` the flight; before is inf where nothing is known."""
        columns = {name: errors_of(getattr(self, name), self.weights) for name in ("before", "after")}
        return pd.DataFrame({name: errors[list(self.goal)] for name, errors in columns.items()})

    def inputs(self, k: int) -> dict[str, Signal]:
        """Return the inputs of a row of ``manoeuvres`` by axis."""
        row = self.manoeuvres.iloc[k]
        events = self.trains[int(row["train"])].events()
        return {axis: signal for axis, start, signal in events if np.isclose(start, row["start"])}

    def expected(self, rows: Sequence[int]) -> pd.DataFrame:
        """Return the ``low`` and ``high`` ends that some rows of ``manoeuvres`` are expected to reach."""
        flight = self.flight[self.flight["flight"].isin(list(rows))]
        values = quantities(flight)
        ends = [
            (flight.get(f"{name}_low", values[name]).min(), flight.get(f"{name}_high", values[name]).max())
            for name in QUANTITIES
        ]
        return pd.DataFrame(ends, index=list(QUANTITIES), columns=["low", "high"])

    def to_dict(self) -> dict[str, Any]:
        """Return what a check after the flight needs, as plain values; inputs in steps of 0.04 s."""
        names = ("airspeed", "altitude", "climb", "alpha", "beta", "phi", "theta", "controls")
        rows = []
        for k, row in enumerate(self.manoeuvres.to_dict("records")):
            time = np.arange(0.0, row["duration"] + STEP, STEP)
            inputs = {axis: signal(time).round(6).tolist() for axis, signal in self.inputs(k).items()}
            rows.append(row | {"inputs": inputs, "expected": self.expected([k]).to_dict("index")})
        trims = [self.trims[int(at)].controls for at in self.manoeuvres["train"]]
        starts = [
            regressors_of(one.assign(**trims[k]), self.aircraft, self.before.regressors)[0]
            for k, (_, one) in enumerate(self.flight.groupby("flight"))
        ]
        return {
            "curvature": self.after.fisher.shape[1] > 1 + len(self.before.regressors),
            "aircraft": self.aircraft.to_dict(),
            "trims": [{name: getattr(one, name) for name in names} for one in self.trims],
            "at": dict(zip(self.before.regressors, np.mean(starts, axis=0).tolist(), strict=True)),
            "pause": float(self.manoeuvres["start"].iloc[0]),
            "manoeuvres": rows,
            "limits": self.limits.to_dict("index"),
            "errors": self.errors.to_dict("index"),
            "confounded": self.confounded.to_dict("records"),
            "weights": {name: value.tolist() for name, value in self.weights.items()},
            "known": {name: np.asarray(value).tolist() for name, value in vars(self.before).items()},
        }

    @property
    def confounded(self) -> pd.DataFrame:
        """Pairs with a derivative of the goal that are still not told apart: see :meth:`Information.confounded`."""
        pairs = self.after.confounded()
        names = pairs[["first", "second"]].apply(lambda one: pairs["coefficient"] + "_" + one.str.removesuffix(HAT))
        return pairs[names.isin(self.goal).any(axis=1)].reset_index(drop=True)


def plan(
    model: Any,
    aircraft: Aircraft,
    *,
    airspeeds: ArrayLike,
    seconds: float,
    axes: Sequence[str],
    goal: Sequence[str] | None = None,
    limits: Mapping[str, Limits | float] | None = None,
    envelope: Envelope | None = None,
    altitude: float | None = None,
    banks: Sequence[float] = (0.0,),
    gusts: Turbulence | Literal["as flown"] | None = "as flown",
    known: Information | None = None,
    noise: pd.DataFrame | Mapping[str, float] | None = None,
    bands: pd.DataFrame | None = None,
    curvature: bool = False,
    pause: float = 3.0,
    rate: float = 50.0,
    n_paths: int = 60,
    thrust: Any = "auto",
    detents: Mapping[str, float] | None = None,
    random_state: Seed = 0,
) -> Plan:
    r"""Return the flight that teaches most about a goal in a given time, inside an envelope.

    The library holds doublets, 3-2-1-1s and multisines, whose times and bands are those of the modes (`input_bands`).
    Each is simulated from a trim with the mean of the model. Its information (`expected_information`) adds to what is
    known. Manoeuvres are chosen one by one for the largest reduction per second of the mean logarithm of the errors of
    the goal; then each is exchanged while that helps.

    Each chosen manoeuvre is flown by aircraft drawn from the posterior, each in gusts of its own, from an entry beside
    the trim (standard deviations: bank and pitch 2 degrees, airspeed 2 %, held controls 2 % of their limits). The
    response of the mean counts the ``margin`` of the envelope more: slopes learned in gusts err by more than the
    posterior says. If K of N leave the envelope, the predicted risk is (K + 1) / (N + 2) (Laplace's rule of
    succession). A manoeuvre is as large as limits and allowed risk let it be, or left out, and the choice is made
    again. Controls are open loop during a manoeuvre; the pilot or the autopilot returns to the trim in the pause after
    it.

    Ctrl-C ends the search with the best of what has been checked. :func:`skdgp.listening` shows the progress.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        As for :func:`skdgp.dynamics.as_aerodynamics`. Without a posterior only its mean is checked.
    aircraft : Aircraft
    airspeeds : float or array-like
        Of the trims [m/s].
    seconds : float
        Of all flights together, pauses included.
    axes : sequence of str
        Controls to move, such as ``["elevator", "aileron", "rudder"]``.
    goal : sequence of str, optional
        Derivatives such as ``Cm_q`` or ``Cn_rudder``, of body-axis coefficients, rates non-dimensional; "function": the
        error of the six coefficients over the flown range of the regressors, each in units of its spread there;
        "free-flight": the deviation of alpha, beta, phi and theta [rad] that these errors cause in 2 s. By default all
        derivatives.
    limits : mapping of str to Limits or float, optional
        Of the axes; by default the deviation from trim that the model was learned from.
    envelope : Envelope, optional
        By default that which was flown, and a fifth more; no lower than was flown.
    altitude : float, optional
        [m]; by default the highest that was flown, or 100 m if the model does not know it. More gives more room.
    banks : sequence of float, default=(0.0,)
        Of the trims [rad]: in turns the aircraft pitches while alpha is constant.
    gusts : Turbulence, "as flown" or None
        Of the check. "as flown": that of the training flights, or calm air, with a warning, if the model does not know
        it.
    known : Information, optional
        Of earlier flights; by default that of the model's posterior at the trims.
    noise : DataFrame or mapping, optional
        As for `expected_information`; by default `coefficient_noise` of the model.
    bands : DataFrame, optional
        As `input_bands` returns, for a model without recognisable modes.
    curvature : bool, default=False
        Whether coefficients also have unknown curvature, from which the flight must tell the derivatives: errors are
        larger, and those after the flight are the mean over aircraft and entries that are drawn, in still air. False:
        coefficients are linear.
    pause : float, default=3.0
        After each manoeuvre [s]; the response in it counts.
    rate : float, default=50.0
        Of the autopilot [Hz].
    n_paths : int, default=60
        Aircraft drawn for each check.
    thrust
        As for :func:`skdgp.dynamics.simulate`.
    detents : mapping of str to float, optional
        Of all axes [rad, or 1 of the throttle]: a pilot flies. The library then holds only steps, whose times are half
        seconds and whose levels are multiples of these.
    random_state : int, RandomState instance or None, default=0
        Of the draws.

    Returns
    -------
    Plan

    Raises
    ------
    ValueError
        If there is no trim, the trim has not an axis, the model has not a regressor of the goal or did not see it move,
        no manoeuvre fits into the time, the autopilot is too slow, or no manoeuvre stays in the envelope.

    Warns
    -----
    UserWarning
        If the model does not know the turbulence of its flights, and none is given; or if it does not know the range
        of a quantity that the envelope does not limit.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.design import plan
    >>> from skdgp.dynamics import Aerodynamics, Aircraft
    >>> def linear(X):
    ...     alpha, beta, p, q, r, elevator, aileron, rudder = X.T
    ...     lift = 0.3 + 4.5 * alpha
    ...     return np.stack([-0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift,
    ...                      -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
    ...                      0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder], axis=-1)
    >>> names = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> found = plan(Aerodynamics(linear, names), aircraft, airspeeds=20.0, seconds=16.0, axes=["elevator"],
    ...              goal=["Cm_alpha", "Cm_q"], limits={"elevator": 0.04}, noise={"Cm": 0.004})
    >>> found.manoeuvres["name"].tolist()
    ['elevator doublet 0.23 s', 'elevator 3-2-1-1 0.39 s', 'elevator doublet 0.23 s']
    """
    planner = _Planner(
        as_aerodynamics(model), model, aircraft, envelope or Envelope(), pause, rate, n_paths, gusts, thrust,
        int(check_random_state(random_state).randint(2**31 - 1)), curvature, detents or {},
    )  # fmt: skip
    with one_blas_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)  # what leaves the envelope is told as risk
        return planner.plan(
            np.atleast_1d(np.asarray(airspeeds, dtype=float)), seconds, axes, goal, limits, altitude, banks, known,
            coefficient_noise(model) if noise is None else noise, bands,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Manoeuvre:
    """A manoeuvre of the library, from one of the trims."""

    name: str
    at: int
    full: dict[str, Signal]
    """As large as the limits allow."""
    inputs: dict[str, Signal]
    seconds: float
    information: Information
    flight: pd.DataFrame
    scale: float = 1.0
    risk: float | None = None
    """None: not checked."""


class _Hold(NamedTuple):
    """Trimmed flight of the mean, and the room that the envelope leaves around it."""

    flight: pd.DataFrame
    centre: Matrix
    """Channels of the envelope, (n, c)."""
    low: Matrix
    """Below it, and above."""
    high: Matrix
    margin: Vector
    """Part of the response by which it may be larger, (c,)."""

    def _rows(self, values: Matrix) -> Indices:
        return np.minimum(np.arange(len(values)), len(self.centre) - 1)

    def response(self, values: Matrix) -> Matrix:
        """Return the deviation of channels (n, c) from trimmed flight."""
        return values - self.centre[self._rows(values)]

    def room(self, values: Matrix) -> float:
        """Return the factor by which the response, with its margin, fits into the room."""
        moved = (1 + self.margin) * self.response(values)
        rows = self._rows(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = np.where(moved > 0, self.high[rows], self.low[rows]) / np.abs(moved)
        return float(np.nanmin(factors))


@dataclass
class _Planner:
    """What the steps of a search share."""

    aerodynamics: Aerodynamics
    model: Any
    aircraft: Aircraft
    envelope: Envelope
    pause: float
    rate: float
    n_paths: int
    gusts: Any
    thrust: Any
    seed: int
    curvature: bool = False
    detents: Mapping[str, float] = field(default_factory=dict)

    def plan(self, airspeeds, seconds, axes, goal, limits, altitude, banks, known, noise, bands) -> Plan:
        """Return the plan: see `plan`."""
        if self.gusts == "as flown" and self.aerodynamics.turbulence is None:
            self.gusts = None
            if self.aerodynamics.is_uncertain:
                warnings.warn(
                    "The model does not know the turbulence of its flights, so risks are those of calm air. Give "
                    "gusts=Turbulence.low_altitude(height, wind_at_6m).",
                    UserWarning,
                    stacklevel=4,
                )
        if (free := self.envelope.unlimited(self.aerodynamics)) and self.aerodynamics.is_uncertain:
            options = ", ".join(OPTIONS[name] for name in free)
            warnings.warn(
                f"The model does not know the flown range of {', '.join(free)}, so nothing limits them: a manoeuvre "
                f"may turn the aircraft over or dive. Limit them by the envelope ({options}), or fit the model again.",
                UserWarning,
                stacklevel=4,
            )
        self._check_paths()
        self.seconds, self.noise, self.axes = float(seconds), noise_table(noise), list(axes)
        self.coefficients = list(map(str, self.noise.index))
        self.goal_names = check_goal(goal, self.aerodynamics, self.coefficients)
        notify("planning: trims", 0, 0.0)
        if altitude is None:
            altitude = flown_quantities(self.aerodynamics).get("altitude", (0.0, 100.0))[1]
        level = {"altitude": altitude, "climb": None if self.thrust is None else 0.0, "thrust": self.thrust}
        self.trims = [
            cast(Trim, trim(self.model, self.aircraft, speed, bank=bank or None, **level))
            for speed in airspeeds
            for bank in banks
        ]
        for point in self.trims:
            check_names(self.axes, point.controls, "controls of the trim")
        self.limits = self._checked_limits(limits)
        self.holds = [self._checked_hold(at) for at in range(len(self.trims))]
        names = self.aerodynamics.regressors
        starts = [regressors_of(hold.flight, self.aircraft, names)[0] for hold in self.holds]
        self.before = self._known(known, np.mean(starts, axis=0))
        self.about = np.mean(starts, axis=0) if self.curvature else None
        weights = goal_weights(
            self.goal_names, self.aerodynamics, self.aircraft, self.trims, self.coefficients, self.thrust
        )
        self.goal = np.stack([value.ravel() for value in weights.values()])
        self.weights = {name: value for name, value in weights.items() if name in WHOLE}
        library = {one.name: one for at in range(len(self.trims)) for one in self._library(at, bands)}
        if not library:
            raise ValueError(
                f"Got {self.seconds:g} s, but no manoeuvre with pauses of {self.pause:g} s is that short and can be "
                "flown: give more seconds, a shorter pause, smaller limits or smaller detents."
            )
        peaks = [np.einsum("pdd->pd", one.information.fisher) for one in library.values()]
        peak = np.max(peaks, axis=0)
        self.vague = VAGUE * np.stack([np.diag(row) for row in np.where(peak > 0, peak, 1.0)])
        self.vague += (self._nothing(self.vague) + self.before).fisher  # the sum has the shape with curvature
        return self._plan_of(*self._searched(library))

    def _check_paths(self) -> None:
        if self.aerodynamics.is_uncertain and 1 / (self.n_paths + 2) > self.envelope.risk:
            raise ValueError(
                f"Got n_paths={self.n_paths}, too few to show a risk of {self.envelope.risk:g}, but expected at least "
                f"{int(np.ceil(1 / self.envelope.risk)) - 2}, better three times as many."
            )

    def _nothing(self, fisher: Array) -> Information:
        """Return no information, in the shape of some."""
        return Information(np.zeros(fisher.shape), tuple(self.coefficients), tuple(self.aerodynamics.regressors))

    def _checked_limits(self, limits: Mapping[str, Limits | float] | None) -> dict[str, Limits]:
        """Return the limits of the axes; by default what the model was learned from."""
        check_names(limits or (), self.axes, "axes")
        given = {axis: one if isinstance(one, Limits) else Limits(one) for axis, one in (limits or {}).items()}
        if self.detents:  # a pilot's ramps are his own
            check_names(self.axes, self.detents, "axes with detents")
            given = {axis: Limits(one.amplitude) for axis, one in given.items()}
        return {axis: given[axis] if axis in given else Limits(self._flown(axis)) for axis in self.axes}

    def _flown(self, axis: str) -> float:
        """Return the largest deviation from the trims that was flown to both sides."""
        flown = self.aerodynamics.limits
        if flown is None or axis not in self.aerodynamics.regressors:
            raise ValueError(
                f"Got no limit of the {axis}, and the model does not say what was flown: give limits={{{axis!r}: ...}}."
            )
        low, high = flown[:, self.aerodynamics.regressors.index(axis)]
        values = [point.controls[axis] for point in self.trims]
        room = min(min(value - low, high - value) for value in values)
        if not room > 0:
            raise ValueError(
                f"Got trims with the {axis} at {values[0]:.3g}, outside what the model was learned from ({low:.3g} to "
                f"{high:.3g}): choose another airspeed, or give limits={{{axis!r}: ...}}."
            )
        return float(room)

    def _flown_by(
        self, at: int, several: Sequence[Mapping[str, Signal]], n_paths: int = 0, gusts: Any = None
    ) -> list[pd.DataFrame]:
        """Return the simulated flights of manoeuvres from a trim, each with the pause after it.

        With ``n_paths`` the first alone, by so many aircraft and entries that are drawn.
        """
        point = self.trims[at]
        trains = [Wavetrain({axis: {0.0: signal} for axis, signal in inputs.items()}) for inputs in several]
        longest = max(train.duration for train in trains) + self.pause
        tables = [train.table(self.rate, trim=point.controls, pause=longest - train.duration) for train in trains]
        duration = STEP * np.floor(min(table["time"].iloc[-1] for table in tables) / STEP + 1e-6)
        controls: Any = tables
        options: dict[str, Any] = {}
        if n_paths and self.aerodynamics.is_uncertain:
            controls, options = self._entered(point, tables[0], n_paths)
            options["gusts"] = gusts
        flown = simulate(
            self.model, self.aircraft, [point] * len(tables), controls, STEP, duration=duration, thrust=self.thrust,
            **options,
        )  # fmt: skip
        parts = [flown] if len(tables) == 1 else [part for _, part in flown.groupby("start", sort=True)]
        ends = [train.duration + self.pause + 1e-6 for train in trains]
        return [part[part["time"] <= end].reset_index(drop=True) for part, end in zip(parts, ends, strict=True)]

    def _entered(self, point: Trim, table: pd.DataFrame, n_paths: int) -> tuple[Any, dict[str, Any]]:
        """Return controls held beside the trim, and what else `simulate` needs to draw aircraft and entries."""
        rng, time = np.random.default_rng(self.seed), table["time"].to_numpy()
        beside: dict[str, Any] = {
            axis: ENTRY_CONTROLS * limit.amplitude * rng.standard_normal((n_paths, 1))
            for axis, limit in self.limits.items()
        }
        columns = {str(name): values.to_numpy() for name, values in table.items() if name != "time"}

        def controls(t: float, state: Any) -> dict[str, Any]:
            return {name: np.interp(t, time, values) + beside.get(name, 0.0) for name, values in columns.items()}

        start = ENTRY | {"u": ENTRY_SPEED * point.airspeed}
        return controls, {"n_paths": n_paths, "random_state": self.seed, "initial_std": start}

    def _checked_hold(self, at: int) -> _Hold:
        """Return trimmed flight; raise ValueError if it leaves the envelope by itself."""
        longest = max((*MULTISINES, self.pause))
        still = {self.axes[0]: Steps([longest], [0.0])}
        flight, paths = self._flown_by(at, [still])[0], self._flown_by(at, [still], self.n_paths, self.gusts)[0]
        risk, causes = self._risk_of(paths[paths["time"] <= self.pause + 1e-6])
        if risk > self.envelope.risk:
            point = self.trims[at]
            raise ValueError(
                f"Got an envelope that trimmed flight at {point.airspeed:g} m/s and {point.altitude:.0f} m leaves in "
                f"{risk:.0%} of cases within {self.pause:g} s, by {causes}, but expected at most "
                f"{self.envelope.risk:.0%}: widen this limit, choose another airspeed or altitude, or weaker gusts."
            )
        centre = self._channels(flight)
        margin = np.zeros_like(centre)
        if self.aerodynamics.is_uncertain:
            drawn = np.stack([self._channels(one) for _, one in paths.groupby("flight", sort=False, observed=True)])
            margin = SPREAD * np.nanstd(drawn, axis=0)
        limits = self.envelope.bounds(self.aerodynamics)
        is_set = [name.removeprefix(GROWTH) in self.axes for name in limits]  # a control has no response
        bounds = np.array([*limits.values()]).T
        low, high = (np.maximum(room - margin, LEAST * room) for room in np.abs(bounds[:, None] - centre))
        return _Hold(flight, centre, low, high, np.where(is_set, 0.0, self.envelope.margin))

    def _channels(self, flight: pd.DataFrame) -> Matrix:
        return self.envelope.channels(flight, self.aircraft, self.aerodynamics).to_numpy()

    def _risk_of(self, flight: pd.DataFrame, more: Matrix | float = 0.0) -> tuple[float, str]:
        """Return the risk that flights leave the envelope, and the limits that they leave, with their options."""
        left = self.envelope.left(flight, self.aircraft, self.aerodynamics, more)
        by_path = left.groupby(flight["flight"].to_numpy(), sort=False).any()
        shares = by_path.mean().sort_values(ascending=False)
        shares = shares[shares > 0]
        options = {name: option_of(str(name), self.aerodynamics) for name in shares.index}
        named = [f"{name} ({share:.0%}, {options[name]})" for name, share in shares.items()]
        causes = ", ".join(named).replace(GROWTH, "flown ")
        n_left = int(by_path.any(axis=1).sum())
        if not self.aerodynamics.is_uncertain:
            return float(n_left), causes
        return (n_left + 1) / (self.n_paths + 2), causes

    def _known(self, known: Information | None, at: Array) -> Information:
        """Return the information before the flight."""
        n = 1 + len(self.aerodynamics.regressors)
        nothing = self._nothing(np.zeros((len(self.coefficients), n, n)))
        if known is not None:
            return nothing + known  # which checks names
        if not self.aerodynamics.is_uncertain:
            return nothing
        return posterior_information(self.model, at, self.coefficients)

    def _information(self, flight: pd.DataFrame) -> Information:
        """Return what a simulated flight will tell."""
        return expected_information(flight, self.aircraft, self.aerodynamics.regressors, self.noise, about=self.about)

    def _entered_information(self, one: _Manoeuvre) -> Information:
        """Return what a manoeuvre teaches on average over aircraft and entries that are drawn, in still air."""
        n = ENTRIES if self.aerodynamics.is_uncertain else 1
        flown = self._flown_by(one.at, [one.inputs], n)[0]
        found = self._information(flown[flown["ended"] == ""])
        return replace(found, fisher=found.fisher / n)

    def _bands(self, at: int, bands: pd.DataFrame | None) -> pd.DataFrame:
        """Return widths and frequencies of the inputs of a trim."""
        if bands is None:
            linear = linearize(self.model, self.aircraft, self.trims[at], inputs=self.axes, thrust=self.thrust)
            bands = input_bands(linear)
        return bands.loc[self.axes]

    def _label(self, at: int) -> str:
        """Return what tells a trim from the others."""
        point, label = self.trims[at], ""
        if len({one.airspeed for one in self.trims}) > 1:
            label += f"{point.airspeed:g} m/s: "
        if len({round(one.phi, 3) for one in self.trims}) > 1:
            label += f"bank {np.rad2deg(point.phi):.0f} deg: "
        return label

    def _library(self, at: int, bands: pd.DataFrame | None) -> list[_Manoeuvre]:
        """Return the manoeuvres that fit into the time and can be flown by the mean."""
        notify(f"planning: {self._label(at)}library", 0, 0.0)
        return self._made(at, dict(self._inputs(self._bands(at, bands))))

    def _inputs(self, bands: pd.DataFrame) -> Iterator[tuple[str, dict[str, Signal]]]:
        """Yield names and inputs of the library, as large as the limits allow."""
        for axis in self.axes:
            limit = self.limits[axis]
            for factor in WIDTHS:
                for kind, make in (("doublet", doublet), ("3-2-1-1", three_two_one_one)):
                    width = factor * bands.loc[axis, f"{make.__name__}_width"]
                    width = TICK * max(1, round(width / TICK)) if self.detents else width
                    signal = limit.largest(make(width, limit.amplitude, limits=replace(limit, rms=np.inf)))
                    yield f"{axis} {kind} {width:.2f} s", {axis: signal}
        groups = {tuple(group) for n in (1, len(self.axes)) for group in combinations(self.axes, n)}
        for group in sorted(groups, key=lambda one: (len(one), self.axes.index(one[0]))):
            low, high = bands.loc[list(group), "lowest"].min(), bands.loc[list(group), "highest"].max()
            for duration in () if self.detents else MULTISINES:
                n = int(np.floor(high * duration)) - int(np.ceil(low * duration)) + 1
                tones = min(MOST_TONES, n // len(group))
                if tones > 1:
                    limits = {axis: self.limits[axis] for axis in group}
                    inputs = orthogonal_multisines(
                        limits, duration, (low, high), n_tones=tones, n_starts=STARTS, random_state=self.seed
                    )
                    yield f"{'+'.join(group)} multisine {duration:g} s", dict(inputs)

    def _made(self, at: int, named: Mapping[str, dict[str, Signal]]) -> list[_Manoeuvre]:
        """Return manoeuvres that fit into the time, as large as the envelope seems to allow the mean."""
        lasting = {name: max(one.duration for one in inputs.values()) + self.pause for name, inputs in named.items()}
        named = {name: inputs for name, inputs in named.items() if lasting[name] + self.pause <= self.seconds}
        scales: dict[str, float] = {}
        for factor in (1.0, 0.5, LEAST):
            rest = {name: self._scaled(inputs, factor) for name, inputs in named.items() if name not in scales}
            for name, flight in self._flights(at, rest).items():
                scales[name] = float(np.clip(factor * self.holds[at].room(self._channels(flight)), LEAST, 1.0))
        found = []
        scaled = {name: self._scaled(named[name], scale) for name, scale in scales.items()}
        for name, flight in self._flights(at, {name: one for name, one in scaled.items() if _moves(one)}).items():
            facts = scaled[name], lasting[name], self._information(flight), flight, scales[name]
            found.append(_Manoeuvre(self._label(at) + name, at, named[name], *facts))
        return found

    def _scaled(self, inputs: Mapping[str, Signal], factor: float) -> dict[str, Signal]:
        """Return inputs of another size, the levels of a pilot's in whole detents."""
        found = {axis: signal.scaled(factor) for axis, signal in inputs.items()}
        for axis, signal in found.items():
            if self.detents and isinstance(signal, Steps):
                counts = np.trunc(np.divide(signal.levels, self.detents[axis]) * (1 + ROUNDING))
                found[axis] = Steps(signal.durations, (self.detents[axis] * counts).tolist())
        return found

    def _flights(self, at: int, named: Mapping[str, Mapping[str, Signal]]) -> dict[str, pd.DataFrame]:
        """Return the flights of those manoeuvres that the mean flies to their end."""
        if not named:
            return {}
        flown = zip(named, self._flown_by(at, [*named.values()]), strict=True)
        return {name: flight for name, flight in flown if (flight["ended"] == "").all()}

    def _gain(self, chosen: Sequence[_Manoeuvre]) -> float:
        """Return the mean of minus the logarithm of the errors of the goal."""
        fisher = self.vague
        for one in chosen:
            fisher = fisher + one.information.fisher
        scale = np.sqrt(np.einsum("pdd->pd", fisher))
        n = 1 + len(self.aerodynamics.regressors)
        covariance = np.linalg.inv(fisher / scale[:, :, None] / scale[:, None])[:, :n, :n]
        covariance = covariance / scale[:, :n, None] / scale[:, None, :n]
        return float(-0.5 * np.mean(np.log(self.goal @ covariance.ravel())))

    def _fits(self, chosen: Sequence[_Manoeuvre]) -> bool:
        flights = len({one.at for one in chosen})
        return sum(one.seconds for one in chosen) + flights * self.pause <= self.seconds + 1e-9

    def _filled(self, chosen: list[_Manoeuvre], library: Sequence[_Manoeuvre]) -> list[_Manoeuvre]:
        """Return manoeuvres with more of them, each the one of the largest gain per second, until the time is used."""
        while options := [one for one in library if self._fits([*chosen, one])]:
            now = self._gain(chosen)
            chosen = [*chosen, max(options, key=lambda one: (self._gain([*chosen, one]) - now) / one.seconds)]
        return chosen

    def _sequence(self, library: Sequence[_Manoeuvre]) -> list[_Manoeuvre]:
        """Return the best sequence that is found: greedy, or one repeated, with exchanges while they help."""
        starts = [self._filled([], library), *(self._filled([], [one]) for one in library)]
        best = self._filled(max(starts, key=self._gain), library)
        while True:
            swaps = [
                self._filled([*best[:k], one, *best[k + 1 :]], [])
                for k in range(len(best))
                for one in library
                if one is not best[k] and self._fits([*best[:k], one, *best[k + 1 :]])
            ]
            better = self._filled(max(swaps, key=self._gain), library) if swaps else best
            if self._gain(better) <= self._gain(best) + 1e-6:
                return best
            best = better

    def _searched(self, library: dict[str, _Manoeuvre]) -> tuple[list[_Manoeuvre], dict[str, _Manoeuvre]]:
        """Return the chosen manoeuvres, all of them safe, and the library."""
        causes = ""
        try:
            while chosen := self._sequence([*library.values()]):
                n_checked = sum(one.risk is not None for one in library.values())
                notify(f"planning: {len(chosen)} manoeuvres, {n_checked} kinds checked", 0, 0.0)
                unchecked = next((one for one in chosen if one.risk is None), None)
                if unchecked is None:
                    break
                safe, causes = self._safe(unchecked)
                del library[unchecked.name]
                if safe is not None:
                    library[safe.name] = safe
        except KeyboardInterrupt:
            chosen = self._sequence([one for one in library.values() if one.risk is not None])
            if not chosen:
                raise
        if not chosen:
            raise ValueError(
                f"Got an envelope that every manoeuvre leaves in more than {self.envelope.risk:.0%} of cases, even at "
                f"{LEAST:.0%} of the limits; the last one by {causes}: widen this limit, allow more risk, plan for "
                "weaker gusts, or fly another airspeed or altitude."
            )
        return chosen, library

    def _safe(self, one: _Manoeuvre) -> tuple[_Manoeuvre | None, str]:
        """Return a manoeuvre as large as is safe, or None and the limits that it leaves."""
        scale, best, causes = one.scale, 0.0, "steps smaller than a detent"
        while scale >= LEAST * SHRINK:  # smaller until it is safe, or larger until it is not
            inputs = self._scaled(one.full, scale)
            if not _moves(inputs):  # smaller than a detent
                break
            flight, hold = self._flown_by(one.at, [inputs])[0], self.holds[one.at]
            is_uncertain = self.aerodynamics.is_uncertain
            paths = self._flown_by(one.at, [inputs], self.n_paths, self.gusts)[0] if is_uncertain else flight
            more = hold.margin * hold.response(self._channels(flight))
            risk, causes = self._risk_of(paths, np.tile(more, (len(paths) // len(more), 1)))
            if risk <= self.envelope.risk:
                best, best_risk, best_paths, best_flight = scale, risk, paths, flight
                if scale < one.scale or scale == 1.0:
                    break
                scale = min(1.0, scale / SHRINK)
            elif best:
                break
            else:
                scale *= SHRINK
        if not best:
            return None, causes
        inputs, flight = self._scaled(one.full, best), best_flight
        if self.detents:
            best = max(signal.peak / one.full[axis].peak for axis, signal in inputs.items())
        found = self._information(flight)
        if not self.aerodynamics.is_uncertain:
            best_risk = np.nan
        else:
            flight = with_band(flight, best_paths)
        return replace(one, inputs=inputs, information=found, flight=flight, scale=best, risk=best_risk), causes

    def _plan_of(self, chosen: list[_Manoeuvre], library: dict[str, _Manoeuvre]) -> Plan:
        """Return the plan of manoeuvres, those of one trim together."""
        if self.curvature:  # products that the mean's flight leaves at zero are small in others
            taught = {one.name: self._entered_information(one) for one in chosen}
            chosen = [replace(one, information=taught[one.name]) for one in chosen]
        chosen = sorted(chosen, key=lambda one: one.at)
        trains, rows, gained = [], [], self._gain([])
        flights: list[pd.DataFrame] = []
        for at in sorted({one.at for one in chosen}):
            here = [one for one in chosen if one.at == at]
            trains.append(wavetrain([one.inputs for one in here], pause=self.pause, limits=self.limits))
            start = self.pause
            for one in here:
                flights.append(one.flight.assign(flight=len(flights)))
                gain = self._gain(chosen[: len(flights)]) - gained
                gained += gain
                rows.append({
                    "train": len(trains) - 1, "airspeed": self.trims[at].airspeed, "start": start, "name": one.name,
                    "duration": one.seconds - self.pause, "scale": one.scale, "risk": one.risk,
                    "gain": -np.expm1(-gain), "gain_per_second": gain / one.seconds,
                })  # fmt: skip
                start += one.seconds
        alone = [
            {"name": one.name, "scale": one.scale, "risk": np.nan if one.risk is None else one.risk,
             "gain": -np.expm1(self._gain([]) - self._gain(self._filled([], [one])))}
            for one in library.values()
        ]  # fmt: skip
        parts = tuple(one.information for one in chosen)
        return Plan(
            tuple(trains), tuple(self.trims[at] for at in sorted({one.at for one in chosen})), self.goal_names,
            self.before, sum(parts, self.before), pd.DataFrame(rows), pd.DataFrame(alone),
            pd.concat(flights, ignore_index=True), parts,
            pd.DataFrame(self.envelope.bounds(self.aerodynamics), ["low", "high"]).T, self.aircraft,
            self.weights,
        )  # fmt: skip


def _moves(inputs: Mapping[str, Signal]) -> bool:
    return any(signal.peak for signal in inputs.values())


def errors_of(information: Information, weights: Mapping[str, Array] | None = None) -> pd.Series:
    """Return standard errors by the names of derivatives, and of goals by their weights."""
    errors = information.std
    names = [f"{i}_{name.removesuffix(HAT)}" for i in errors.index for name in errors.columns]
    others = {name: weighted_error(information, value) for name, value in (weights or {}).items()}
    return pd.concat([pd.Series(errors.to_numpy(float).ravel(), index=names), pd.Series(others, dtype=float)])

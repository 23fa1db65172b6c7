"""The next flight: manoeuvres that teach most about a goal, and stay in an envelope."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal, NamedTuple, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state

from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.progress import notify
from skdgp._compute.typing import Array, Seed
from skdgp._excitation import Limits, as_limits, wavetrain
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_names
from skdgp.design._envelope import OPTIONS, WHOLE_RANGE, Envelope, flown_quantities, with_band
from skdgp.design._information import (
    WHOLE,
    Information,
    check_goal,
    coefficient_noise,
    expected_information,
    goal_weights,
    noise_table,
    padded,
    posterior_information,
    regressors_of,
    scaled_inverse,
)
from skdgp.design._library import TICK, Inputs, duration_of, input_bands, library, scaled
from skdgp.design._plan import Plan
from skdgp.design._rehearsal import LEAST, RESPONSE, Checked, Rehearsal
from skdgp.dynamics import (
    Aircraft,
    SimulationWarning,
    Trim,
    as_aerodynamics,
    linearize,
    stability_derivatives,
    trim,
)

ENTRIES = 12  # aircraft and entries drawn, over which the information of a manoeuvre is averaged
# least factor by which a check makes a manoeuvre smaller: large responses are not in proportion to
# it
SHRINK = 0.7
TRIES, NEAR = (
    6,
    0.03,
)  # checks of a manoeuvre at most, and the part of its size by which the safe one may be missed
MOST = np.pi / 2  # deflection that no surface has [rad]
UNBOUNDED = ("thrust", "propeller_speed")  # axes that are no deflections
MOST_PATHS, MOST_SECONDS = (
    10_000,
    1800.0,
)  # a risk of 5 % is then known to .2 %; the search takes a minute or two
WORTH = (
    0.002  # least part by which a flight lowers the errors of the goal: for less it is not flown
)
# information assumed of everything, relative to the largest of a manoeuvre, so that errors are
# finite
VAGUE = 1e-8


class Known(NamedTuple):
    """What is known before a flight is planned; what is not given is what the model knows.

    Parameters
    ----------
    information : Information, optional
        Of earlier flights; by default that of the model's posterior at the trims.
    noise : DataFrame or mapping, optional
        As for `expected_information`; by default `coefficient_noise` of the model.
    bands : DataFrame, optional
        As `input_bands` returns, for a model without recognisable modes.
    curvature : bool, default=False
        Whether the flight must tell the derivatives from unknown curvature too: errors are larger,
        and those after the flight are the mean over aircraft and entries that are drawn, in still
        air.
    """

    information: Information | None = None
    noise: pd.DataFrame | Mapping[str, float] | None = None
    bands: pd.DataFrame | None = None
    curvature: bool = False


class Pilot(NamedTuple):
    r"""Who flies a plan: an autopilot, or with ``detents`` a pilot.

    Parameters
    ----------
    pause : float or "auto"
        At the trim before and after each manoeuvre [s], of which 3 s after it count as response.
        "auto": a quarter of the phugoid's period (Lanchester's, :math:`\sqrt{2} \pi V / g`), in
        which the airspeed returns; at least 3 s.
    rate : float, default=50.0
        Of the autopilot [Hz].
    detents : mapping of str to float, optional
        Of all axes [rad, or 1 of the throttle]: the plan then holds only steps, whose times are
        half seconds and whose levels are multiples of these.
    """

    pause: float | Literal["auto"] = "auto"
    rate: float = 50.0
    detents: Mapping[str, float] | None = None


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
    known: Known | None = None,
    pilot: Pilot | None = None,
    thrust: Any = "auto",
    random_state: Seed = 0,
) -> Plan:
    r"""Return the flight that teaches most about a goal in a given time, inside an envelope.

    The library holds doublets, 3-2-1-1s and multisines, whose times and bands are those of the
    modes (`input_bands`). Each is simulated from a trim with the mean of the model. Its information
    (`expected_information`) adds to what is known. Manoeuvres are chosen one by one for the largest
    reduction per second of the mean logarithm of the errors of the goal; then each is exchanged
    while that helps.

    Each chosen manoeuvre is flown by aircraft drawn from the posterior, each in gusts of its own,
    from an entry beside the trim (standard deviations: bank and pitch 2 degrees, airspeed 2 %, held
    controls 2 % of their limits). If K of N leave the envelope, the predicted risk is (K + 1) / (N
    + 2) (Laplace's rule of succession). A manoeuvre is as large as limits and allowed risk let it
    be, or left out, and the choice is made again. Controls are open loop during a manoeuvre and a
    second after it, for which the risk is predicted; the pilot or the autopilot returns to the trim
    in the pause.

    Ctrl-C ends the search with the best of what has been checked. :func:`skdgp.listening` shows the
    progress.

    Raises ValueError if there is no trim, the trim has not an axis, the model has not a regressor
    of the goal or did not see it move, no manoeuvre fits into the time, the autopilot is too slow,
    or no manoeuvre stays in the envelope. Warns if the model does not know the turbulence of its
    flights, or the range of a quantity, and neither is given.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        As for :func:`skdgp.dynamics.as_aerodynamics`. Without a posterior only its mean is checked.
    aircraft : Aircraft
    airspeeds : float or array-like
        Of the trims [m/s].
    seconds : float
        Of all flights together, pauses included; a flight ends 3 s after its last manoeuvre.
    axes : sequence of str
        Controls to move, such as ``["elevator", "aileron", "rudder"]``.
    goal : sequence of str, optional
        Derivatives such as ``Cm_q`` or ``Cn_rudder``, of body-axis coefficients, rates
        non-dimensional; "function": the error of the six coefficients over the flown range, each in
        units of its spread there; "free-flight": the deviation of alpha, beta, phi and theta [rad]
        that these errors cause in 2 s. By default all derivatives.
    limits : mapping of str to Limits or float, optional
        Of the axes; by default the deviation from trim that the model was learned from.
    envelope : Envelope, optional
        By default that which was flown, and a fifth more; no lower than was flown.
    altitude : float, optional
        [m]; by default the highest that was flown, or 100 m if the model does not know it. More
        gives more room.
    banks : sequence of float, default=(0.0,)
        Of the trims [rad]: in turns the aircraft pitches while alpha is constant.
    known : Known, optional
        What is known before the flight; by default what the model knows.
    pilot : Pilot, optional
        Who flies, and how long between manoeuvres; by default an autopilot of 50 Hz.
    thrust
        As for :func:`skdgp.dynamics.simulate`.
    random_state : int, RandomState instance or None, default=0
        Of the draws.

    Returns
    -------
    Plan

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.design import Known, plan
    >>> from skdgp.dynamics import Aerodynamics, Aircraft
    >>> def linear(X):
    ...     alpha, q, elevator = X.T
    ...     none, lift = 0 * alpha, 0.3 + 4.5 * alpha
    ...     return np.stack([-0.02 * lift, none, -lift, none, 0.02 - 0.6 * alpha - 9 * q - elevator, none], axis=-1)
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> found = plan(Aerodynamics(linear, ["alpha", "q_hat", "elevator"]), aircraft, airspeeds=20.0, seconds=16.0,
    ...              axes=["elevator"], goal=["Cm_alpha", "Cm_q"], limits={"elevator": 0.04},
    ...              known=Known(noise={"Cm": 0.004}))
    >>> found.manoeuvres["name"].tolist()
    ['elevator doublet 0.23 s', 'elevator 3-2-1-1 0.39 s', 'elevator doublet 0.23 s']
    """
    with one_blas_thread(), warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", SimulationWarning
        )  # what leaves the envelope is told as risk
        planner = Planner(
            model, aircraft, airspeeds=airspeeds, seconds=seconds, axes=axes, limits=limits, envelope=envelope,
            altitude=altitude, banks=banks, known=known, pilot=pilot, thrust=thrust, goal=goal,
            seed=int(check_random_state(random_state).randint(2**31 - 1)),
        )  # fmt: skip
        return planner.search(goal)


def _check_options(
    airspeeds: Any, seconds: Any, axes: Any, limits: Any, envelope: Envelope, banks: Any, known: Known, pilot: Pilot,
) -> None:  # fmt: skip
    """Raise TypeError or ValueError where an option of `plan` is none."""
    for name, value, kind in (
        ("limits", limits, Mapping), ("envelope", envelope, Envelope), ("known", known, Known), ("pilot", pilot, Pilot),
        ("information", getattr(known, "information", None), Information),
        ("bands", getattr(known, "bands", None), pd.DataFrame),
        ("detents", getattr(pilot, "detents", None), Mapping),
    ):  # fmt: skip
        if not isinstance(value, kind | None):
            raise TypeError(
                f"Got {type(value).__name__} for {name}, but expected {kind.__name__} or None."
            )
    if isinstance(axes, str) or not len(axes) or len({*axes}) < len(axes):
        raise ValueError(
            f"Got axes={axes!r}, but expected different controls in a list, such as ['elevator', "
            f"'rudder']."
        )
    pause, detents, n_paths = pilot.pause, pilot.detents, envelope.n_paths
    is_auto = isinstance(pause, str) and pause == "auto"
    for name, value, least, expected in (
        ("airspeeds", airspeeds, 0.0, "numbers > 0"), ("banks", banks, -np.inf, "numbers"),
        ("seconds", seconds, 0.0, "a number > 0"), ("pause", 1.0 if is_auto else pause, 0.0, "a number > 0"),
    ):  # fmt: skip
        try:
            values = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            values = np.array(np.nan)
        is_shaped = values.size and (expected.startswith("numbers") or not values.ndim)
        if not (is_shaped and np.isfinite(values).all() and (values > least).all()):
            raise ValueError(f"Got {name}={value!r}, but expected {expected}.")
    if not (isinstance(n_paths, int | np.integer) and 0 <= n_paths <= MOST_PATHS):
        raise ValueError(
            f"Got n_paths={n_paths!r}, but expected a number of aircraft to draw, 0 to "
            f"{MOST_PATHS}."
        )
    if seconds > MOST_SECONDS:
        raise ValueError(
            f"Got seconds={seconds:g}, but expected at most {MOST_SECONDS:g}: plan a shorter "
            f"flight, and fly it again."
        )
    for name, given in (("limits", limits or {}), ("detents", detents or {})):
        check_names(given, axes, "axes to move")
        for axis, limit in given.items():
            size = limit.amplitude if isinstance(limit, Limits) else limit
            most = np.inf if axis in UNBOUNDED else MOST
            if not (isinstance(size, int | float | np.number) and 0 < size < most):
                raise ValueError(
                    f"Got {name} of {size!r} for the {axis}, but expected more than 0 and less "
                    f"than {most:.3g}: rad, "
                    "not degrees, or 0 to 1 of the throttle."
                )


def pause_of(airspeed: float) -> float:
    """Return the time that an aircraft needs to be back at its trim: see `plan` [s]."""
    return max(RESPONSE, np.pi * airspeed / (2.0 * np.sqrt(2.0) * STANDARD_GRAVITY))


@dataclass(frozen=True, eq=False)
class Manoeuvre:
    """A manoeuvre of the library, from one of the trims."""

    name: str
    at: int
    full: Inputs  # as large as the limits allow
    inputs: Inputs
    pause: float
    information: Information
    flight: pd.DataFrame
    scale: float = 1.0
    risk: float | None = None  # None: not checked

    @property
    def seconds(self) -> float:
        """Of the manoeuvre and a pause beside it [s]."""
        return duration_of(self.full) + self.pause


class Planner:
    """Trims, manoeuvres and risks of the flights that may be planned; its options are those of `plan`."""

    def __init__(
        self, model, aircraft, *, airspeeds, seconds, axes, limits=None, envelope=None, altitude=None, banks=(0.0,),
        known=None, pilot=None, thrust="auto", seed=0, goal=None,
    ) -> None:  # fmt: skip
        envelope, known, pilot = envelope or Envelope(), known or Known(), pilot or Pilot()
        _check_options(airspeeds, seconds, axes, limits, envelope, banks, known, pilot)
        self.model, self.aircraft, self.thrust, self.seed = model, aircraft, thrust, seed
        self.aerodynamics, self.envelope = as_aerodynamics(model), envelope
        self.detents, self.seconds = pilot.detents or {}, float(seconds)
        if self.aerodynamics.is_uncertain:
            self._check_uncertain()
        self.noise = noise_table(coefficient_noise(model) if known.noise is None else known.noise)
        self.coefficients = tuple(map(str, self.noise.index))
        check_names(self.coefficients, COEFFICIENTS, "coefficients")
        check_goal(goal, self.aerodynamics, self.coefficients)
        notify("planning: trims", 0, 0.0)
        self.trims = self._trims(
            np.atleast_1d(np.asarray(airspeeds, dtype=float)), altitude, np.atleast_1d(banks)
        )
        for point in self.trims:
            check_names(axes, point.controls, "controls of the trim")
        self.limits = self._checked_limits(axes, limits or {})
        self.rehearsals = []
        for point in self.trims:
            pause = pause_of(point.airspeed) if pilot.pause == "auto" else float(pilot.pause)
            pause = TICK * np.ceil(pause / TICK) if self.detents else pause  # a pilot counts
            flown = Rehearsal(
                model, aircraft, point, self.limits, envelope, pilot.rate, pause, thrust, seed
            )
            self.rehearsals.append(flown)
        names = self.aerodynamics.regressors
        self.at = np.mean(
            [regressors_of(one.still, aircraft, names)[0] for one in self.rehearsals], axis=0
        )
        self.before = Information(
            np.zeros((len(self.noise), 1 + len(names), 1 + len(names))), self.coefficients, names
        )
        if known.information is not None:
            self.before += known.information  # which checks names
        elif self.aerodynamics.is_uncertain:
            self.before = posterior_information(model, self.at, self.coefficients)
        self.about = self.at if known.curvature else None
        self.library = {
            one.name: one for at in range(len(self.trims)) for one in self._library(at, known.bands)
        }
        if not self.library:
            pause = min(one.pause for one in self.rehearsals)
            raise ValueError(
                f"Got {self.seconds:g} s, but no manoeuvre with pauses of {pause:.3g} s is that "
                f"short and can be "
                "flown: give more seconds, a shorter pause, smaller limits or smaller detents."
            )
        peak = np.max(
            [np.einsum("pdd->pd", one.information.fisher) for one in self.library.values()], axis=0
        )
        vague = VAGUE * np.stack([np.diag(row) for row in np.where(peak > 0, peak, 1.0)])
        self.known = vague + padded(self.before.fisher, peak.shape[1])

    def search(self, goal: Sequence[str] | None) -> Plan:
        """Return the plan for a goal; checked manoeuvres stay in the library, for another goal."""
        self.goal = check_goal(goal, self.aerodynamics, self.coefficients)
        self.weights = goal_weights(
            self.goal, self.aerodynamics, self.aircraft, self.trims, self.coefficients, self.thrust
        )
        self.errors = np.stack([weight.ravel() for weight in self.weights.values()])
        return self._plan_of(self._searched())

    def _check_uncertain(self) -> None:
        """Warn of gusts and ranges that a model with a posterior does not know; raise ValueError at too few paths."""
        if self.envelope.gusts == "auto" and self.aerodynamics.turbulence is None:
            warnings.warn(
                "The model does not know the turbulence of its flights, so risks are those "
                "without gusts. Give "
                "Envelope(gusts=Turbulence.low_altitude(height, wind_at_6m)).",
                stacklevel=4,
            )
        if free := self.envelope.unlimited(self.aerodynamics):
            options = ", ".join(OPTIONS[name] for name in free)
            warnings.warn(
                f"The model does not know the flown range of {', '.join(free)}, so nothing limits "
                f"them: a manoeuvre "
                f"may turn the aircraft over or dive. Limit them by the envelope ({options}), or "
                f"fit the model again.",
                UserWarning,
                stacklevel=4,
            )
        n_paths = self.envelope.n_paths
        if 1 / (n_paths + 2) > self.envelope.risk:
            raise ValueError(
                f"Got n_paths={n_paths}, too few to show a risk of {self.envelope.risk:g}, but "
                f"expected at least "
                f"{int(np.ceil(1 / self.envelope.risk)) - 2}, better three times as many."
            )

    def _trims(self, airspeeds: Array, altitude: float | None, banks: Array) -> list[Trim]:
        """Return the trims, by default at the highest altitude that was flown."""
        flown = flown_quantities(self.aerodynamics)
        height = flown.get("altitude", (0.0, 100.0))[1] if altitude is None else altitude
        level = {
            "altitude": height,
            "climb": None if self.thrust is None else 0.0,
            "thrust": self.thrust,
        }
        pairs = product(airspeeds, banks)
        try:
            return [
                cast(Trim, trim(self.model, self.aircraft, v, bank=bank or None, **level))
                for v, bank in pairs
            ]
        except ValueError as error:
            low, high = flown.get("airspeed", (0.0, np.inf))
            if (low <= airspeeds).all() and (airspeeds <= high).all():
                raise
            raise ValueError(f"{error} Flown were {low:.3g} to {high:.3g} m/s.") from None

    def _checked_limits(
        self, axes: Sequence[str], limits: Mapping[str, Limits | float]
    ) -> dict[str, Limits]:
        """Return the limits of the axes, by default what the model was learned from; the throttle ends at 0 and 1."""
        given = {axis: as_limits(one) for axis, one in limits.items()}
        if self.detents:  # a pilot's ramps are his own
            check_names(axes, self.detents, "axes with detents")
            given = {axis: replace(one, rate=np.inf, rms=np.inf) for axis, one in given.items()}
        found = {axis: given[axis] if axis in given else Limits(self._flown(axis)) for axis in axes}
        for axis in {*found} & {*WHOLE_RANGE}:
            room = self._room(axis, WHOLE_RANGE[axis], "possible is", "leave it out of the axes")
            found[axis] = replace(found[axis], amplitude=min(found[axis].amplitude, room))
        return found

    def _flown(self, axis: str) -> float:
        """Return the largest deviation from the trims that was flown to both sides."""
        names, flown = self.aerodynamics.regressors, self.aerodynamics.limits
        if flown is None or axis not in names:
            raise ValueError(
                f"Got no limit of the {axis}, and the model does not say what was flown: give "
                f"limits={{{axis!r}: ...}} "
                "(--limits)."
            )
        return self._room(
            axis,
            flown[:, names.index(axis)],
            "flown was",
            f"give limits={{{axis!r}: ...}} (--limits)",
        )

    def _room(self, axis: str, ends: Iterable[float], what: str, remedy: str) -> float:
        """Return the largest deviation of an axis from the trims, to both sides, in its range."""
        (low, high), values = ends, [point.controls[axis] for point in self.trims]
        room = min(min(value - low, high - value) for value in values)
        if not room > 0:
            raise ValueError(
                f"Got trims with the {axis} at {', '.join(f'{value:.3g}' for value in values)}, "
                f"but {what} {low:.3g} "
                f"to {high:.3g}, which leaves it no room: {remedy}, or choose other airspeeds."
            )
        return float(room)

    def _information(self, flight: pd.DataFrame) -> Information:
        """Return what a simulated flight will tell."""
        return expected_information(
            flight, self.aircraft, self.aerodynamics.regressors, self.noise, about=self.about
        )

    def _entered(self, one: Manoeuvre) -> Manoeuvre:
        """Return a manoeuvre with what it teaches on average over aircraft and entries that are drawn, in still air."""
        n = ENTRIES if self.aerodynamics.is_uncertain else 1
        flown = self.rehearsals[one.at].drawn(one.inputs, n)
        found = self._information(flown[flown["ended"] == ""])
        return replace(one, information=replace(found, fisher=found.fisher / n))

    def _label(self, at: int) -> str:
        """Return what tells a trim from the others."""
        point, label = self.trims[at], ""
        if len({one.airspeed for one in self.trims}) > 1:
            label += f"{point.airspeed:g} m/s: "
        if len({round(one.phi, 3) for one in self.trims}) > 1:
            label += f"bank {np.rad2deg(point.phi):.0f} deg: "
        return label

    def _library(self, at: int, bands: pd.DataFrame | None) -> list[Manoeuvre]:
        notify(f"planning: {self._label(at)}library", 0, 0.0)
        if bands is None:
            axes = list(self.limits)
            bands = input_bands(
                linearize(
                    self.model, self.aircraft, self.trims[at], inputs=axes, thrust=self.thrust
                )
            )
        return self.made(at, dict(library(bands, self.limits, self.detents, self.seed)))

    def made(self, at: int, named: Mapping[str, Inputs]) -> list[Manoeuvre]:
        """Return manoeuvres that fit into the time, as large as the envelope seems to allow the mean."""
        rehearsal = self.rehearsals[at]
        most = self.seconds - rehearsal.pause - rehearsal.response
        named = {name: one for name, one in named.items() if duration_of(one) <= most}
        scales: dict[str, float] = {}
        for factor in (1.0, 0.5, LEAST):
            rest = {
                name: scaled(one, factor, self.detents)
                for name, one in named.items()
                if name not in scales
            }
            for name, flight in self._flights(at, rest).items():
                scales[name] = float(np.clip(factor * rehearsal.room(flight), LEAST, 1.0))
        inputs = {name: scaled(named[name], scale, self.detents) for name, scale in scales.items()}
        inputs = {
            name: one for name, one in inputs.items() if any(signal.peak for signal in one.values())
        }  # detents
        label, flights, pause = self._label(at), self._flights(at, inputs), rehearsal.pause
        return [
            Manoeuvre(
                label + name,
                at,
                named[name],
                inputs[name],
                pause,
                self._information(one),
                one,
                scales[name],
            )
            for name, one in flights.items()
        ]

    def _flights(self, at: int, named: Mapping[str, Inputs]) -> dict[str, pd.DataFrame]:
        """Return the flights of those manoeuvres that the mean flies to their end."""
        flights = self.rehearsals[at].flown([*named.values()]) if named else []
        return {
            name: one
            for name, one in zip(named, flights, strict=True)
            if (one["ended"] == "").all()
        }

    def _gain(self, chosen: Sequence[Manoeuvre]) -> float:
        """Return the mean of minus the logarithm of the errors of the goal."""
        fisher, n = (
            sum((one.information.fisher for one in chosen), self.known),
            self.before.fisher.shape[1],
        )
        covariance = scaled_inverse(fisher)[:, :n, :n]
        return float(-0.5 * np.mean(np.log(self.errors @ covariance.ravel())))

    def _fits(self, chosen: Sequence[Manoeuvre]) -> bool:
        last = sum(self.rehearsals[at].response for at in {one.at for one in chosen})
        return sum(one.seconds for one in chosen) + last <= self.seconds + 1e-9

    def _filled(self, chosen: list[Manoeuvre], library: Sequence[Manoeuvre]) -> list[Manoeuvre]:
        """Return manoeuvres with more of them, each the one of the largest gain per second, until the time is used."""
        while options := [one for one in library if self._fits([*chosen, one])]:
            now = self._gain(chosen)
            chosen = [
                *chosen,
                max(options, key=lambda one: (self._gain([*chosen, one]) - now) / one.seconds),
            ]
        return chosen

    def _sequence(self, library: Sequence[Manoeuvre]) -> list[Manoeuvre]:
        """Return the best sequence that is found: greedy, or one repeated, with exchanges while they help."""
        starts = [self._filled([], library), *(self._filled([], [one]) for one in library)]
        best = self._filled(max(starts, key=self._gain), library)
        while True:
            swaps = [
                [*best[:k], one, *best[k + 1 :]]
                for k, old in enumerate(best)
                for one in library
                if one is not old
            ]
            swaps = [each for each in swaps if self._fits(each)]
            better = self._filled(max(swaps, key=self._gain), library) if swaps else best
            if self._gain(better) <= self._gain(best) + 1e-6:
                return best
            best = better

    def _searched(self) -> list[Manoeuvre]:
        """Return the chosen manoeuvres, all of them safe."""
        library, causes = self.library, ""
        try:
            while chosen := self._sequence([*library.values()]):
                gain = self._gain(chosen) - self._gain([])
                if (
                    gain < WORTH and self.about is None
                ):  # the mean's flight does not show what others tell of curvature
                    raise ValueError(
                        f"Got the goal {list(self.goal)}, but {self.seconds:g} s of manoeuvres of "
                        f"{list(self.limits)} "
                        f"within their limits lower its errors by {gain:.2%}: move other axes, "
                        f"raise their limits, or "
                        "ask for another goal."
                    )
                n_checked = sum(one.risk is not None for one in library.values())
                notify(f"planning: {len(chosen)} manoeuvres, {n_checked} kinds checked", 0, 0.0)
                unchecked = next((one for one in chosen if one.risk is None), None)
                if unchecked is None:
                    break
                safe, causes = self.safe(unchecked)
                del library[unchecked.name]
                if safe is not None:
                    library[safe.name] = safe
        except KeyboardInterrupt:
            chosen = self._sequence([one for one in library.values() if one.risk is not None])
            if not chosen:
                raise
        if not chosen:
            raise ValueError(
                f"Got an envelope that every manoeuvre leaves in more than "
                f"{self.envelope.risk:.0%} of cases, even at "
                f"{LEAST:.0%} of the limits; the last one by {causes}: widen this limit, allow "
                f"more risk, plan for "
                "weaker gusts, or fly another airspeed or altitude."
            )
        return chosen

    def safe(self, one: Manoeuvre) -> tuple[Manoeuvre | None, str]:
        """Return a manoeuvre as large as is safe, or None and the limits that it leaves."""
        scale, safe, unsafe, causes = one.scale, 0.0, np.inf, "steps smaller than a detent"
        best: tuple[Inputs, Checked] | None = None
        for _ in range(TRIES):  # until the largest safe size is known to a few parts in a hundred
            inputs = scaled(one.full, scale, self.detents)
            size = max(
                signal.peak / one.full[axis].peak for axis, signal in inputs.items()
            )  # of whole detents
            if size <= safe:
                break
            checked = self.rehearsals[one.at].checked(inputs)
            if checked.risk <= self.envelope.risk:
                safe, best = size, (inputs, checked)
            else:
                unsafe, causes = size, checked.causes
            most = np.sqrt(safe * unsafe) if best and np.isfinite(unsafe) else (1 - NEAR) * unsafe
            scale = min(1.0, size * max(checked.factor, SHRINK), most)
            if best is None and unsafe > (1 + NEAR) * LEAST:
                scale = max(scale, LEAST)
            if scale < max((1 + NEAR) * safe, LEAST):
                break
        if best is None:
            return None, causes
        inputs, checked = best
        flight, risk = checked.flight, np.nan
        if self.aerodynamics.is_uncertain:
            flight, risk = with_band(flight, checked.paths), checked.risk
        found = self._information(checked.flight)
        return replace(
            one, inputs=inputs, information=found, flight=flight, scale=safe, risk=risk
        ), causes

    def _plan_of(self, chosen: list[Manoeuvre]) -> Plan:
        """Return the plan of manoeuvres, those of one trim together."""
        if (
            self.about is not None
        ):  # products that the mean's flight leaves at zero are small in others
            taught = {
                one.name: self._entered(one) for one in {one.name: one for one in chosen}.values()
            }
            chosen = [taught[one.name] for one in chosen]
        chosen = sorted(chosen, key=lambda one: one.at)
        flown = sorted({one.at for one in chosen})
        trains, gained = [], self._gain([])
        rows: list[dict[str, Any]] = []
        for at in flown:
            here, start = [one for one in chosen if one.at == at], self.rehearsals[at].pause
            pauses = [start] * (len(here) - 1) + [self.rehearsals[at].response]
            trains.append(wavetrain([one.inputs for one in here], pause=start, limits=self.limits))
            for one, pause in zip(here, pauses, strict=True):
                gain = self._gain(chosen[: len(rows) + 1]) - gained
                gained += gain
                rows.append({
                    "train": len(trains) - 1, "airspeed": self.trims[at].airspeed, "start": start, "name": one.name,
                    "duration": duration_of(one.full), "pause": pause, "scale": one.scale, "risk": one.risk,
                    "gain": -np.expm1(-gain), "gain_per_second": gain / one.seconds,
                })  # fmt: skip
                start += one.seconds
        parts = tuple(one.information for one in chosen)
        gusts = (
            self.aerodynamics.turbulence if self.envelope.gusts == "auto" else self.envelope.gusts
        )
        is_still = gusts is None or not self.aerodynamics.is_uncertain
        return Plan(
            trains=tuple(trains), trims=tuple(self.trims[at] for at in flown), goal=self.goal, parts=parts,
            before=self.before, after=sum(parts, self.before), manoeuvres=pd.DataFrame(rows),
            aircraft=self.aircraft, merged=self._merged(),
            flight=pd.concat([one.flight.assign(flight=k) for k, one in enumerate(chosen)], ignore_index=True),
            limits=pd.DataFrame(self.envelope.bounds(self.aerodynamics), ["low", "high"]).T,
            at=dict(zip(self.before.regressors, self.at.tolist(), strict=True)),
            weights={name: weight for name, weight in self.weights.items() if name in WHOLE},
            gusts=None if is_still else tuple(map(float, gusts.intensity)),
        )  # fmt: skip

    def _merged(self) -> dict[str, float]:
        if self.aerodynamics.slope_errors is None:
            return {}
        table = stability_derivatives(
            self.model, self.aircraft, self.trims, n_paths=2, thrust=self.thrust
        )
        return np.sqrt((table["std_merged"] ** 2).groupby(level=1).mean()).to_dict()

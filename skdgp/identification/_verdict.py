"""The verdict on a model: its training data, its flight mechanics, the uses it is good enough for, and warnings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import without_warnings
from skdgp._flight.channels import ALL_SURFACES, COEFFICIENTS, RATES, WIND
from skdgp._flight.checks import unwrapped
from skdgp._flight.clock import flight_segments
from skdgp._flight.faults import AIR_UNKNOWN
from skdgp._flight.frames import wrapped
from skdgp._flight.smoothing import noise_level
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    SimulationWarning,
    Turbulence,
    as_aerodynamics,
    linearize,
    simulate,
    stability_derivatives,
    trim,
)
from skdgp.plotting import TimeHistoryDisplay
from skdgp.report import THRESHOLDS, Evaluation, FlightMechanics, Use, Verdict, scores

CONTROLS = ("Cm_elevator", "Cl_aileron", "Cn_rudder")  # derivatives of each moment by its control
# Signs of derivatives of a conventional stable aircraft (docs/notation.md)
SIGNS = {
    "CZ_alpha": -1, "CY_beta": -1, "Cm_alpha": -1, "Cn_beta": 1, "Cl_beta": -1, "Cl_p": -1,
    "Cm_q": -1, "Cn_r": -1, "Cm_elevator": -1, "Cl_aileron": 1, "Cn_rudder": -1,
}  # fmt: skip
FAST_MODES = ("short period", "Dutch roll", "roll")  # modes that a controller of attitude works in
ACCELERATIONS = {"ax", "ay", "az", *(f"{rate}_dot{end}" for rate in "pqr" for end in ("", "_hat"))}
# functions that give the standard deviations of modes, each with a relative error of 1 / sqrt(2 n),
# 5 %
N_PATHS = 200
SHOWN_PATHS = 30  # of the simulation that the report draws
SHOWN_STATES = ("airspeed", "alpha", "phi", "theta", "p", "q")
UNCONVERGED = "a reconstruction did not converge"
GUSTS_UNKNOWN = "gusts without vanes are not known"
STATES = ("airspeed", "alpha", "beta", "phi", "theta", *RATES)  # of no wind and no heading
# of the simulation [s]: Runge and Kutta's method is stable for modes of up to 55 rad/s
FLIGHT_STEP = 0.05
# time over which measured states are averaged to start from [s], so that a sample's noise is not
# flown
START = 0.25
MOST_STARTS = 60  # starts that are simulated
PARTS = 20  # parts of their time over which errors are averaged


def judge(
    train: Iterable[pd.DataFrame],
    evaluations: Sequence[Evaluation],
    fit: dict,
    mechanics: FlightMechanics,
    messages: Sequence[str],
) -> Verdict:
    """Return the verdict, by the thresholds of `skdgp.report.THRESHOLDS`."""
    table, learned = scores(evaluations)["measured"], list(train)
    faults = _faults(mechanics.derivatives, fit, messages)
    rest = [text for text in messages if not text.startswith(AIR_UNKNOWN)]
    errors = {
        flight.name: flight.scores["measured"]["normalized_rmse"].mean() for flight in evaluations
    }
    linear = table.get("least_squares_normalized_rmse")
    ratio = pd.Series(dtype=float) if linear is None else table["normalized_rmse"] / linear
    source = (
        f"{_amount(learned)}, {fit['samples']:,} samples"
        if learned
        else "flights that are not part of this report"
    )
    judged = {
        "predict coefficients": _prediction(table),
        "simulate": _simulation(mechanics, fit["regressors"]),
        "design a controller": _control(mechanics, table["normalized_rmse"], faults),
    }
    doubts = "".join(f"; but {doubt}" for doubt in (UNCONVERGED, GUSTS_UNKNOWN) if doubt in faults)
    if doubts:
        judged = {
            purpose: ("partly", reason + doubts) if fit == "yes" else (fit, reason)
            for purpose, (fit, reason) in judged.items()
        }
    return Verdict(
        learned=f"The six coefficients {' '.join(COEFFICIENTS)} as functions of "
        f"{', '.join(fit['regressors'])}, "
        f"learned from {source}; tested on {_amount([flight.table for flight in evaluations])}.",
        error=float(table["normalized_rmse"].mean()),
        coverage=float(table["interval_coverage"].mean()),
        least_squares_error=None if linear is None else float(linear.mean()),
        better=tuple(ratio.index[ratio < 1 - THRESHOLDS.tie]),
        worse=tuple(ratio.index[ratio > 1 + THRESHOLDS.tie]),
        uses=tuple(Use(purpose, *judgement) for purpose, judgement in judged.items()),
        warnings=(*faults.values(), *_warnings(table, errors, fit, rest)),
    )


def _amount(tables: Sequence[pd.DataFrame]) -> str:
    seconds = sum(float(np.ptp(table["time"])) for table in tables)
    time = f"{seconds / 60:.1f} minutes" if seconds >= 60 else f"{seconds:.3g} s"
    return f"{time} of {len(tables)} flight{'s' * (len(tables) != 1)}"


def _prediction(table: pd.DataFrame) -> tuple[str, str]:
    """Return whether the model predicts coefficients, and why."""
    lacks = {}
    for name, error, held in table[["normalized_rmse", "interval_coverage"]].itertuples():
        faults = [f"error {error:.2f} of its spread"] * (not error <= THRESHOLDS.error)
        faults += [f"its 95 % band holds {100 * held:.0f} %"] * (not held >= THRESHOLDS.coverage)
        if faults:
            lacks[name] = f"{name}: {', '.join(faults)}"
    errors = table["normalized_rmse"]
    if not lacks:
        return "yes", (
            f"errors {errors.min():.2f} to {errors.max():.2f} of the spread of the coefficients"
        )
    good = [name for name in table.index if name not in lacks]
    reason = f"only {' '.join(good)}. " * bool(good) + "; ".join(lacks.values())
    return "partly" if good else "no", reason


def _simulation(mechanics: FlightMechanics, regressors: Sequence[str]) -> tuple[str, str]:
    """Return whether the model simulates flights, and why."""
    table = mechanics.simulation
    if accelerations := ", ".join(sorted(ACCELERATIONS & set(regressors))):
        return "no", f"the regressors {accelerations} are known only after a flight"
    if table is None:
        return "unknown", mechanics.simulation_note
    ends = table["lasts"].sort_values()
    seconds, horizon = float(ends.iloc[0]), float(table["horizon"].iloc[0])
    follows = "it follows the test flights for"
    if seconds >= horizon:
        return "yes", f"{follows} the {horizon:.2g} s that were simulated"
    apart = float(table["lasts_without_gusts"].min())
    if seconds < THRESHOLDS.seconds <= apart:
        return "unknown", (
            f"not testable in this air: {follows} {seconds:.2g} s, and gusts of "
            f"{table['gusts'].iloc[0]:.2g} m/s, which are not estimated, explain the difference "
            f"for {apart:.2g} s"
        )
    late = [f"{name} {value:.2g} s" for name, value in ends.items() if value < horizon]
    steady = f"; the other states for all {horizon:.2g} s" if len(late) < len(table) else ""
    reason = f"{follows} {seconds:.2g} s: {_some(late)}{steady}"
    return "partly" if seconds >= THRESHOLDS.seconds else "no", reason


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _faults(derivatives: pd.DataFrame, fit: dict, messages: Sequence[str]) -> dict[str, str]:
    """Return by a short name the warnings that forbid the design of a controller."""
    faults = {}
    air = [text for text in messages if text.startswith(AIR_UNKNOWN)]
    if unknown := fit.get("gusts_unknown"):
        air = [f"{AIR_UNKNOWN}: {unknown}"]
    if air:
        faults[GUSTS_UNKNOWN] = air[0]
    if unconverged := fit.get("paths_not_converged"):
        faults[UNCONVERGED] = (
            f"The paths of these flights did not converge: {_some(unconverged)}. "
            f"Their sensors contradict one another."
        )
    values = derivatives.get("value", pd.Series(dtype=float)).reindex(list(SIGNS))
    wrong = values[values * pd.Series(SIGNS) < 0]
    if len(wrong):
        signs = ", ".join(f"{name} {value:+.2g}" for name, value in wrong.items())
        faults[f"wrong sign of {', '.join(map(str, wrong.index))}"] = (
            f"Signs are not as on a conventional stable aircraft: {signs}. Look at the signs of "
            f"the log's surfaces and rates, and at gusts without vanes."
        )
    return faults


def _control(
    mechanics: FlightMechanics, errors: pd.Series, faults: Iterable[str]
) -> tuple[str, str]:
    """Return whether the model serves to design a controller, and why."""
    table, modes = mechanics.derivatives, mechanics.modes
    if faults:
        return "no", "; ".join(faults)
    if mechanics.trim is None:
        return "no", mechanics.note.partition(":")[0]
    if "std" not in table:
        return "unknown", "the model has no bands of derivatives"
    bands = table.loc[table.index.isin(CONTROLS), ["value", "std"]]
    if bands.empty:
        return "no", "the model has none of the controls elevator, aileron, rudder"
    if modes is not None:
        fast = modes.loc[modes.index.isin(FAST_MODES), ["frequency", "frequency_std"]]
        bands = pd.concat([bands, fast.set_axis(["value", "std"], axis=1)])
    widths = 1.96 * bands["std"] / bands["value"].abs()
    wide = [
        f"{name} ± {100 * width:.0f} %" if width < 10 else f"{name} unknown"
        for name, width in widths.items()
        if not width <= THRESHOLDS.band
    ]
    if wide:
        return "no", f"not known well enough, half of the 95 % interval: {', '.join(wide)}"
    reason = (
        f"controls and fast modes are known to {100 * widths.max():.0f} % or better "
        f"({widths.idxmax()})"
    )
    if beyond := ", ".join(mechanics.trim.beyond):
        return "no", f"the trim is outside the flown range in {beyond}; {reason}"
    poor = " ".join(name for name in ("Cl", "Cm", "Cn") if errors[name] > 1)
    if poor:
        return "partly", f"{reason}; but a constant predicts {poor} of the test flights better"
    return "yes", reason


def _warnings(
    table: pd.DataFrame, errors: Mapping[str, float], fit: dict, messages: Sequence[str]
) -> tuple[str, ...]:
    """Return warnings, the costliest first: findings of the scores, then messages of the log and the fit."""
    bad = [name for name, error in errors.items() if error > 1]
    error, held = table["normalized_rmse"], table["interval_coverage"]
    linear = table.get("least_squares_normalized_rmse", np.inf * error)
    worse = table.index[error > (1 + THRESHOLDS.tie) * linear]
    mostly = len(worse) >= len(table) / 2 or error.mean() > (1 + THRESHOLDS.tie) * linear.mean()
    narrow = [f"{k} {100 * x:.0f} %" for k, x in held.items() if x < THRESHOLDS.coverage]
    findings = {
        f"In {len(bad)} of {len(errors)} test flights a constant predicts better (error above 1): "
        f"{_some(bad)}.": bad,
        f"Least squares is better in {len(worse)} of {len(table)} coefficients: "
        f"{' '.join(worse)}.": mostly,
        f"95 % bands are too narrow: they hold {', '.join(narrow)} of the measured values.": narrow,
        "The fit has not converged: raise max_iter.": not fit.get("converged", True),
    }
    return (*(text for text, applies in findings.items() if applies), *grouped(messages))


def grouped(messages: Sequence[str]) -> tuple[str, ...]:
    """Return messages; of several that differ only in names and numbers, the first and the number of the others.

    Examples
    --------
    >>> grouped(["Flight 'a' lasts 1.5 s.", "A gap.", "Flight 'b' lasts 2 s."])
    ("Flight 'a' lasts 1.5 s. (1 more of this kind)", 'A gap.')
    """
    kinds: dict[str, list[str]] = {}
    for message in messages:
        kinds.setdefault(re.sub(r"'[^']*'|[-+]?\d[\d.]*", "", message), []).append(message)
    return tuple(
        first + f" ({len(similar)} more of this kind)" * bool(similar)
        for first, *similar in kinds.values()
    )


def flight_mechanics(
    pipeline: Pipeline,
    aircraft: Aircraft,
    train: Sequence[pd.DataFrame],
    test: Sequence[pd.DataFrame],
    settings: dict,
    fit: dict,
) -> FlightMechanics:
    """Return trim, derivatives and modes at the median airspeed and density flown, and a simulation of test flights.

    Without a thrust the flight is a glide. Where there is no trim, derivatives are at the median of
    the flights.
    """
    flown = pd.concat(train or test).median(numeric_only=True)
    thrust = settings["thrust"]
    conditions: dict[str, Any] = {"thrust": thrust, "air": Air(density=float(flown["density"]))}
    results: dict[str, Any] = {}
    try:
        climb = None if thrust is None else 0.0
        results["trim"] = trim(
            pipeline, aircraft, float(flown["airspeed"]), climb=climb, **conditions
        )
        state_and_inputs: tuple = (results["trim"],)
    except ValueError:
        results["note"] = (
            f"No steady flight was found at {flown['airspeed']:.3g} m/s: derivatives are at the "
            f"median state, without modes."
        )
        state, alpha = np.zeros(13), float(flown.get("alpha", 0.0))  # wings level
        state[[3, 5, 6]] = flown["airspeed"] * np.cos(alpha), flown["airspeed"] * np.sin(alpha), 1.0
        state_and_inputs = state, {str(name): float(value) for name, value in flown.items()}
    try:
        results["derivatives"] = stability_derivatives(
            pipeline, aircraft, *state_and_inputs, **conditions
        )
        if "least_squares" in fit:
            model = _least_squares(pipeline, fit["least_squares"])
            linear = stability_derivatives(model, aircraft, *state_and_inputs, **conditions)
            results["least_squares"] = linear[["value"]]
        if "trim" in results:
            n_paths = N_PATHS if as_aerodynamics(pipeline).is_uncertain else 0
            results["modes"] = linearize(
                pipeline, aircraft, *state_and_inputs, n_paths=n_paths, **conditions
            ).modes()
    except ValueError as error:
        results["note"] = f"No derivatives: {error}"
    try:
        flown_states = [reconstructed(pipeline, table) for table in test]
        results["simulation"] = simulation_errors(pipeline, aircraft, flown_states, settings)
        results["simulated"] = simulated_flight(pipeline, aircraft, flown_states, settings)
    except ValueError as error:
        results["simulation_note"] = str(error)
    return FlightMechanics(**results)


def reconstructed(pipeline: Pipeline, table: pd.DataFrame) -> pd.DataFrame:
    """Return a flight with its logged inputs, and reconstructed states and wind; unchanged without reconstruction."""
    steps = getattr(pipeline, "named_steps", {})
    if not getattr(steps.get("flightpathreconstruction"), "used_", False):
        return table
    first_steps = pipeline[: 1 + list(steps).index("flightpathreconstruction")]
    with without_warnings():  # the evaluation has shown them
        motion = first_steps.transform(table)
    return table.assign(**motion.drop(columns=[*ALL_SURFACES], errors="ignore"))


def _air(parts: Sequence[pd.DataFrame]) -> Air:
    """Return the density of parts of flights, and their estimated wind with its gusts, where it is known."""
    density = float(np.median(np.concatenate([part["density"] for part in parts])))
    known = all({*WIND, "psi"} <= {*part} for part in parts)
    return Air([part[["time", *WIND]] for part in parts] if known else None, density=density)


def _least_squares(pipeline: Pipeline, fitted: Mapping[str, Mapping[str, float]]) -> Aerodynamics:
    """Return the linear model of the same rows."""
    model = as_aerodynamics(pipeline)
    table = pd.DataFrame(fitted)[list(COEFFICIENTS)]
    intercept, slopes = (table.loc[rows].to_numpy() for rows in ("intercept", [*model.regressors]))
    unknown: dict[str, Any] = dict.fromkeys(("sampler", "drift", "narrowing", "function_errors"))
    return replace(
        model,
        function=lambda X: intercept + X @ slopes,
        slopes=lambda X: np.broadcast_to(slopes.T, (*X.shape[:-1], *slopes.T.shape)),
        **unknown,
    )


def simulation_errors(
    pipeline: Pipeline, aircraft: Aircraft, tables: Sequence[pd.DataFrame], settings: dict
) -> pd.DataFrame:
    """Return how long a simulation with the recorded controls follows flights from their measured states, by state.

    It flies in the estimated wind and gusts, else in still air, and is started again every longest
    horizon. Columns: ``spread``, the standard
    deviation in the flights; ``limit``, `skdgp.report.THRESHOLDS.error` times that, or three times
    the noise of the sensor if that is more; ``error``, root mean square at the end; ``lasts``, the
    time [s] at which the error passes the limit, at most ``horizon``; ``lasts_without_gusts``, the
    same for the part of the error that ``gusts`` [m/s], where they are not estimated, do not
    explain. Raises ValueError if it cannot be simulated.
    """
    if settings["external_forces"]:
        raise ValueError(
            "the flights have loads that a simulation lacks: "
            f"{', '.join(settings['external_forces'])}"
        )
    lacking = [name for name in STATES if not all(name in table for table in tables)]
    if lacking:
        raise ValueError(f"the flights lack {', '.join(lacking)}, from which a simulation starts")
    starts, parts = _windows(tables, max(settings["horizons"]))
    flown = _flown(pipeline, aircraft, starts, parts, settings)
    elapsed = flown["time"].to_numpy()[: len(flown) // len(parts)]
    measured = np.array(
        [[np.interp(elapsed, part["time"], part[name]) for name in STATES] for part in parts]
    )
    shape = len(parts), len(elapsed), len(STATES)
    simulated = flown[list(STATES)].to_numpy().reshape(shape).swapaxes(1, 2)
    squares = np.nan_to_num(simulated - measured, nan=np.inf) ** 2  # inf where it ended
    met = _unknown_gusts(pipeline, aircraft, tables, parts)
    gusts = np.zeros(simulated.shape[1:])
    if met is not None:
        several = max(1, MOST_STARTS // len(parts))
        mean = as_aerodynamics(pipeline)  # whose paths differ by the gusts alone
        exact: dict[str, Any] = {
            "sampler": lambda n_paths, random_state: (mean, mean.gradient),
            **dict.fromkeys(("drift", "narrowing", "function_errors")),
        }
        model = replace(mean, function=mean, slopes=mean.gradient, **exact)
        drawn = _flown(model, aircraft, starts, parts, settings, gusts=met, n_paths=several)
        paths = drawn[list(STATES)].to_numpy().reshape(several, *shape).swapaxes(2, 3)
        gusts = np.nan_to_num((paths - simulated) ** 2).mean(axis=(0, 1))
    edges = np.unique(np.arange(PARTS) * len(elapsed) // PARTS)
    counts = np.diff([*edges, len(elapsed)])
    total, explained = (
        np.add.reduceat(each, edges, axis=1) / counts for each in (squares.mean(axis=0), gusts)
    )
    spread = np.median([np.nanstd(unwrapped(table, STATES), axis=0) for table in tables], axis=0)
    levels = [noise_level(unwrapped(table, STATES), table["time"]) for table in tables]
    noise = np.nan_to_num(pd.DataFrame(levels).median())  # of short flights not known
    limit = np.maximum(THRESHOLDS.error * spread, 3 * noise)
    ends = np.append(elapsed[edges], elapsed[-1])

    def lasts(squared):
        late = np.column_stack([squared > limit[:, None] ** 2, np.ones(len(STATES), bool)])
        return ends[late.argmax(axis=1)]

    columns = {
        "spread": spread,
        "limit": limit,
        "error": np.sqrt(total[:, -1]),
        "lasts": lasts(total),
        "lasts_without_gusts": lasts(total - explained),
        "gusts": 0.0 if met is None else float(np.sqrt(np.mean(np.square(met.intensity)))),
        "horizon": elapsed[-1],
    }
    return pd.DataFrame(columns, index=list(STATES))


def _unknown_gusts(
    pipeline: Pipeline,
    aircraft: Aircraft,
    tables: Sequence[pd.DataFrame],
    parts: Sequence[pd.DataFrame],
) -> Turbulence | None:
    """Return the gusts that a simulation of these parts lacks, else those of the training flights; None if known."""
    if _air(parts).wind is not None:
        return None
    named = [table.assign(flight=str(k)) for k, table in enumerate(tables)]
    try:
        return Turbulence.from_flight(pd.concat(named), aircraft.span)
    except ValueError:  # they are too short, or lack attitude or velocity
        return as_aerodynamics(pipeline).turbulence


def simulated_flight(
    pipeline: Pipeline, aircraft: Aircraft, tables: Sequence[pd.DataFrame], settings: dict
) -> TimeHistoryDisplay:
    """Return the simulation of the middle one of the parts of `simulation_errors`, with its band, and as flown."""
    starts, parts = _windows(tables, max(settings["horizons"]))
    k = len(starts) // 2
    flight = (pipeline, aircraft, starts[k : k + 1], parts[k : k + 1], settings)
    mean = paths = _flown(*flight)
    if as_aerodynamics(pipeline).is_uncertain:
        paths = _flown(*flight, n_paths=SHOWN_PATHS)
    return TimeHistoryDisplay.from_trajectories(
        paths,
        parts[k],
        mean=mean,
        columns=[name for name in SHOWN_STATES if name in parts[k]],
        ax=False,
    )


def _flown(
    model: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    starts: pd.DataFrame,
    parts: list[pd.DataFrame],
    settings: dict,
    gusts: Turbulence | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Return a simulation of parts of flights with their controls, in their air or drawn gusts."""
    air = _air(parts)
    with without_warnings(SimulationWarning):  # an end is an error without bound
        return simulate(
            model,
            aircraft,
            starts,
            [
                part.drop(columns=[*STATES, *WIND, "flight", "psi"], errors="ignore")
                for part in parts
            ],
            dt=FLIGHT_STEP,
            duration=min(float(part["time"].iloc[-1]) for part in parts),
            thrust=settings["thrust"],
            air=air if gusts is None else replace(air, gusts=gusts),
            **options,
        )


def _windows(
    tables: Sequence[pd.DataFrame], horizon: float
) -> tuple[pd.DataFrame, list[pd.DataFrame]]:
    """Return starts, and parts of flights without gaps, of nearly equal length; their time begins at zero.

    Starts are means over `START`. Angles do not jump.
    """
    runs = []
    for table in tables:
        names = [name for name in (*STATES, "psi") if name in table]
        smooth = table.assign(**dict(zip(names, unwrapped(table, names).T, strict=True)))
        runs += [
            smooth.iloc[run]
            for run in flight_segments(table["time"].to_numpy(float))
            if run.stop - run.start > 2
        ]
    horizon = min(
        horizon, float(np.median([np.ptp(run["time"]) for run in runs] or [0.0])) - START / 2
    )
    windows = []
    for run in runs:
        time = run["time"].to_numpy(float)
        for begin in np.arange(time[0] + START / 2, time[-1] - 0.95 * horizon, horizon):
            part = run[(time >= begin) & (time <= begin + horizon)]
            if len(part) > 2 and np.isfinite(part[list(STATES)].to_numpy(float)).all():
                first = part["time"].iloc[0]
                names = [*STATES, *(["psi"] if {*WIND, "psi"} <= {*run} else [])]
                start = run.loc[np.abs(time - first) <= START / 2, names].mean()
                if "psi" in start:
                    start["psi"] = wrapped(start["psi"])  # the flight turns more than once
                windows.append(
                    (start, part.assign(time=part["time"] - first).reset_index(drop=True))
                )
    if not windows or not horizon > 2 * FLIGHT_STEP:
        raise ValueError(
            f"the flights have no part of {horizon:.3g} s in which {', '.join(STATES)} are known"
        )
    spread = np.linspace(0, len(windows) - 1, min(MOST_STARTS, len(windows))).round().astype(int)
    starts, parts = zip(*(windows[k] for k in np.unique(spread)), strict=True)
    return pd.DataFrame(starts).reset_index(drop=True), list(parts)

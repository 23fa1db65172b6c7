"""JSBSim: aircraft folders with the aerodynamics of a model, as functions or as tables."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pandas as pd
from sklearn.utils import check_random_state

from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp._flight.channels import COEFFICIENTS, HAT, LENGTHS, RATE_LENGTHS
from skdgp._flight.checks import check_choice
from skdgp._mechanics.aerodynamics import scaling_of
from skdgp._mechanics.loads import CENTRED
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import BuildUp, Posterior, build_up
from skdgp.export._model import Block
from skdgp.export._pipeline import posterior_form
from skdgp.export._text import (
    Content,
    changes_text,
    element,
    file_name,
    identifiers,
    number_text,
    write_xml,
)
from skdgp.kernels._prior_paths import FeaturePaths, MixedPaths, SumPaths, TrendPaths

FOOT, POUND_FORCE = 0.3048, 4.4482216152605
SLUG, FOOT_POUND = POUND_FORCE / FOOT, POUND_FORCE * FOOT
CENTRE = (0.0, 0.0, 0.0)
AXES = {"CX": "X", "CY": "Y", "CZ": "Z", "Cl": "ROLL", "Cm": "PITCH", "Cn": "YAW"}
REFERENCES = {"Cl": ["metrics/bw-ft"], "Cm": ["metrics/cbarw-ft"], "Cn": ["metrics/bw-ft"]}
SURFACES = {
    "elevator": ("fcs/elevator-cmd-norm", "fcs/elevator-pos-rad"),
    "aileron": ("fcs/aileron-cmd-norm", "fcs/left-aileron-pos-rad"),
    "rudder": ("fcs/rudder-cmd-norm", "fcs/rudder-pos-rad"),
}
TRIMS = {
    "elevator": "fcs/pitch-trim-cmd-norm",
    "aileron": "fcs/roll-trim-cmd-norm",
    "rudder": "fcs/yaw-trim-cmd-norm",
}
THROTTLE, SPEED, AIRSPEED = "fcs/throttle-cmd-norm", "fcs/propeller_speed", "velocities/vt-fps"
SOURCES = {  # property and factor to SI units
    "alpha": ("aero/alpha-rad", 1.0),
    "beta": ("aero/beta-rad", 1.0),
    "alpha_dot": ("aero/alphadot-rad_sec", 1.0),
    "beta_dot": ("aero/betadot-rad_sec", 1.0),
    "p": ("velocities/p-aero-rad_sec", 1.0),
    "q": ("velocities/q-aero-rad_sec", 1.0),
    "r": ("velocities/r-aero-rad_sec", 1.0),
    "airspeed": (AIRSPEED, FOOT),
    "density": ("atmosphere/rho-slugs_ft3", SLUG / FOOT**3),
    "altitude": ("position/h-sl-ft", FOOT),
    "u": ("velocities/u-fps", FOOT),
    "v": ("velocities/v-fps", FOOT),
    "w": ("velocities/w-fps", FOOT),
    "phi": ("attitude/phi-rad", 1.0),
    "theta": ("attitude/theta-rad", 1.0),
    "psi": ("attitude/psi-rad", 1.0),
    "throttle": (THROTTLE, 1.0),
    **{name: (position, 1.0) for name, (_, position) in SURFACES.items()},
}
IMPLICIT = ("p_dot", "q_dot", "r_dot", "ax", "ay", "az")
NOTE = """
 Made by skdgp from flights. Forces act along body axes (x forward, y right, z down) at the centre of gravity, which is
 the origin. Properties of the aerodynamics:
   aero/regressor/NAME    regressors, SI units and radians, or the unit of the control; NAME_hat: non-dimensional rate
   aero/coefficient/CX    coefficients CX CY CZ Cl Cm Cn
 Signs: elevator > 0 pitches down, aileron > 0 rolls right, rudder > 0 yaws left. A command of 1 is the largest
 deflection of the flights. Of a model with controls in parts of their full throw, -pos-rad holds these parts.
"""


def write_jsbsim(
    folder: str | os.PathLike,
    model: Any,
    aircraft: Aircraft,
    *,
    form: str = "functions",
    n_draws: int = 0,
    random_state: Seed = 0,
    tolerance: float = 0.1,
    max_loss: float = 0.25,
    **options: Any,
) -> list[Path]:
    """Write an aircraft that JSBSim loads, metrics, mass, inertia, thrust and aerodynamics; return the files.

    With ``form="functions"`` the coefficients are the posterior mean, and further aircraft are
    functions drawn from the posterior, sums of exponentials and cosines: those that
    ``sample_paths`` and ``simulate`` draw with the same ``random_state``. With ``form="tables"`` they are
    those of :func:`build_up`, faster and easier to read, where they lose at most ``max_loss``.

    ``jsbsim.FGFDMExec(str(folder)).load_model(NAME)`` loads ``folder/aircraft/NAME/NAME.xml``. The
    thrust is that of ``aircraft.propeller`` at ``fcs/throttle-cmd-norm``, which JSBSim's trim
    finds, or at ``fcs/propeller_speed`` [rad/s]; without a propeller it is the property
    ``external_reactions/thrust/magnitude`` [lbf]. Raises ValueError if a parameter is invalid, a
    regressor is no property of JSBSim (accelerations), or functions are needed of a kernel that is
    not a sum of Gaussian processes and a linear trend.

    Parameters
    ----------
    folder : path-like
        Created if it does not exist.
    model : DependentGPRegressor, Pipeline or BuildUp
        Fitted; a build-up is written as tables.
    aircraft : Aircraft
        Its name names the files.
    form : {"functions", "tables"}, default="functions"
    n_draws : int, default=0
        Number of further aircraft ``NAME_001``, ...: functions drawn from the posterior.
    random_state : int, RandomState or None, default=0
        Of the draws.
    tolerance : float, default=0.1
        As of :func:`build_up`; functions are exact.
    max_loss : float, default=0.25
        Largest loss of tables, as of :func:`build_up`; a coefficient that loses more is written as
        functions.
    **options
        Of :func:`build_up`, for tables.

    Returns
    -------
    list of Path
    """
    check_choice("form", form, ("functions", "tables"))
    if n_draws < 0:
        raise ValueError(f"Got n_draws={n_draws!r}, but expected a number of aircraft from 0 on.")
    if not isinstance(random_state, Integral):  # tables and functions are parts of the same draws
        random_state = check_random_state(random_state).randint(2**31 - 1)
    functions: list[GaussianSum] = []
    names: Sequence[str] = COEFFICIENTS  # that are written as functions
    build = model if isinstance(model, BuildUp) else None
    if build is None and form == "tables":
        build = build_up(model, aircraft, tolerance=tolerance, max_loss=np.inf, **options)
        ratio = build.loss["loss"] / build.loss["deviation"]
        names = list(ratio.index[ratio > max_loss])
    if model is not build and names:
        functions = gaussian_sums(
            model,
            aircraft,
            X=options.get("X"),
            tolerance=tolerance,
            n_draws=n_draws,
            random_state=random_state,
        )
    tables = [] if build is None else [build, *build.sample(n_draws, random_state)]
    paths = []
    for k in range(1 + n_draws):
        parts = {c: functions[k] if functions and c in names else tables[k] for c in COEFFICIENTS}
        own = file_name(aircraft.name) + (f"_{k:03d}" if k else "")
        paths.append(Path(folder, "aircraft", own, f"{own}.xml"))
        paths[-1].parent.mkdir(parents=True, exist_ok=True)
        root = jsbsim_config(own, parts, aircraft)
        ElementTree.indent(root, space=" ")
        write_xml(paths[-1], root)
    return paths


def jsbsim_config(
    name: str, parts: dict[str, BuildUp | GaussianSum], aircraft: Aircraft
) -> Element:
    """Return the file of an aircraft, with each coefficient of ``parts`` as tables or as functions."""
    names = identifiers(next(iter(parts.values())).regressors)
    parts = {
        c: replace(part, regressors=tuple(names[r] for r in part.regressors))
        for c, part in parts.items()
    }
    found = next(iter(parts.values()))
    loss = pd.concat([part.loss.loc[[coefficient]] for coefficient, part in parts.items()])
    lines = [
        *loss.to_string().splitlines(),
        f"Names: {text}" if (text := changes_text(names)) else "",
    ]
    controls = [
        r for r in found.regressors if r not in SOURCES and _rate(r) is None and r not in IMPLICIT
    ]
    has_engine = aircraft.propeller is not None and aircraft.propeller.speed_range is not None
    waves = {c: part for c, part in parts.items() if isinstance(part, GaussianSum)}
    aerodynamics: list[Element] = []
    for r in found.regressors:
        factors = _source(r, found.lengths, aircraft, controls)
        aerodynamics.append(_function(f"aero/regressor/{r}", _apply("product", *factors)))
    if waves:
        aerodynamics += _waves(next(iter(waves.values())), [COEFFICIENTS.index(c) for c in waves])
    for c, part in parts.items():
        aerodynamics += _gaussians(part, c) if isinstance(part, GaussianSum) else [_tables(part, c)]
    return element(
        "fdm_config",
        ElementTree.Comment(NOTE + "".join(f"   {line}\n" for line in lines)),
        element(
            "fileheader", element("description", f"{aircraft.name}, learned from flights by skdgp")
        ),
        _metrics(aircraft),
        _mass(aircraft),
        element("ground_reactions"),
        _thrust(aircraft),
        *([_engine()] if has_engine else []),
        _controls(found, [*([] if has_engine else [THROTTLE]), *(f"fcs/{c}" for c in controls)]),
        element("aerodynamics", *aerodynamics, *map(_load, COEFFICIENTS)),
        name=name,
        version="2.0",
        release="BETA",
    )


class Cosines(NamedTuple):
    """Functions of a draw of the prior: sum_k w_ik cos(phase_k + omega_k . z); omega (k, d), phase (k,), w (6, k)."""

    frequencies: Matrix
    phases: Vector
    weights: Matrix


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianSum:
    """The coefficients at z = (x - shift) / scale: constant + slopes . z + Gaussian functions + waves."""

    regressors: tuple[str, ...]
    lengths: tuple[float, float]
    limits: Matrix
    shift: Vector
    scale: Vector
    constants: Vector
    slopes: Matrix
    centres: Matrix
    blocks: list[list[tuple[Block, Vector]]]
    """Gaussian functions of each coefficient, and their weights."""
    waves: Cosines
    loss: pd.DataFrame

    def evaluate(self, X: Matrix) -> Matrix:
        """Return the coefficients (n, 6) at X (n, d)."""
        z = (np.asarray(X, dtype=float) - self.shift) / self.scale
        values = self.constants + z @ self.slopes.T
        values += np.cos(z @ self.waves.frequencies.T + self.waves.phases) @ self.waves.weights.T
        for i, blocks in enumerate(self.blocks):
            for block, weights in blocks:
                values[:, i] += block.functions(z, self.centres[block.rows]) @ weights
        return values


def gaussian_sums(
    model: Any,
    aircraft: Aircraft,
    *,
    X: Any = None,
    tolerance: float = 0.1,
    n_draws: int = 0,
    random_state: Seed = 0,
) -> list[GaussianSum]:
    """Return the posterior mean of a model, then functions drawn from its posterior, those of ``sample_paths``."""
    posterior = Posterior(model, X)
    original = posterior.mean(posterior.tested)
    deviation = np.sqrt(np.mean(posterior.deviation(posterior.tested) ** 2, axis=0))
    try:
        form = posterior_form(posterior.regressor.posterior_)
    except ValueError as error:
        raise ValueError(f"{error} Or use form='tables' with max_loss=np.inf.") from error
    if any(block.root.ndim == 2 for block in form["blocks"]):
        raise ValueError(
            "Got filters of covariance_type='full', but expected 'diag': use form='tables' with "
            "max_loss=np.inf."
        )
    shift, scale, others = scaling_of(posterior.scalers[::-1], len(posterior.names))
    if others:
        raise ValueError(
            f"Got {type(others[0]).__name__}, but expected a scaler such as StandardScaler: use "
            f"form='tables'."
        )
    shares, d = form["mixture"].ravel(), len(posterior.names)
    weights = [
        share * form["readouts"][k].weights
        for share, k in zip(shares, form["readout_of"], strict=True)
    ]
    trend = shares[:, None] * form["trend_weights"]
    mean = GaussianSum(
        regressors=tuple(posterior.names),
        lengths=posterior.lengths(aircraft),
        limits=posterior.limits,
        shift=shift,
        scale=scale,
        **_terms(posterior, form, weights, trend),
        waves=Cosines(np.empty((0, d)), np.empty(0), np.empty((len(COEFFICIENTS), 0))),
        loss=pd.DataFrame(),
    )
    off = np.sqrt(np.mean((mean.evaluate(posterior.tested) - original) ** 2, axis=0))
    mean = replace(
        mean, loss=pd.DataFrame({"loss": off, "deviation": deviation}, index=list(COEFFICIENTS))
    )
    if not n_draws:
        return [mean]
    if posterior.regressor.inference_ == "exact":
        raise ValueError(
            "Got draws of a model with exact inference, but expected inference='sparse', whose "
            "draws are sums of few functions."
        )
    bundle = posterior.regressor.sample_paths(n_draws, random_state).bundle
    if not isinstance(bundle, MixedPaths):
        bundle = MixedPaths([bundle], np.zeros((n_draws, form["mixture"].shape[1]), dtype=int))
    return [mean, *_drawn(mean, posterior, form, weights, trend, bundle)]


def _terms(
    posterior: Posterior, form: dict[str, Any], weights: list[Vector], trend: Matrix
) -> dict[str, Any]:
    """Return what the parts add up to, for weights of their basis and trend."""
    order, scale, P = posterior.order, posterior.scale, form["mixture"].shape[1]
    blocks: list[list[tuple[Block, Vector]]] = [[] for _ in range(P)]
    for block in form["blocks"]:
        i, own = block.output % P, weights[block.output][block.columns]
        if own.any():
            blocks[i].append((replace(block, gain=posterior.regressor.scale_[i] * block.gain), own))
    trend = trend.reshape(-1, P, trend.shape[1]).sum(axis=0)
    constants = trend[:, 0] - trend[:, 1:] @ form["trend_center"]
    return {
        "constants": posterior.regressor.center_[order] + constants[order] * scale,
        "slopes": trend[order, 1:] * scale[:, None],
        "centres": form["centres"],
        "blocks": [blocks[i] for i in order],
    }


def _drawn(mean, posterior, form, weights, trend, bundle: MixedPaths) -> Iterator[GaussianSum]:
    """Yield draws: waves of the prior, and the functions of the mean with weights of their own (Matheron's rule).

    Each output of a draw is that of one member of an average. A draw f of a calibrated model with
    the mean m is m + s (f - m), with s its factor of the deviation.
    """
    regressor, order, (K, P) = posterior.regressor, posterior.order, form["mixture"].shape
    s = posterior.factors / regressor.scale_
    kept = 1.0 - np.tile(s, K)
    for k, member_of in enumerate(bundle.member):
        lines = kept[:, None] * trend
        of_basis = [share * own for share, own in zip(kept, weights, strict=True)]
        waves = [mean.waves]
        for member, (paths, rows) in enumerate(zip(bundle.bundles, bundle.rows, strict=True)):
            taken, row = s * (member_of == member), int(np.searchsorted(rows, k))
            if not taken.any():
                continue
            gaussians: list[Any] = [np.empty((P, 0))]
            for leaf in _leaves(paths):
                if isinstance(leaf, TrendPaths):
                    drawn = np.hstack([leaf._intercept[row].T, leaf._slope[row].T])
                    lines[member * P : (member + 1) * P] += taken[:, None] * drawn
                elif isinstance(leaf, FeaturePaths):
                    gaussians.append([own[row] for own in leaf._weights])
                else:
                    own = leaf.own[row, 0][:, :, None] * leaf.fed[:, None]
                    of_prior = np.concatenate([leaf.shared[row], own.reshape(-1, len(order))])[
                        :, order
                    ]
                    of_prior = of_prior * (taken * regressor.scale_)[order]
                    waves.append(Cosines(leaf.omega[row].T, leaf.phase[row, 0], of_prior.T))
            for i in np.flatnonzero(taken):
                of_basis[member * P + i] += taken[i] * np.concatenate([own[i] for own in gaussians])
        frequencies, phases, of_waves = zip(*waves, strict=True)
        joined = Cosines(np.concatenate(frequencies), np.concatenate(phases), np.hstack(of_waves))
        yield replace(mean, **_terms(posterior, form, of_basis, lines), waves=joined)


def _leaves(bundle: Any) -> Iterator[Any]:
    """Yield the terms of a sum of paths."""
    if isinstance(bundle, SumPaths):
        yield from _leaves(bundle.first)
        yield from _leaves(bundle.second)
    else:
        yield bundle


def _metrics(aircraft: Aircraft) -> Element:
    return element(
        "metrics",
        element("wingarea", aircraft.wing_area, unit="M2"),
        element("wingspan", aircraft.span, unit="M"),
        element("chord", aircraft.chord, unit="M"),
        *(
            _vector("location", CENTRE, name=place, unit="M")
            for place in ("AERORP", "EYEPOINT", "VRP")
        ),
    )


def _mass(aircraft: Aircraft) -> Element:
    """Return mass and inertia: JSBSim reads Ixy and Iyz in structural axes (x aft, z up), Ixz as the tensor's entry."""
    J = aircraft.inertia
    entries = {
        "ixx": J[0, 0],
        "iyy": J[1, 1],
        "izz": J[2, 2],
        "ixy": -J[0, 1],
        "ixz": J[0, 2],
        "iyz": -J[1, 2],
    }
    return element(
        "mass_balance",
        *(element(tag, value, unit="KG*M2") for tag, value in entries.items()),
        element("emptywt", aircraft.mass, unit="KG"),
        _vector("location", CENTRE, name="CG", unit="M"),
        negated_crossproduct_inertia="true",
    )


def _thrust(aircraft: Aircraft) -> Element:
    line, propeller = aircraft.thrust_line or CENTRED, aircraft.propeller
    x, y, z = map(float, line.position)
    at = [_vector("location", (-x, y, -z), unit="M"), _vector("direction", line.direction)]
    if propeller is None:
        return element("external_reactions", element("force", *at, name="thrust", frame="BODY"))
    loads = propeller.thrust_coefficients, propeller.torque_coefficients
    thrust = _propeller("propulsion/thrust-lbs", propeller, loads[0], 4, 1.0 / POUND_FORCE)
    parts = [element("force", thrust, *at, name="thrust", frame="BODY")]
    if loads[1]:
        torque = _propeller(
            "propulsion/torque-lbsft", propeller, loads[1], 5, -propeller.rotation / FOOT_POUND
        )
        parts.append(
            element(
                "moment",
                torque,
                _vector("direction", line.direction),
                name="propeller",
                frame="BODY",
            )
        )
    return element("external_reactions", element("property", SPEED), *parts)


def _propeller(
    name: str, propeller: Any, coefficients: Sequence[float], power: int, factor: float
) -> Element:
    """Return the function rho D^power (c0 n^2 + c1 n V / D + c2 V^2 / D^2), n in revolutions per second."""

    def turns():
        if propeller.speed_range is None:
            return _apply("product", 0.5 / np.pi, SPEED)
        idle, full = (speed / (2 * np.pi) for speed in propeller.speed_range)
        return _apply("sum", idle, _apply("product", full - idle, THROTTLE))

    terms = [
        _apply(
            "product",
            c * (FOOT / propeller.diameter) ** k,
            *[AIRSPEED] * k,
            *(turns() for _ in range(2 - k)),
        )
        for k, c in enumerate(coefficients)
    ]
    scale = factor * propeller.diameter**power * SLUG / FOOT**3
    return _function(
        name, _apply("product", scale, "atmosphere/rho-slugs_ft3", _apply("sum", *terms))
    )


def _engine() -> Element:
    """Return an engine without power: JSBSim's trim moves the throttles of its engines, and no other property."""
    power = element("electric_engine", element("power", 0.0, unit="WATTS"), name="throttle")
    thruster = element(
        "thruster", element("direct", name="none"), _vector("location", CENTRE, unit="M")
    )
    return element("propulsion", element("engine", power, thruster))


def _controls(found: BuildUp | GaussianSum, properties: Sequence[str]) -> Element:
    parts = []
    for name, (command, position) in SURFACES.items():
        if name in found.regressors:
            largest = float(np.abs(found.limits[:, found.regressors.index(name)]).max())
            inputs = [
                element("input", place) for place in (command, TRIMS[name])
            ]  # JSBSim trims by the second
            parts += [
                element("summer", *inputs, name=f"fcs/{name}-sum"),
                element(
                    "aerosurface_scale",
                    element("input", f"fcs/{name}-sum"),
                    element("range", element("min", -largest), element("max", largest)),
                    element("output", position),
                    name=f"fcs/{name}-scale",
                ),
            ]
    settable = [element("property", name, value="0") for name in properties]
    return element(
        "flight_control", *settable, element("channel", *parts, name="surfaces"), name="surfaces"
    )


def _rate(regressor: str) -> str | None:
    """Return the rate of which a regressor is the non-dimensional form."""
    name = regressor.removesuffix(HAT)
    return name if regressor.endswith(HAT) and name in LENGTHS else None


def _source(
    regressor: str, lengths: tuple[float, float], aircraft: Aircraft, controls: Sequence[str]
) -> list:
    """Return the factors whose product is a regressor: numbers and properties."""
    if regressor in controls:
        return [f"fcs/{regressor}"]
    rate = _rate(regressor)
    if (rate or regressor) in IMPLICIT:
        raise ValueError(
            f"Got a model with the regressor {regressor!r}, an acceleration, which follows from "
            f"the loads: fit one "
            "with regressors='quasi-steady'."
        )
    name, factor = SOURCES[rate or regressor]
    if rate is None:
        return [name, factor] if factor != 1.0 else [name]
    if RATE_LENGTHS[rate] == "span":
        return [name, "aero/bi2vel", lengths[0] / aircraft.span]
    return [name, "aero/ci2vel", lengths[1] / aircraft.chord]


def _load(coefficient: str) -> Element:
    """Return the force or the moment of a coefficient."""
    axis, lengths = AXES[coefficient], REFERENCES.get(coefficient, [])
    factors = ["aero/qbar-psf", "metrics/Sw-sqft", *lengths, f"aero/coefficient/{coefficient}"]
    load = _function(f"aero/{'moment' if lengths else 'force'}/{axis}", _apply("product", *factors))
    return element("axis", load, name=axis, **({} if lengths else {"unit": "LBS"}))


def _tables(found: BuildUp, coefficient: str) -> Element:
    std = ", ".join(f"{r} {v:.2g}" for r, v in found.derivatives_std.loc[coefficient].items())
    text = f" standard deviations: constant {found.constants_std[coefficient]:.2g}, {std} "
    slopes = found.derivatives.loc[coefficient].to_numpy()
    terms: list[Any] = [found.constants[coefficient] - slopes @ found.reference]
    for regressor, slope in zip(found.regressors, slopes, strict=True):
        terms.append(_apply("product", slope, f"aero/regressor/{regressor}"))
    for table in found.tables[coefficient]:
        axes = zip(("row", "column"), table.regressors, strict=False)
        cells = table.values if table.values.ndim == 2 else table.values[:, None]
        lines = [
            " ".join(map(number_text, row))
            for row in np.column_stack([table.breakpoints[0], cells])
        ]
        if len(table.breakpoints) == 2:
            lines.insert(0, " ".join(map(number_text, table.breakpoints[1])))
        terms.append(
            element(
                "table",
                *(
                    element("independentVar", f"aero/regressor/{r}", lookup=axis)
                    for axis, r in axes
                ),
                element("tableData", "\n" + "\n".join(lines) + "\n"),
                name=f"aero/table/{coefficient}/{'-'.join(table.regressors)}",
            )
        )
    return _function(
        f"aero/coefficient/{coefficient}", ElementTree.Comment(text), _apply("sum", *terms)
    )


def _waves(found: GaussianSum, outputs: Sequence[int]) -> Iterator[Element]:
    """Yield scaled regressors, and the waves of some coefficients."""
    for regressor, shift, scale in zip(found.regressors, found.shift, found.scale, strict=True):
        away = _apply("difference", f"aero/regressor/{regressor}", shift)
        yield _function(f"aero/scaled/{regressor}", _apply("product", 1.0 / scale, away))
    frequencies, phases, weights = found.waves
    for k in np.flatnonzero(weights[outputs].any(axis=0)):
        phase = _apply("sum", *_plane(phases[k], frequencies[k], found.regressors))
        yield _function(f"aero/wave-{k}", _apply("cos", phase))


def _gaussians(found: GaussianSum, coefficient: str) -> Iterator[Element]:
    """Yield the parts of a coefficient and their sum; exponentials of a part share the square of the regressors."""
    i = COEFFICIENTS.index(coefficient)
    names = [f"aero/scaled/{regressor}" for regressor in found.regressors]
    for k, (block, weights) in enumerate(found.blocks[i]):
        square, used = f"aero/square/{coefficient}-{k}", list(block.regressors)
        centres, curvature = found.centres[block.rows] + block.shift, np.zeros(len(names))
        curvature[used] = block.root[used] ** 2
        squares = (_apply("product", -0.5 * curvature[n], names[n], names[n]) for n in used)
        yield _function(square, _apply("sum", *squares))
        terms = []
        for weight, constant, slopes in zip(
            block.gain * weights, -0.5 * centres**2 @ curvature, centres * curvature, strict=True
        ):
            exponent = _apply("sum", square, *_plane(constant, slopes, found.regressors))
            terms.append(_apply("product", weight, _apply("exp", exponent)))
        yield _function(f"aero/part/{coefficient}-{k}", _apply("sum", *terms))
    own = found.waves.weights[i]
    total = _apply(
        "sum",
        *(f"aero/part/{coefficient}-{k}" for k in range(len(found.blocks[i]))),
        *_plane(found.constants[i], found.slopes[i], found.regressors),
        *(_apply("product", own[wave], f"aero/wave-{wave}") for wave in np.flatnonzero(own)),
    )
    yield _function(f"aero/coefficient/{coefficient}", total)


def _plane(constant: float, slopes: Vector, regressors: Sequence[str]) -> list[float | Element]:
    """Return the terms constant + slopes . z."""
    named = zip(slopes, regressors, strict=True)
    return [
        constant,
        *(_apply("product", slope, f"aero/scaled/{name}") for slope, name in named if slope != 0.0),
    ]


def _apply(operator: str, *operands: Content) -> Element:
    """Return an operation of numbers, properties and others; JSBSim complains of sums and products of one."""
    parts = [
        o if isinstance(o, Element) else element("p" if isinstance(o, str) else "v", o)
        for o in operands
    ]
    return (
        parts[0]
        if len(parts) == 1 and operator in ("sum", "product")
        else element(operator, *parts)
    )


def _function(name: str, *content: Content) -> Element:
    return element("function", *content, name=name)


def _vector(tag: str, values: Sequence[float], **attributes: str) -> Element:
    return element(tag, *map(element, "xyz", values), **attributes)

"""The model as an FMU for co-simulation, FMI 2.0 or 3.0: C source, its description, and a binary for this platform."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from string import Template
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from skdgp._compute.files import write_atomically
from skdgp._flight import atmosphere
from skdgp._flight.channels import (
    BODY_VELOCITY,
    CHANNELS,
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    THRUST_FORCES,
    THRUST_MOMENTS,
    TRUTH_SUFFIX,
    WIND,
)
from skdgp._flight.checks import check_choice
from skdgp._mechanics.loads import CENTRED, thrust_control
from skdgp._mechanics.motion import CONTROLS, IMPLICIT, STATES
from skdgp._mechanics.record import FASTEST, SLOWEST, SPINNING
from skdgp.export._c import _array, _braces, _names, _template, c_files
from skdgp.export._model import PortableModel
from skdgp.export._text import changes_text, check_distinct, element
from skdgp.io import FULL_THROW

FMU_FILES = {"aircraft": "aircraft.fmu", "coefficients": "aero.fmu"}
"""The file of each form; its stem is the model identifier."""
ROOTS = {"2.0": "fmi2.c", "3.0": "fmi3.c"}
"""The source of each version of FMI that includes the others."""
TIME_STEP, STOP_TIME = 0.02, 10.0
START_ALTITUDE = 1000.0
START_AIRSPEED = 20.0
SLOWEST_START, FASTEST_START = 5.0, 250.0
COMPILERS = ("cc", "gcc", "clang")
BASE_UNITS: dict[str, dict[str, str]] = {
    "s": {"s": "1"},
    "m": {"m": "1"},
    "m/s": {"m": "1", "s": "-1"},
    "m/s^2": {"m": "1", "s": "-2"},
    "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "rad/s^2": {"rad": "1", "s": "-2"},
    "kg/m^3": {"kg": "1", "m": "-3"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N m": {"kg": "1", "m": "2", "s": "-2"},
    FULL_THROW: {},
}
FOLLOWING = (
    *(*EARTH_VELOCITY, "airspeed", "alpha", "beta", "altitude", "density"),
    *(*IMPLICIT, *COEFFICIENTS, *(f"{name}_std" for name in COEFFICIENTS), "beyond"),
)
"""Outputs of an aircraft besides its state."""
MEANINGS = {
    "dt": "largest step of the integrator, by Runge and Kutta",
    "beyond": "number of regressors outside of what the model was learned from",
}


class _Variable(NamedTuple):
    """A variable of the FMU: its kind is t time, s start and state, p parameter, i input, o output, d deviation."""

    name: str
    kind: str
    start: float = 0.0
    own_unit: str = ""

    @property
    def channel(self) -> str:
        """The column of a flight that it is."""
        return self.name.removesuffix("_std" if self.kind == "d" else TRUTH_SUFFIX)

    @property
    def unit(self) -> str:
        """Its unit, or ""."""
        if self.own_unit:
            return self.own_unit
        return (
            "s"
            if self.name == "dt"
            else CHANNELS[self.channel].unit
            if self.channel in CHANNELS
            else ""
        )

    @property
    def meaning(self) -> str:
        """Its description, or ""."""
        meaning = (
            CHANNELS[self.channel].meaning
            if self.channel in CHANNELS
            else MEANINGS.get(self.name, "")
        )
        return f"standard deviation: {meaning}" if self.kind == "d" else meaning


def write_fmu(
    path: str | os.PathLike[str], model: PortableModel, *, form: str = "aircraft", fmi: str = "2.0"
) -> str | None:
    r"""Write a model as an FMU for co-simulation; return the platform that it has a binary for.

    It holds C source, and a binary for this platform if there is a C compiler (``CC``, cc, gcc or
    clang); it needs no Python. Raises ValueError if ``form`` or ``fmi`` is none of these, the model
    is too large for C (see :func:`write_c`) or has a control of the name of another variable, or,
    for an aircraft, lacks a coefficient or has a regressor that a simulation cannot rebuild.

    Parameters
    ----------
    path : path-like
    model : PortableModel
    form : {"aircraft", "coefficients"}, default="aircraft"
        "aircraft": six degrees of freedom, as :func:`skdgp.dynamics.simulate` with at most ``dt`` a
        step. Inputs are the controls [rad], the thrust [N], further loads of the propulsion [N, N
        m] and the wind [m/s]; outputs the state, air data, accelerations, the coefficients and
        their standard deviations. "coefficients": the coefficients and their standard deviations,
        of columns of a flight.
    fmi : {"2.0", "3.0"}, default="2.0"
        Version of the standard.

    Returns
    -------
    str or None
        Such as "linux64", or "x86_64-linux" of FMI 3.0; None, with a warning why: the FMU has
        source code alone.
    """
    check_choice("form", form, FMU_FILES)
    check_choice("fmi", fmi, ROOTS)
    order = model.order if form == "aircraft" else None
    written, renamed = model.with_identifiers()
    variables = list(_aircraft(written) if form == "aircraft" else _coefficients(written))
    check_distinct((variable.name for variable in variables), "the FMU")
    content = repr((model.content_hash, model.aircraft.to_dict(), variables, form, fmi))
    token = "{" + hashlib.sha256(content.encode()).hexdigest()[:32] + "}"
    sources = {name: text for name, text in c_files(model).items() if name in ("aero.h", "aero.c")}
    sources |= {name: _template(name) for name in ("fmu.c", ROOTS[fmi])}
    values = _model_values(written, variables, order) | {"token": token}
    sources["model.c"] = Template(_template(f"fmu_{form}.c")).substitute(values)
    members: dict[str, str | bytes] = {f"sources/{name}": text for name, text in sources.items()}
    members["modelDescription.xml"] = _xml(
        _description(model, renamed, variables, form, fmi, token)
    )
    if fmi == "3.0":
        members["sources/buildDescription.xml"] = _xml(_build_description(form, fmi))
    found = _binary(sources, form, fmi)
    if found is not None:
        members[f"binaries/{found[0]}/{_identifier(form)}{found[1]}"] = found[2]

    def write(temporary: Path) -> None:
        with ZipFile(temporary, "w", ZIP_DEFLATED) as archive:
            for name, content in sorted(members.items()):
                member = ZipInfo(name)  # without a date: equal models are equal files
                member.external_attr = 0o644 << 16
                archive.writestr(member, content, ZIP_DEFLATED)

    write_atomically(path, write)
    return None if found is None else found[0]


def _identifier(form: str) -> str:
    return Path(FMU_FILES[form]).stem


def _coefficients(model: PortableModel) -> Iterator[_Variable]:
    """Yield the variables of the coefficients alone, in the order of their value references."""
    start = _starts(model)
    yield _Variable("time", "t")
    throws = _full_throws(model)
    yield from (
        _Variable(name, "i", start.get(name, 0.0), throws.get(name, "")) for name in model.columns
    )
    yield from (_Variable(name, "o") for name in model.outputs)
    yield from (_Variable(f"{name}_std", "d") for name in model.outputs)
    yield _Variable("beyond", "o")


def _aircraft(model: PortableModel) -> Iterator[_Variable]:
    """Yield the variables of the aircraft, in the order of their value references."""
    channels = [name.removesuffix(TRUTH_SUFFIX) for name in model.columns]
    controls = [name for name in channels if name not in (*STATES, *IMPLICIT)]
    unknown = [name for name in controls if name in CHANNELS and name not in CONTROLS]
    if unknown:
        raise ValueError(
            f"Got a model of {unknown}, which are neither controls nor rebuilt along a flight: "
            f"export "
            "form='coefficients', or learn a model without them."
        )
    start = _starts(model)
    yield _Variable("time", "t")
    for name in (*POSITION, *BODY_VELOCITY, *EULER, *RATES):
        yield _Variable(name, "s", start.get(name, 0.0))
    yield _Variable("dt", "p", TIME_STEP)
    yield from (_Variable(name, "d" if name.endswith("_std") else "o") for name in FOLLOWING)
    propulsion = _propulsion_control(model)
    inputs = (
        *WIND,
        *THRUST_FORCES,
        *THRUST_MOMENTS,
        *([propulsion] if propulsion else []),
        *controls,
    )
    throws = _full_throws(model)
    yield from (
        _Variable(name, "i", start.get(name, 0.0), throws.get(name, ""))
        for name in dict.fromkeys(inputs)
    )


def _full_throws(model: PortableModel) -> dict[str, str]:
    """Return the unit of controls that are in parts of their full throw, and of surfaces that make them."""
    parts = [each for each in model.regressors if each.unit == FULL_THROW]
    return {name.removesuffix(TRUTH_SUFFIX): FULL_THROW for each in parts for name in each.sources}


def _propulsion_control(model: PortableModel) -> str | None:
    """Return the input that sets the thrust; None where the coefficients include the thrust."""
    options = model.provenance.get("options") or {}
    return thrust_control(model.aircraft, "auto" if options.get("thrust", "auto") else None)


def _starts(model: PortableModel) -> dict[str, float]:
    """Return values near level flight at the mean of the training data: without any input, an FMU flies."""
    columns = [regressor for regressor in model.regressors if not regressor.power]
    mean = [
        value
        for value, regressor in zip(model.shift, model.regressors, strict=True)
        if not regressor.power
    ]
    names = list(dict.fromkeys(name for regressor in columns for name in regressor.sources))
    matrix = [
        [dict(zip(r.sources, r.factors, strict=True)).get(name, 0.0) for name in names]
        for r in columns
    ]
    start = (
        dict(zip(names, np.linalg.lstsq(matrix, mean, rcond=None)[0].tolist(), strict=True))
        if columns
        else {}
    )
    altitude = start.get("altitude", START_ALTITUDE)
    density = float(atmosphere.standard_density(altitude))
    lift = (
        -model.predict(model.shift[None])[0, model.outputs.index("CZ")]
        if "CZ" in model.outputs
        else 0.0
    )
    speed, aircraft = start.get("airspeed", START_AIRSPEED), model.aircraft
    if "airspeed" not in start and lift > 0:
        speed = np.sqrt(
            2 * aircraft.mass * atmosphere.STANDARD_GRAVITY / (density * aircraft.wing_area * lift)
        )
    speed, alpha = float(np.clip(speed, SLOWEST_START, FASTEST_START)), start.get("alpha", 0.0)
    start |= {
        "u": speed * float(np.cos(alpha)),
        "w": speed * float(np.sin(alpha)),
        "theta": alpha,
        "airspeed": speed,
    }
    return start | {"down": -altitude, "altitude": altitude, "density": density}


def _model_values(
    model: PortableModel, variables: list[_Variable], order: list[int] | None
) -> dict[str, Any]:
    """Return what the template of model.c is filled with; ``order`` is that of an aircraft's coefficients."""
    places = {variable.name: k for k, variable in enumerate(variables)}
    channels = [
        name if name in places else name.removesuffix(TRUTH_SUFFIX) for name in model.columns
    ]
    names = {f"V_{name}": k for name, k in places.items()}
    names |= {
        "FIRST_COEFFICIENT": places[model.outputs[0]],
        "FIRST_DEVIATION": places[f"{model.outputs[0]}_std"],
    }
    names["FMU_VARIABLES"] = len(variables)
    tables = [
        "enum { " + ",\n".join(f"{name} = {k}" for name, k in names.items()) + " };",
        "static " + _names("names", [v.name for v in variables]),
        f'static const char kind[FMU_VARIABLES + 1] = "{"".join(v.kind for v in variables)}";',
        _array("start", [v.start for v in variables]),
        _array("place", [places[name] for name in channels], "static const int"),
    ]
    if order is None:
        return {"tables": "\n".join(tables)}
    implicit = [k for k, name in enumerate(IMPLICIT) if name in channels]
    tables.append(_array("coefficient", order, "static const int"))
    if implicit:
        tables.append(_array("implicit", implicit, "static const int"))
    line = model.aircraft.thrust_line or CENTRED
    arrays = {
        "base": atmosphere.BASE,
        "lapse": atmosphere.LAPSE,
        "direction": line.direction,
        "arm": line._arm,
    }
    arrays |= {"temperature": atmosphere._TEMPERATURE, "pressure": atmosphere._PRESSURE}
    arrays |= {"inertia": model.aircraft.inertia, "inverse": model.aircraft.inertia_inverse}
    numbers = {
        "gas": atmosphere.GAS_CONSTANT,
        "gravity": atmosphere.STANDARD_GRAVITY,
        "fastest": FASTEST,
    }
    numbers |= {"lowest": atmosphere.LOWEST, "highest": atmosphere.HIGHEST, "spinning": SPINNING}
    texts = {
        "tables": "\n".join(tables),
        "propulsion": _propulsion(model, places),
        "slowest": f"{SLOWEST:g}",
    }
    texts |= {name: _braces(array) for name, array in arrays.items()}
    return (
        texts
        | {name: repr(value) for name, value in numbers.items()}
        | {"n_implicit": len(implicit)}
    )


def _propulsion(model: PortableModel, places: dict[str, int]) -> str:
    """Return the statements that set the thrust and the torque on the aircraft."""
    control, propeller = _propulsion_control(model), model.aircraft.propeller
    if control is None:
        return ""
    value = f"v[{places[control]}]"
    if propeller is None:
        return f"    thrust = {value};"
    if control == "throttle" and propeller.speed_range is not None:
        idle, full = propeller.speed_range
        value = f"({idle!r} + {full - idle!r} * {value})"
    lines = [
        f"    const double n = {value} / {2 * np.pi!r}, advance = v[V_airspeed] / "
        f"{propeller.diameter!r};"
    ]
    for load, sign, coefficients, power in (
        ("thrust", 1.0, propeller.thrust_coefficients, 4),
        ("torque", -float(propeller.rotation), propeller.torque_coefficients, 5),
    ):
        c0, c1, c2 = (*coefficients, 0.0, 0.0, 0.0)[:3]
        scale = sign * propeller.diameter**power
        formula = f"(({c0!r} * n + {c1!r} * advance) * n + {c2!r} * advance * advance)"
        lines.append(f"    {load} = {scale!r} * v[V_density] * {formula};")
    return "\n".join(lines)


def _binary(sources: dict[str, str], form: str, fmi: str) -> tuple[str, str, bytes] | None:
    """Return the platform, the suffix and the bytes of the shared library; None without one, with a warning."""
    commands = [os.environ.get("CC", "").split(), *([name] for name in COMPILERS)]
    compiler = next((command for command in commands if command and shutil.which(command[0])), None)
    place = _platform(fmi)
    if place is None:
        why = "FMI has no name for this platform"
    elif compiler is None:
        why = f"there is no C compiler ({', '.join(COMPILERS)})"
    else:
        with tempfile.TemporaryDirectory() as folder:
            for name, text in sources.items():
                (Path(folder) / name).write_text(text, encoding="utf-8")
            library = Path(folder, _identifier(form) + place[1])
            options = ["-O2", "-std=c99", "-shared", *([] if os.name == "nt" else ["-fPIC"])]
            command = [compiler[0], *options, *compiler[1:], ROOTS[fmi], "-o", library.name, "-lm"]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                return *place, library.read_bytes()
        why = f"{compiler[0]} failed: {done.stderr.strip()[:200]}"
    warnings.warn(
        f"The FMU has source code alone, no binary: {why}. Compile it where it is used.",
        stacklevel=3,
    )
    return None


def _platform(fmi: str) -> tuple[str, str] | None:
    """Return the folder of binaries for this platform, and the suffix of its shared libraries."""
    system = {
        "linux": ("linux", ".so"),
        "darwin": ("darwin", ".dylib"),
        "win32": ("windows", ".dll"),
    }.get(sys.platform)
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    if system is None or machine not in ("x86_64", "aarch64") or sys.maxsize < 2**32:
        return None
    name, suffix = system
    return (f"{machine}-{name}" if fmi == "3.0" else name.removesuffix("dows") + "64"), suffix


def _description(
    model: PortableModel,
    renamed: dict[str, str],
    variables: list[_Variable],
    form: str,
    fmi: str,
    token: str,
) -> Element:
    """Return modelDescription.xml."""
    second = fmi == "2.0"
    spelling = "FMUstate" if second else "FMUState"
    capable = [
        *(
            "canHandleVariableCommunicationStepSize",
            f"canGetAndSet{spelling}",
            f"canSerialize{spelling}",
        ),
        "canInterpolateInputs" if second else "providesIntermediateUpdate",
    ]
    source = [element("SourceFiles", element("File", name=ROOTS[fmi]))] if second else []
    units = sorted({variable.unit for variable in variables} - {""})
    outputs = [k for k, variable in enumerate(variables) if variable.kind in "sod"]
    unknown = [k for k in outputs if variables[k].kind != "s"]
    if second:
        groups = (("Outputs", outputs), ("InitialUnknowns", unknown))
        structure = [
            element(tag, *(element("Unknown", index=str(k + 1)) for k in group))
            for tag, group in groups
        ]
    else:
        groups = (("Output", outputs), ("InitialUnknown", unknown))
        structure = [element(tag, valueReference=str(k)) for tag, group in groups for k in group]
    names = f". Names: {text}" if (text := changes_text(renamed)) else ""
    return element(
        "fmiModelDescription",
        element(
            "CoSimulation",
            *source,
            modelIdentifier=_identifier(form),
            **dict.fromkeys(capable, "true"),
        ),
        element(
            "UnitDefinitions",
            *(element("Unit", element("BaseUnit", **BASE_UNITS[u]), name=u) for u in units),
        ),
        element(
            "LogCategories",
            *(element("Category", name=name) for name in ("logStatusError", "logStatusDiscard")),
        ),
        element(
            "DefaultExperiment", startTime="0", stopTime=f"{STOP_TIME:g}", stepSize=repr(TIME_STEP)
        ),
        element(
            "ModelVariables",
            *(_described(k, variable, second) for k, variable in enumerate(variables)),
        ),
        element("ModelStructure", *structure),
        fmiVersion=fmi,
        modelName=model.aircraft.name,
        **{"guid" if second else "instantiationToken": token},
        description=f"A posterior of Gaussian processes, by skdgp. Content "
        f"{model.content_hash}{names}",
        generationTool="skdgp",
        variableNamingConvention="flat",
    )


_ROLES = {
    "t": ("independent", "continuous", ""),
    "s": ("output", "continuous", "exact"),
    "p": ("parameter", "fixed", "exact"),
    "i": ("input", "continuous", ""),
    "o": ("output", "continuous", "calculated"),
    "d": ("output", "continuous", "calculated"),
}
"""Causality, variability and initial of each kind of variable."""


def _described(reference: int, variable: _Variable, second: bool) -> Element:
    words = {"name": variable.name, "valueReference": str(reference)}
    words |= zip(("causality", "variability", "initial"), _ROLES[variable.kind], strict=True)
    words |= {"description": variable.meaning}
    number = {
        "unit": variable.unit,
        "start": repr(float(variable.start)) if variable.kind in "spi" else "",
    }
    words, number = (
        {name: value for name, value in each.items() if value} for each in (words, number)
    )
    if second:
        return element("ScalarVariable", element("Real", **number), **words)
    update = {"intermediateUpdate": "true"} if variable.kind == "i" else {}
    return element("Float64", **words, **number, **update)


def _build_description(form: str, fmi: str) -> Element:
    """Return buildDescription.xml, which FMI 3.0 asks for."""
    sources = element("SourceFileSet", element("SourceFile", name=ROOTS[fmi]), language="C99")
    library = element("Library", name="m")
    configuration = element(
        "BuildConfiguration", sources, library, modelIdentifier=_identifier(form)
    )
    return element("fmiBuildDescription", configuration, fmiVersion=fmi)


def _xml(root: Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)

"""FMUs: read, compiled and flown by FMPy, beside `simulate`."""

import re
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest

from skdgp._cli import main
from skdgp._flight.channels import CHANNELS
from skdgp._mechanics.aerodynamics import Mixing
from skdgp.dynamics import Aerodynamics, Aircraft, FlightComputer, Propeller, ThrustLine, simulate
from skdgp.export import (
    Block,
    LearnedRange,
    PortableModel,
    Readout,
    Regressor,
    save_portable,
    write_fmu,
)
from skdgp.export._fmu import BASE_UNITS, COMPILERS

fmpy = pytest.importorskip("fmpy", reason="flies FMUs in FMPy: pip install fmpy")
NO_COMPILER = not any(map(shutil.which, COMPILERS))
NEEDED = "an FMU flies after a C compiler has made its binary"
COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
STATE = ["north", "east", "down", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r"]
SHOWN = [
    *(*STATE, "v_north", "v_east", "v_down", "airspeed", "alpha", "beta", "altitude", "density"),
    *("ax", "ay", "az", "p_dot", "q_dot", "r_dot", *COEFFICIENTS),
]
SURFACES = ("elevon_left", "elevon_right")
MIXING = Mixing(SURFACES, ("elevator", "aileron"), np.array([[0.5, 0.5], [0.5, -0.5]]))
DT, STEPS = 0.02, 60
START = {
    "airspeed": 25.0, "alpha": 0.05, "beta": 0.02, "phi": 0.2, "theta": 0.1, "psi": 1.0,
    "p": 0.1, "q": -0.05, "r": 0.07, "north": 3.0, "east": -7.0, "altitude": 400.0,
}  # fmt: skip
SLOPES = pd.DataFrame.from_dict(
    {  # CX, CY, CZ, Cl, Cm, Cn
        "alpha": [0.3, 0, -4.5, 0, -0.5, 0], "beta": [0, -0.5, 0, -0.05, 0, 0.08], "p_hat": [0, 0, 0, -0.45, 0, -0.03],
        "q_hat": [0, 0, -5, 0, -9, 0], "r_hat": [0, 0, 0, 0.1, 0, -0.12], "elevator": [0, 0, -0.4, 0, -0.9, 0],
        "aileron": [0, 0, 0, 0.15, 0, 0], "rudder": [0, 0.1, 0, 0, 0, -0.08], "throttle": [0.01, 0, 0, 0, 0, 0],
        "alpha_dot_hat": [0, 0, -1, 0, -3, 0], "beta_dot_hat": [0, 0, 0, 0, 0, 0.05],
        "p_dot_hat": [0, 0, 0, -0.1, 0, 0], "az": [0, 0, 0, 0, 1e-3, 0],
    },
    orient="index",
)  # fmt: skip


def model_of(regressors, **parts):
    """Return a stable aircraft of given derivatives, with curves, as a portable model."""
    aircraft = Aircraft(
        name="uav <&> 10 %", mass=11.0, inertia=[[1.1, -0.1, 0.2], [-0.1, 2.3, 0.1], [0.2, 0.1, 2.9]],
        wing_area=1.3, span=2.6, chord=0.5, **parts,
    )  # fmt: skip
    rng, d = np.random.default_rng(0), len(regressors)
    lengths = {"q": 0.5, "alpha_dot": 0.5}
    made = []
    for name in regressors:
        rate = name.removesuffix("_hat")
        if name in MIXING.controls:
            factors = MIXING.matrix[MIXING.controls.index(name)]
            made.append(Regressor(name, "rad", SURFACES, tuple(factors.tolist())))
        elif rate != name:
            made.append(
                Regressor(
                    name, "", (rate,), (1.0,), lengths.get(rate, 2.6), 2 if rate == "p_dot" else 1
                )
            )
        else:
            made.append(Regressor(name, "", (name,)))
    weights = np.column_stack([[-0.03, 0.0, -0.2, 0.0, 0.02, 0.0], SLOPES.loc[list(regressors)].T])
    return PortableModel(
        regressors=tuple(made), outputs=tuple(COEFFICIENTS), aircraft=aircraft, shift=np.zeros(d), scale=np.ones(d),
        center=np.zeros(6), output_scale=np.ones(6), deviation_scale=np.full(6, 0.01),
        centres=rng.normal(0, 0.1, (3, d)),
        blocks=tuple(Block(i, 0, 0, 3, 0.01, np.zeros(d), np.full(d, 0.5), tuple(range(d))) for i in range(6)),
        readouts=(Readout(rng.normal(size=3), rng.normal(size=6)),), readout_of=np.zeros(6, dtype=int),
        trend_center=np.zeros(d), trend_scale=np.ones((6, d + 1)), trend_weights=weights,
        trend_roots=(np.zeros((d + 1, 3)),) * 6, prior_variance=np.ones(6), mixture=np.ones((1, 6)),
        noise_variance=np.zeros(6), drift_variance=np.zeros(6), drift_memory=np.zeros(6),
        input_covariance=np.zeros((d, d)),
        envelope=LearnedRange(np.full(d, -0.3), np.full(d, 0.3), np.empty((0, d))),
    )  # fmt: skip


def flown(model, start=START, **options):
    """Return what `simulate` flies with a portable model."""
    aircraft = model.aircraft
    aerodynamics = Aerodynamics(
        model.predict,
        model.regressor_names,
        span=aircraft.span,
        chord=aircraft.chord,
        mixing=MIXING,
    )
    return simulate(aerodynamics, aircraft, start, dt=DT, **options)


LINE = ThrustLine(position=(-0.4, 0.1, -0.2), direction=(1.0, 0.05, 0.1))
PROPELLER = Propeller(
    0.5, (0.1, -0.05, -0.08), (0.01, -0.002, -0.001), rotation=-1, speed_range=(100.0, 500.0)
)
CLASSICAL = ("alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder")
FOLLOWING = ("alpha_dot_hat", "beta_dot_hat", "p_dot_hat", "az")
MODELS = {
    "explicit": model_of(CLASSICAL, thrust_line=LINE),
    "implicit": model_of(
        (*CLASSICAL, "throttle", *FOLLOWING), thrust_line=LINE, propeller=PROPELLER
    ),
}
KINDS = [
    (name, form, fmi)
    for name, form in (
        ("explicit", "aircraft"),
        ("implicit", "aircraft"),
        ("implicit", "coefficients"),
    )
    for fmi in ("2.0", "3.0")
]


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    """Return the path of an FMU, written once; gcc accepts no warning and finds undefined behaviour at run time."""
    if NO_COMPILER:
        pytest.skip(NEEDED)
    folder, patch = tmp_path_factory.mktemp("fmu"), pytest.MonkeyPatch()
    if shutil.which("gcc"):
        patch.setenv(
            "CC",
            "gcc -O0 -Wall -Wextra -Werror -pedantic -fsanitize=undefined "
            "-fno-sanitize-recover=all",
        )

    @cache
    def write(name, form, fmi):
        path = str(folder / f"{name}{form}{fmi[0]}.fmu")
        assert write_fmu(path, MODELS[name], form=form, fmi=fmi)
        return path

    yield write
    patch.undo()


@pytest.fixture(params=["2.0", "3.0"])
def fmi(request):
    """Return a version of the standard."""
    return request.param


class Instance:
    """An instance of an FMU by names of variables, in FMI 2.0 or 3.0."""

    def __init__(self, path, folder, **options):
        self.logged = []
        description = fmpy.read_model_description(path)
        self.second = description.fmiVersion == "2.0"
        self.references = {
            variable.name: variable.valueReference for variable in description.modelVariables
        }
        if not (folder / "modelDescription.xml").exists():
            fmpy.extract(path, str(folder))
        self.fmu = fmpy.instantiate_fmu(
            str(folder),
            description,
            debug_logging=True,
            logger=lambda *words: self.logged.append(words[-1]),
            **options,
        )
        self.read, self.write = (
            (self.fmu.getReal, self.fmu.setReal)
            if self.second
            else (self.fmu.getFloat64, self.fmu.setFloat64)
        )

    def set(self, values):
        values = dict(values)
        self.write(
            [self.references[name] for name in values], [float(value) for value in values.values()]
        )

    def get(self, names):
        return np.array(self.read([self.references[name] for name in names]))

    def set_slopes(self, values):
        places = [self.references[name] for name in values]
        self.fmu.setRealInputDerivatives(places, [1] * len(places), list(values.values()))

    def begin(self, start, inputs, slopes=None):
        self.fmu.setupExperiment(startTime=0.0) if self.second else None
        self.set(start)
        self.fmu.enterInitializationMode()
        self.set(inputs)
        self.set_slopes(slopes) if slopes else None
        self.fmu.exitInitializationMode()


@pytest.fixture
def instance(fmu, tmp_path):
    """Return what instantiates an FMU, and frees it in the end."""
    found = []

    def make(*kind, **options):
        found.append(Instance(fmu(*kind), tmp_path / "".join(kind), **options))
        return found[-1]

    yield make
    for each in found:
        each.fmu.freeInstance()


def table(**columns):
    """Return a table of controls that are linear between its rows."""
    time = DT * np.arange(STEPS + 1)
    shapes = {
        name: mean + size * np.sin(2.0 * time + len(name)) for name, (mean, size) in columns.items()
    }
    return pd.DataFrame({"time": time} | shapes)


CONTROLS = {"elevon_left": (0.0, 0.02), "elevon_right": (-0.01, 0.02), "rudder": (0.01, 0.02)}


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_description_and_symbols(kind, fmu, tmp_path):
    from fmpy.validation import validate_fmu

    assert {channel.unit for channel in CHANNELS.values()} <= {"", *BASE_UNITS}
    assert validate_fmu(fmu(*kind)) == []
    assert set(fmpy.supported_platforms(fmu(*kind))) == {"c-code", fmpy.platform}
    with ZipFile(fmu(*kind)) as archive:
        (library,) = [name for name in archive.namelist() if name.startswith("binaries/")]
        archive.extract(library, tmp_path)
    if shutil.which("nm"):
        text = subprocess.run(
            ["nm", "-D", tmp_path / library], capture_output=True, text=True, check=True
        ).stdout
        symbols = [line.split()[-2:] for line in text.splitlines()]
        assert all(name.startswith(f"fmi{kind[2][0]}") for what, name in symbols if what in "TDBR")
        assert not [name for _, name in symbols if name.startswith(("Py", "_Py"))]


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("every", [1, 5])
def test_flight_is_that_of_simulate(name, fmi, every, instance):
    """Controls and wind linear in time, by input derivatives or intermediate updates; steps of 0.02 and 0.1 s."""
    engine = {"throttle": (0.6, 0.2)} if name == "implicit" else {"thrust": (20.0, 5.0)}
    controls = table(**CONTROLS, **engine)
    row = controls["time"].to_numpy()
    controls = controls.apply(
        lambda column: np.interp(row, row[::every], column[::every])
    )  # linear within a step
    rate = row if fmi == "2.0" or name == "explicit" else 0 * row  # FMI 3.0 has no rates of inputs
    wind = pd.DataFrame(
        {"time": row, "wind_north": 3 + rate, "wind_east": -2 + 0.5 * rate, "wind_down": 0.3 * rate}
    )
    expected = flown(MODELS[name], controls=controls, air=wind)
    assert set(expected["ended"]) == {""}
    inputs = pd.concat([controls, wind.drop(columns="time")], axis=1).drop(columns="time")
    reads = [*SHOWN, *(f"{name}_std" for name in COEFFICIENTS), "beyond"]

    def update(_, time, *__):
        uav.set({name: np.interp(time, row, inputs[name]) for name in inputs})

    def slopes(k):
        return (
            ((inputs.loc[k + every] - inputs.loc[k]) / (every * DT)).to_dict()
            if fmi == "2.0"
            else None
        )

    uav = instance(
        name, "aircraft", fmi, **({} if fmi == "2.0" else {"intermediate_update": update})
    )
    uav.begin(expected.loc[0, STATE], inputs.loc[0], slopes(0))
    found = [uav.get(reads)]
    for k in range(0, STEPS, every):
        uav.set(inputs.loc[k])
        if fmi == "2.0":
            uav.set_slopes(slopes(k))
        uav.fmu.doStep(row[k], every * DT)
        found.append(uav.get(reads))
    np.testing.assert_allclose(
        np.array(found)[:, : len(SHOWN)], expected.loc[::every, SHOWN], rtol=1e-9, atol=1e-9
    )
    if name == "explicit":
        X = MODELS[name].regressor_values(expected.loc[::every])
        _, std = MODELS[name].predict(X, return_std=True, include_input_noise=False)
        np.testing.assert_allclose(np.array(found)[:, len(SHOWN) : -1], std, rtol=1e-7)
        outside = ((X < -0.3) | (X > 0.3)).sum(axis=1)
        np.testing.assert_array_equal(np.array(found)[:, -1], outside)


def test_inputs_without_slopes_are_held(fmi, fmu):
    """FMPy itself flies the controls of a computer that holds them; all loads of the propulsion act."""
    loads = {"thrust_x": (5.0, 2.0), "thrust_y": (1.0, 1.0), "thrust_z": (-2.0, 1.0)}
    loads |= {"thrust_l": (0.1, 0.1), "thrust_m": (0.2, 0.1), "thrust_n": (-0.1, 0.1)}
    controls = table(**CONTROLS, **loads)
    rows = controls.drop(columns="time").to_dict("records")
    wind = {"wind_north": 4.0, "wind_east": -3.0, "wind_down": 0.5}
    expected = flown(
        MODELS["explicit"], controls=FlightComputer(lambda t, state: rows[round(t / DT)]), duration=STEPS * DT,
        air=list(wind.values()),
    )  # fmt: skip
    inputs = controls.assign(**wind, thrust=0.0)
    found = fmpy.simulate_fmu(
        fmu("explicit", "aircraft", fmi), stop_time=STEPS * DT, output_interval=DT, output=STATE,
        start_values=expected.loc[0, STATE].to_dict(), input=inputs.to_records(index=False),
    )  # fmt: skip
    assert len(found) == STEPS + 1
    np.testing.assert_allclose(
        [list(row)[1:] for row in found], expected[STATE], rtol=1e-9, atol=1e-9
    )


def test_coefficients_are_those_of_the_model(fmi, instance):
    model, rng = MODELS["implicit"], np.random.default_rng(0)
    aero = instance("implicit", "coefficients", fmi)
    sources = list(
        dict.fromkeys(name for regressor in model.regressors for name in regressor.columns)
    )
    rows = pd.DataFrame(rng.normal(0.0, 0.2, (10, len(sources))), columns=sources).assign(
        airspeed=25.0
    )
    aero.begin({}, rows.loc[0])
    found = []
    for k, row in rows.iterrows():
        aero.set(row)
        found.append(aero.get([*COEFFICIENTS, *(f"{name}_std" for name in COEFFICIENTS), "beyond"]))
        aero.fmu.doStep(0.1 * k, 0.1)
    mean, std = model.predict(rows, return_std=True, include_input_noise=False)
    X = model.regressor_values(rows)
    np.testing.assert_allclose(
        found, np.column_stack([mean, std, (np.abs(X) > 0.3).sum(axis=1)]), rtol=1e-9
    )


def test_without_any_input_it_flies(fmi, fmu, capsys):
    """An importer that sets nothing sees a flight, near level."""
    for name in MODELS:
        last = fmpy.simulate_fmu(fmu(name, "aircraft", fmi), stop_time=2.0)[-1]
        assert 15 < last["airspeed"] < 40
        assert 900 < last["altitude"] < 1100


def test_state_is_kept_and_instances_are_separate(fmi, instance):
    one, other = (instance("implicit", "aircraft", fmi) for _ in range(2))
    for each, rudder in ((one, 0.02), (other, -0.02)):
        each.begin({"psi": 1.0}, {"rudder": rudder})
    get = one.fmu.getFMUstate if one.second else one.fmu.getFMUState
    put = one.fmu.setFMUstate if one.second else one.fmu.setFMUState
    free = one.fmu.freeFMUstate if one.second else one.fmu.freeFMUState
    load = one.fmu.deSerializeFMUstate if one.second else one.fmu.deserializeFMUState
    one.fmu.doStep(0.0, 0.1)
    state = get()
    data = (one.fmu.serializeFMUstate if one.second else one.fmu.serializeFMUState)(state)
    for each in (one, other):
        each.fmu.doStep(0.1 if each is one else 0.0, 0.5)
    last = one.get(STATE)
    assert not np.allclose(last[6:], other.get(STATE)[6:], atol=1e-3)
    for again in (state, load(data)):
        put(again)
        one.fmu.doStep(0.1, 0.5)
        np.testing.assert_array_equal(one.get(STATE), last)
    free(state)
    with pytest.raises(fmpy.fmi1.FMICallException):
        load(data[:-1])
    with pytest.raises(fmpy.fmi1.FMICallException):
        load(b"x" * len(data))
    one.fmu.reset()
    one.begin({}, {})
    assert one.get(["psi"]) == 0.0


def test_misuse_is_an_error_with_a_message(fmi, instance):
    uav = instance("explicit", "aircraft", fmi)
    fmu = uav.fmu

    def refused(message, function, *words):
        del uav.logged[:]
        with pytest.raises(fmpy.fmi1.FMICallException) as caught:
            function(*words)
        assert caught.value.status == 3
        assert [bool(re.search(message, text.decode())) for text in uav.logged] == [True], (
            uav.logged
        )

    refused("while the instance is instantiated", fmu.doStep, 0.0, 0.1)
    refused("while the instance is instantiated", fmu.exitInitializationMode)
    refused("CX.*not known before the initialization", uav.get, ["CX"])
    refused("dt.*not > 0", uav.set, {"dt": 0.0})
    refused("alpha.*cannot be set here", uav.set, {"alpha": 0.1})
    refused("value reference 4096 .*no such variable", uav.read, [4096])
    refused("value reference 4096 .*no such variable", uav.write, [4096], [1.0])
    uav.begin({"u": 25.0}, {"rudder": 0.01})
    for value in (np.nan, np.inf):
        refused("rudder.*not finite", uav.set, {"elevon_left": 1.0, "rudder": value})
    assert uav.get(["elevon_left", "rudder"]).tolist() != [1.0, 0.01]
    assert uav.get(["rudder"]) == 0.01
    refused("cannot be set here", uav.set, {"u": 20.0})
    refused("does not begin at the time", fmu.doStep, 0.5, 0.1)
    for size in (-0.1, 0.0, np.nan, np.inf):
        refused("step size is not > 0", fmu.doStep, 0.0, size)
    refused("1e7 steps", fmu.doStep, 0.0, 1e9)
    if uav.second:
        refused(
            "order is not 1", fmu.setRealInputDerivatives, [uav.references["rudder"]], [2], [0.0]
        )
        refused("nothing of that kind", fmu.getInteger, [0])
        refused("no input", fmu.setRealInputDerivatives, [uav.references["u"]], [1], [0.0])
    else:
        refused("nothing of that kind", fmu.getInt32, [0])
        refused("nothing of that kind", fmu.enterEventMode)
    fmu.doStep(0.0, 0.1)
    assert np.isfinite(uav.get(SHOWN)).all()
    fmu.terminate()
    refused("terminated", fmu.doStep, 0.1, 0.1)
    assert np.isfinite(uav.get(SHOWN)).all()


def test_a_flight_ends_where_that_of_simulate_ends(fmi, instance):
    start = {"airspeed": 25.0, "theta": -1.4, "alpha": 0.0, "altitude": -4980.0}
    with pytest.warns(UserWarning, match="below any land|ended early"):
        expected = flown(MODELS["explicit"], start, controls={"rudder": 0.0, "elevon_left": 0.0, "elevon_right": 0.0},
                         duration=2.0, thrust=None)  # fmt: skip
    rows = int((expected["ended"] == "").sum())
    uav = instance("explicit", "aircraft", fmi)
    uav.begin(expected.loc[0, STATE], {"rudder": 0.0, "elevon_left": 0.0, "elevon_right": 0.0})
    with pytest.raises(fmpy.fmi1.FMICallException) as caught:
        uav.fmu.doStep(0.0, 2.0)
    assert caught.value.status == 2
    assert "outside of the atmosphere" in uav.logged[-1].decode()
    assert uav.get(["time"]) == pytest.approx((rows - 1) * DT)
    np.testing.assert_allclose(
        uav.get(STATE), expected.loc[rows - 1, STATE].to_numpy(float), rtol=1e-9, atol=1e-9
    )
    if uav.second:
        assert uav.fmu.getBooleanStatus(3)
        assert uav.fmu.getRealStatus(2) == uav.get(["time"])
    else:
        early = instance("explicit", "aircraft", fmi, early_return_allowed=True)
        early.begin(
            expected.loc[0, STATE], {"rudder": 0.0, "elevon_left": 0.0, "elevon_right": 0.0}
        )
        assert early.fmu.doStep(0.0, 2.0) == (False, True, True, uav.get(["time"]))
    slow = instance("explicit", "aircraft", fmi)
    with pytest.raises(fmpy.fmi1.FMICallException):
        slow.begin({"u": 0.5, "w": 0.0}, {})
    assert "airspeed under 1 m/s" in slow.logged[-1].decode()


@pytest.mark.skipif(shutil.which("cmake") is None, reason="FMPy compiles with cmake")
def test_source_compiles_elsewhere(fmu, tmp_path, capfd):
    from fmpy.build import build_platform_binary

    for folder in ("fmu", "build"):
        (tmp_path / folder).mkdir()
    fmpy.extract(fmu("explicit", "aircraft", "3.0"), str(tmp_path / "fmu"))
    shutil.rmtree(tmp_path / "fmu" / "binaries")
    build_platform_binary(tmp_path / "fmu", tmp_path / "build", all_warnings=True)
    assert "warning" not in capfd.readouterr().err
    assert np.isfinite(fmpy.simulate_fmu(str(tmp_path / "fmu"), stop_time=0.1)[-1]["CZ"])


FIXED = Propeller(0.5, (0.1,))


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (MODELS["explicit"], {"thrust"}),
        (replace(MODELS["explicit"], provenance={"options": {"thrust": None}}), set()),
        (model_of(CLASSICAL, propeller=FIXED), {"propeller_speed"}),
        (model_of(CLASSICAL, propeller=PROPELLER), {"throttle"}),
    ],
)
def test_without_a_compiler_there_is_the_source(model, expected, tmp_path, monkeypatch):
    """An input sets the thrust, unless the coefficients include it."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    path = str(tmp_path / "a.fmu")
    with pytest.warns(UserWarning, match="source code alone, no binary: there is no C compiler"):
        assert write_fmu(path, model) is None
    assert fmpy.supported_platforms(path) == ["c-code"]
    inputs = {
        v.name for v in fmpy.read_model_description(path).modelVariables if v.causality == "input"
    }
    loads = {f"thrust_{axis}" for axis in "xyzlmn"}
    wind = {"wind_north", "wind_east", "wind_down"}
    assert inputs == {*SURFACES, "rudder"} | loads | wind | expected


def renamed(model, old, new):
    regressors = [
        replace(each, sources=(new,)) if each.name == old else each for each in model.regressors
    ]
    return replace(model, regressors=tuple(regressors))


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        (MODELS["explicit"], {"form": "tables"}, "form='tables', but expected 'aircraft' or"),
        (MODELS["explicit"], {"fmi": "1.0"}, "fmi='1.0', but expected '2.0' or"),
        (replace(MODELS["explicit"], outputs=tuple("abcdef")), {}, r"without \['CX'"),
        (
            renamed(MODELS["explicit"], "rudder", "dt"),
            {},
            r"\['dt'\], but the FMU has other variables",
        ),
        (
            renamed(MODELS["explicit"], "rudder", "time"),
            {"form": "coefficients"},
            r"\['time'\], but the FMU",
        ),
        (
            renamed(MODELS["explicit"], "rudder", "v_north"),
            {},
            r"a model of \['v_north'\], which are neither controls",
        ),
    ],
)
def test_what_has_no_form_is_refused(model, options, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        write_fmu(tmp_path / "a.fmu", model, **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(NO_COMPILER, reason=NEEDED)
def test_command(tmp_path, capsys):
    """One command writes an FMU."""
    save_portable(tmp_path / "model.npz", MODELS["explicit"])
    words = ["--to", "fmu", "--form", "coefficients", "--fmi", "3.0", "-o", str(tmp_path)]
    assert main(["export", str(tmp_path / "model.npz"), *words]) == 0
    assert "aero.fmu" in capsys.readouterr().out
    assert fmpy.read_model_description(str(tmp_path / "aero.fmu")).fmiVersion == "3.0"

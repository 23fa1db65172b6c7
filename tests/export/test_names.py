"""Names of columns that a format does not know are written as identifiers, and the files are read."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.export import (
    load_portable,
    onnx_model,
    portable_model,
    save_portable,
    write_c,
    write_jsbsim,
)
from skdgp.identification import make_identification_pipeline

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
HOSTILE = [
    "flap left",
    "flap_right",
    "é",
    "1flap",
    "a--b",
    "flap 😀",
    "x\x01y",
    "q??/",
    "*/",
    "-->",
    "a,b\\",
]
WRITTEN = [
    "flap_left",
    "flap_right",
    "_",
    "_1flap",
    "a__b",
    "flap__",
    "x_y",
    "q___",
    "__",
    "___",
    "a_b_",
]
NAME = 'a::b */ #error "é" \\ ??/ <&> $x --'


@pytest.fixture(scope="module")
def learned():
    """Return a pipeline of hostile columns, a row of its flight, and the portable model."""
    rng, n = np.random.default_rng(0), 60
    columns = ["alpha", "beta", "q", *HOSTILE]
    flight = pd.DataFrame(rng.normal(0, 0.1, (n, len(columns))), columns=columns)
    flight = flight.assign(airspeed=20.0, time=0.1 * np.arange(n))
    Y = flight[columns] @ rng.normal(size=(len(columns), 6)) + rng.normal(0, 0.01, (n, 6))
    aircraft = Aircraft(
        name=NAME, mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25
    )
    pipeline = make_identification_pipeline(
        aircraft, regressors=["alpha", "q_hat", *HOSTILE], reconstruction="passthrough", cutoff=None,
        mixer="passthrough", regressor=DependentGPRegressor(structure="trend", max_iter=2),
    )  # fmt: skip
    pipeline.set_params(flightcheck="passthrough", flightsmoother="passthrough")
    pipeline.fit(flight, pd.DataFrame(Y).set_axis(COEFFICIENTS, axis=1))
    return pipeline, flight.iloc[0], portable_model(pipeline, aircraft)


@pytest.mark.parametrize("names", [("flap left", "flap_left"), ("p dot",)])
def test_names_that_would_be_of_other_columns_are_refused(learned, names):
    regressors = tuple(replace(learned[2].regressors[0], name=name) for name in names)
    with pytest.raises(ValueError, match=f"Got .'{names[0]}'., which are written"):
        replace(learned[2], regressors=regressors).with_identifiers()


def test_c_compiles_and_names_the_columns(learned, tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("gcc compiles the exported model, and is not installed")
    write_c(tmp_path, learned[2])
    words = [
        "gcc",
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wtrigraphs",
        "-Werror",
        "-pedantic",
        "-c",
        "aero.c",
    ]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert ", ".join(WRITTEN) in (tmp_path / "aero.h").read_text()


def test_onnx_names_the_columns(learned):
    pytest.importorskip("onnx", reason='writes the graph: pip install "skdgp[export]"')
    facts = {each.key: each.value for each in onnx_model(learned[2]).metadata_props}
    assert facts["regressors"].split(",") == ["alpha", "q_hat", *WRITTEN]


def test_jsbsim_flies_the_columns(learned, tmp_path):
    jsbsim = pytest.importorskip("jsbsim", reason="flies exports in JSBSim: pip install jsbsim")
    pipeline, row, model = learned
    (path,) = write_jsbsim(tmp_path, model)
    fdm = jsbsim.FGFDMExec(str(tmp_path))
    fdm.set_debug_level(0)
    assert fdm.load_model(path.stem)
    fdm["ic/vt-fps"], fdm["ic/h-sl-ft"], fdm["ic/alpha-rad"] = 20.0 / 0.3048, 1000.0, row["alpha"]
    fdm["ic/q-rad_sec"] = row["q"]
    for name, written in zip(HOSTILE, WRITTEN, strict=True):
        fdm[f"fcs/{written}"] = row[name]
    fdm.run_ic()
    found = [fdm[f"aero/coefficient/{name}"] for name in COEFFICIENTS]
    np.testing.assert_allclose(found, pipeline.predict(pd.DataFrame([row]))[0], atol=1e-6)


def test_the_file_keeps_the_names(learned, tmp_path):
    save_portable(tmp_path / "a.npz", learned[2])
    assert load_portable(tmp_path / "a.npz").regressor_names == ("alpha", "q_hat", *HOSTILE)

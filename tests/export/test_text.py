"""Names of columns that a format does not know are written as identifiers, and the files are read."""

import json
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.export import (
    build_up,
    load_portable,
    onnx_model,
    portable_model,
    save_portable,
    write_build_up,
    write_c,
    write_jsbsim,
)  # fmt: skip
from skdgp.export._text import changes_text, identifiers
from skdgp.identification import make_identification_pipeline

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
HOSTILE = [
    "flap left",
    "flap_left",
    "é",
    "1flap",
    "a--b",
    "flap 😀",
    "x\x01y",
    "q??/",
    "*/",
    "-->",
    "p dot",
    "a,b\\",
]
NAME = 'a::b */ #error "é" \\ ??/ <&> $x --'


def test_identifiers_are_distinct_and_stay():
    names = [*HOSTILE, "CX", "alpha", "alpha_hat ", "", "日本"]
    found = identifiers(names)
    assert set(found) == set(names)
    assert len(set(found.values())) == len(names)
    assert all(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", short) for short in found.values())
    assert {name: found[name] for name in ("flap_left", "CX", "alpha")} == {
        n: n for n in ("flap_left", "CX", "alpha")
    }
    assert found["p dot"] != "p_dot", "another column is not the roll acceleration"
    assert identifiers(found.values()) == {short: short for short in found.values()}


def test_changes_can_be_read_back():
    names = identifiers(HOSTILE)
    text = changes_text(names)
    read = {json.loads(word): short for word, short in re.findall(r'("[^"]*") is (\w+)', text)}
    assert read == {name: short for name, short in names.items() if name != short}
    assert not re.search(r"--|\*|\?|[^ -~]", text)


@pytest.fixture(scope="module")
def learned():
    """Return a pipeline of hostile columns, its aircraft and a row of its flight."""
    rng, n = np.random.default_rng(0), 60
    columns = ["alpha", "beta", "q", *HOSTILE]
    flight = pd.DataFrame(rng.normal(0, 0.1, (n, len(columns))), columns=columns)
    flight = flight.assign(airspeed=20.0, time=0.1 * np.arange(n))
    Y = pd.DataFrame(
        flight[columns] @ rng.normal(size=(len(columns), 6)) + rng.normal(0, 0.01, (n, 6))
    )
    aircraft = Aircraft(
        name=NAME, mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25
    )
    pipeline = make_identification_pipeline(
        aircraft, regressors=["alpha", "q_hat", *HOSTILE], reconstruction="passthrough", cutoff=None,
        mixer="passthrough", regressor=DependentGPRegressor(structure="trend", max_iter=2),
    )  # fmt: skip
    pipeline.set_params(flightcheck="passthrough", flightsmoother="passthrough")
    return pipeline.fit(flight, Y.set_axis(COEFFICIENTS, axis=1)), aircraft, flight.iloc[0]


def test_c_compiles_and_names_the_columns(learned, tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("gcc compiles the exported model, and is not installed")
    write_c(tmp_path, portable_model(*learned[:2]))
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
    assert '"flap left" is flap_left_2' in (tmp_path / "aero.h").read_text()


def test_onnx_names_the_columns(learned):
    pytest.importorskip("onnx", reason='writes the graph: pip install "skdgp[export]"')
    properties = {
        each.key: each.value for each in onnx_model(portable_model(*learned[:2])).metadata_props
    }
    names = json.loads(properties["names"])
    assert properties["regressors"].split(",") == [
        "alpha",
        "q_hat",
        *(names[name] for name in HOSTILE),
    ]


@pytest.mark.parametrize("form", ["functions", "tables"])
def test_jsbsim_flies_the_columns(learned, form, tmp_path):
    jsbsim = pytest.importorskip("jsbsim", reason="flies exports in JSBSim: pip install jsbsim")
    pipeline, aircraft, row = learned
    (path,) = write_jsbsim(tmp_path, pipeline, aircraft, form=form)
    assert '"flap left" is flap_left_2' in path.read_text()
    fdm = jsbsim.FGFDMExec(str(tmp_path))
    fdm.set_debug_level(0)
    assert fdm.load_model(path.stem)
    fdm["ic/vt-fps"], fdm["ic/h-sl-ft"], fdm["ic/alpha-rad"] = 20.0 / 0.3048, 1000.0, row["alpha"]
    fdm["ic/q-rad_sec"] = row["q"]
    for name, short in identifiers(["alpha", "q_hat", *HOSTILE]).items():
        if name in HOSTILE:
            fdm[f"fcs/{short}"] = row[name]
    fdm.run_ic()
    found = [fdm[f"aero/coefficient/{name}"] for name in COEFFICIENTS]
    np.testing.assert_allclose(found, pipeline.predict(pd.DataFrame([row]))[0], atol=1e-6)


def test_json_keeps_the_names(learned, tmp_path):
    pipeline, aircraft, _ = learned
    write_build_up(tmp_path / "a.json", build_up(pipeline, aircraft, pairs="none", max_loss=np.inf))
    assert list(json.loads((tmp_path / "a.json").read_text())["regressors"]) == [
        "alpha",
        "q_hat",
        *HOSTILE,
    ]
    save_portable(tmp_path / "a.npz", portable_model(pipeline, aircraft))
    assert load_portable(tmp_path / "a.npz").regressor_names == ("alpha", "q_hat", *HOSTILE)

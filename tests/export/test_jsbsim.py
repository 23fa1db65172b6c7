"""JSBSim loads the exports, and finds the coefficients, loads and accelerations of this package."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline

from skdgp.calibration import CalibratedRegressor
from skdgp.dynamics import Air, Aircraft, Propeller, ThrustLine, trim
from skdgp.export import write_jsbsim
from skdgp.export._jsbsim import SOURCES, gaussian_sums

pytestmark = [pytest.mark.filterwarnings("ignore:Compacting to")]
FOOT, POUND_FORCE = 0.3048, 4.4482216152605
COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
AIRSPEED = 25.0
PLANET = """<?xml version="1.0"?>
<planet name="flat"><semimajor_axis unit="M">1e10</semimajor_axis><semiminor_axis unit="M">1e10</semiminor_axis>
<rotation_rate unit="RAD/SEC">0</rotation_rate><GM unit="M3/SEC2">9.80665e20</GM><J2>0</J2></planet>
"""


@pytest.fixture
def load(tmp_path, capfd):
    """Return a function that loads an aircraft and sets regressors."""
    jsbsim = pytest.importorskip("jsbsim", reason="flies exports in JSBSim: pip install jsbsim")

    def loaded(name, planet=None):
        fdm = jsbsim.FGFDMExec(str(tmp_path))
        fdm.set_debug_level(0)
        assert planet is None or fdm.load_planet(planet, False)
        assert fdm.load_model(name)
        return fdm

    yield loaded
    assert "argument" not in "".join(capfd.readouterr())


def placed(fdm, row, aircraft, largest):
    """Set a state and controls, and return the coefficients that JSBSim computes."""
    fdm["ic/vt-fps"], fdm["ic/h-sl-ft"] = AIRSPEED / FOOT, 1000.0
    fdm["ic/alpha-rad"], fdm["ic/beta-rad"] = row["alpha"], row["beta"]
    for rate, length in (("p", aircraft.span), ("q", aircraft.chord), ("r", aircraft.span)):
        fdm[f"ic/{rate}-rad_sec"] = row[f"{rate}_hat"] * 2 * AIRSPEED / length
    for surface in ("elevator", "aileron", "rudder"):
        fdm[f"fcs/{surface}-cmd-norm"] = row[surface] / largest[surface]
    fdm.run_ic()
    return np.array([fdm[f"aero/coefficient/{name}"] for name in COEFFICIENTS])


@pytest.mark.parametrize(
    ("name", "form", "tolerance"),
    [
        ("trend", "functions", 1e-6),
        ("trend", "tables", 1e-6),
        ("sparse", "functions", 1e-6),
        ("sparse-average", "functions", 1e-6),
        ("additive", "functions", 1e-6),
        ("average", "functions", 1e-6),
    ],
)
def test_coefficients_are_those_of_the_model(
    name, form, tolerance, load, fitted, uav, regressors, tmp_path
):
    write_jsbsim(tmp_path, fitted(name), uav, form=form)
    fdm, rows = load("uav"), regressors[:40]
    largest = regressors.abs().max()
    found = np.stack([placed(fdm, row, uav, largest) for _, row in rows.iterrows()])
    np.testing.assert_allclose(found, fitted(name).predict(rows), atol=tolerance)
    np.testing.assert_allclose(fdm["aero/regressor/q_hat"], rows["q_hat"].iloc[-1], atol=1e-8)


def test_loads_and_accelerations_are_those_of_the_coefficients(
    load, fitted, uav, regressors, tmp_path
):
    write_jsbsim(tmp_path, fitted("trend"), uav)
    fdm, row = load("uav"), regressors.iloc[3]
    C = placed(fdm, row, uav, regressors.abs().max())
    qbar_area = (
        0.5 * fdm["atmosphere/rho-slugs_ft3"] * POUND_FORCE / FOOT**4 * AIRSPEED**2 * uav.wing_area
    )
    force = np.array([fdm[f"forces/fb{axis}-aero-lbs"] for axis in "xyz"]) * POUND_FORCE
    moment = np.array([fdm[f"moments/{axis}-aero-lbsft"] for axis in "lmn"]) * POUND_FORCE * FOOT
    np.testing.assert_allclose(force, qbar_area * C[:3], rtol=1e-6)
    np.testing.assert_allclose(moment, qbar_area * uav.moment_lengths * C[3:], rtol=1e-6)
    omega = np.array([fdm[f"velocities/{rate}-rad_sec"] for rate in "pqr"])
    found = np.array([fdm[f"accelerations/{rate}dot-rad_sec2"] for rate in "pqr"])
    expected = np.linalg.solve(uav.inertia, moment - np.cross(omega, uav.inertia @ omega))
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
    assert fdm["inertia/mass-slugs"] * POUND_FORCE / FOOT == pytest.approx(uav.mass)


def test_thrust_is_that_of_the_propeller(load, fitted, uav, regressors, tmp_path):
    propeller = Propeller(
        0.5, (0.1, -0.05, -0.08), torque_coefficients=(0.01, 0.002), speed_range=(100.0, 700.0)
    )
    line = ThrustLine(position=(-0.5, 0.1, -0.2), direction=(1.0, 0.0, 0.1))
    aircraft = Aircraft.from_dict(uav.to_dict() | {"propeller": propeller, "thrust_line": line})
    write_jsbsim(tmp_path, fitted("trend"), aircraft)
    fdm = load("uav")
    fdm["fcs/throttle-cmd-norm"] = 0.6
    placed(fdm, regressors.iloc[0], uav, regressors.abs().max())
    density = fdm["atmosphere/rho-slugs_ft3"] * POUND_FORCE / FOOT**4
    loads = (propeller.thrust(460.0, AIRSPEED, density), propeller.torque(460.0, AIRSPEED, density))
    force, moment = line.loads(*loads)
    found = np.array([fdm[f"forces/fb{axis}-external-lbs"] for axis in "xyz"]) * POUND_FORCE
    np.testing.assert_allclose(found, force, rtol=1e-6, atol=1e-9)
    found = np.array([fdm[f"moments/{axis}-external-lbsft"] for axis in "lmn"]) * POUND_FORCE * FOOT
    np.testing.assert_allclose(found, moment, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["sparse", "sparse-average"])
def test_functions_of_draws_are_sample_paths(name, load, fitted, uav, regressors, tmp_path):
    paths = write_jsbsim(tmp_path, fitted(name), uav, n_draws=2, random_state=3)
    assert [path.stem for path in paths] == ["uav", "uav_001", "uav_002"]
    drawn = fitted(name)[-1].sample_paths(2, random_state=3)[1]
    found = placed(load("uav_002"), regressors.iloc[5], uav, regressors.abs().max())
    np.testing.assert_allclose(
        found, drawn(fitted(name)[0].transform(regressors[5:6]))[0], atol=1e-6
    )


@pytest.mark.parametrize("name", ["sparse", "sparse-average"])
def test_draws_of_a_calibrated_model_are_its_sample_paths(name, fitted, uav, regressors):
    scaler, regressor = fitted(name)
    calibrated = CalibratedRegressor(regressor)
    calibrated.estimator_, calibrated.std_scale_, calibrated._single = (
        regressor,
        np.linspace(1.0, 2.0, 6),
        False,
    )
    (mean, *drawn), X = (
        gaussian_sums(make_pipeline(scaler, calibrated), uav, n_draws=3),
        regressors[:9],
    )
    for found, path in zip(drawn, calibrated.sample_paths(3, 0), strict=True):
        np.testing.assert_allclose(found.evaluate(X), path(scaler.transform(X)), atol=1e-9)
        assert np.abs(found.evaluate(X) - mean.evaluate(X)).max() > 1e-4


def test_what_tables_lose_too_much_of_becomes_functions(
    load, fitted, built, uav, regressors, tmp_path
):
    """The draw has the same path in both: the coefficients above ``max_loss`` exactly, the others by tables."""
    ratio = built("sparse").loss["loss"] / built("sparse").loss["deviation"]
    options = {"form": "tables", "max_loss": ratio.median(), "n_draws": 1, "random_state": 3}
    write_jsbsim(tmp_path, fitted("sparse"), uav, **options)
    large, row = (ratio > ratio.median()).to_numpy(), regressors[5:6]
    path = fitted("sparse")[-1].sample_paths(1, random_state=3)(fitted("sparse")[0].transform(row))[
        0, 0
    ]
    draw = built("sparse").sample(1, random_state=3)[0].evaluate(row)[0]
    mean, table = fitted("sparse").predict(row)[0], built("sparse").evaluate(row)[0]
    for name, exact, tables in (("uav", mean, table), ("uav_001", path, draw)):
        found = placed(load(name), row.iloc[0], uav, regressors.abs().max())
        np.testing.assert_allclose(found, np.where(large, exact, tables), atol=1e-7)
        assert (np.abs(exact - tables)[large] > 1e-6).any()


def test_tables_of_draws_are_those_of_the_build_up(load, built, uav, regressors, tmp_path):
    paths = write_jsbsim(tmp_path, built("trend"), uav, n_draws=1, random_state=3)
    drawn = built("trend").sample(1, random_state=3)[0]
    found = placed(load(paths[1].stem), regressors.iloc[5], uav, regressors.abs().max())
    np.testing.assert_allclose(found, drawn.evaluate(regressors[5:6])[0], atol=1e-7)


def test_trim_is_that_of_jsbsim(load, fitted, uav, regressors, tmp_path):
    """JSBSim's full trim, to 0.001 ft/s^2, at the same thrust and over a flat Earth; surfaces begin at zero."""
    write_jsbsim(tmp_path, fitted("trend"), uav)
    (tmp_path / "flat.xml").write_text(PLANET)
    fdm, largest = load("uav", planet=str(tmp_path / "flat.xml")), regressors.abs().max()
    placed(fdm, regressors.iloc[0] * 0.0, uav, largest)
    density = fdm["atmosphere/rho-slugs_ft3"] * POUND_FORCE / FOOT**4
    expected = trim(fitted("trend"), uav, AIRSPEED, air=Air(density=density))
    fdm["external_reactions/thrust/magnitude"] = expected.controls["thrust"] / POUND_FORCE
    fdm["simulation/do_simple_trim"] = 1
    wanted = {
        name: getattr(expected, name) for name in ("alpha", "phi", "theta")
    } | expected.controls
    assert wanted.pop("thrust") == expected.thrust
    assert {name: fdm[SOURCES[name][0]] for name in wanted} == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize("airspeed", [22.0, 25.0, 30.0])
def test_jsbsim_trims_a_propeller(airspeed, load, fitted, uav, regressors, tmp_path):
    """JSBSim's full trim finds the throttle too, from controls at zero: that of this package."""
    propeller = Propeller(
        0.5, (0.1, -0.05, -0.08), torque_coefficients=(0.01, 0.002), speed_range=(100.0, 900.0)
    )
    aircraft = Aircraft.from_dict(uav.to_dict() | {"propeller": propeller})
    write_jsbsim(tmp_path, fitted("trend"), aircraft)
    (tmp_path / "flat.xml").write_text(PLANET)
    fdm = load("uav", planet=str(tmp_path / "flat.xml"))
    fdm["ic/vt-fps"], fdm["ic/h-sl-ft"] = airspeed / FOOT, 1000.0
    fdm.run_ic()
    fdm["simulation/do_simple_trim"] = 1
    density = fdm["atmosphere/rho-slugs_ft3"] * POUND_FORCE / FOOT**4
    expected = trim(fitted("trend"), aircraft, airspeed, air=Air(density=density))
    wanted = {
        name: getattr(expected, name) for name in ("alpha", "phi", "theta")
    } | expected.controls
    assert {name: fdm[SOURCES[name][0]] for name in wanted} == pytest.approx(wanted, abs=1e-4)
    assert fdm["forces/fbx-external-lbs"] * POUND_FORCE == pytest.approx(expected.thrust, rel=1e-3)


@pytest.mark.usefixtures("short_flights", "short_fits")
@pytest.mark.parametrize("short_flights", [1500], indirect=True)
def test_code_of_the_page_flies_steadily(tmp_path, monkeypatch):
    """The build-up of export.md, and its aircraft, whose trim by JSBSim is that of this package, flown for 10 s."""
    pytest.importorskip("jsbsim", reason="flies the page: pip install jsbsim")
    text = (Path(__file__).resolve().parents[2] / "docs" / "export.md").read_text(encoding="utf-8")
    text = text.partition("\n## The build-up\n")[2]
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(
        "\n".join(re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)), names
    )
    fdm, steady = names["fdm"], names["steady"]
    assert fdm["aero/alpha-rad"] == pytest.approx(steady.alpha, rel=0.01)
    assert fdm["fcs/throttle-cmd-norm"] == pytest.approx(steady.controls["throttle"], rel=0.01)
    assert fdm["velocities/vt-fps"] * FOOT == pytest.approx(35.0, rel=1e-3)


def test_the_file_states_its_loss_and_signs(built, uav, tmp_path):
    (path,) = write_jsbsim(tmp_path, built("trend"), uav)
    text = path.read_text()
    assert "elevator > 0 pitches down" in text
    assert "deviation" in text
    root = ET.parse(path).getroot()
    assert {axis.get("name") for axis in root.iter("axis")} == {
        "X",
        "Y",
        "Z",
        "ROLL",
        "PITCH",
        "YAW",
    }


@pytest.mark.parametrize(
    ("options", "match"), [({"form": "lookup"}, "'functions' or"), ({"n_draws": -1}, "from 0 on")]
)
def test_options(options, match, fitted, uav, tmp_path):
    with pytest.raises(ValueError, match=match):
        write_jsbsim(tmp_path, fitted("trend"), uav, **options)

"""JSBSim loads the export, and finds the coefficients, loads and accelerations of this package."""

from dataclasses import replace

import numpy as np
import pytest
from flight_columns import COEFFICIENTS
from numpy.testing import assert_allclose

from skdgp.dynamics import Air, Aircraft, Propeller, ThrustLine, trim
from skdgp.export import write_jsbsim

FOOT, POUND_FORCE = 0.3048, 4.4482216152605
AIRSPEED = 25.0
FULL = {"elevator": 0.9, "aileron": 0.8, "rudder": 0.7}  # [rad], at a command of 1
PROPELLER = Propeller(
    0.5, (0.1, -0.05, -0.08), torque_coefficients=(0.01, 0.002), speed_range=(100.0, 900.0)
)
PLANET = """<?xml version="1.0"?>
<planet name="flat"><semimajor_axis unit="M">1e10</semimajor_axis><semiminor_axis unit="M">1e10</semiminor_axis>
<rotation_rate unit="RAD/SEC">0</rotation_rate><GM unit="M3/SEC2">9.80665e20</GM><J2>0</J2></planet>
"""


@pytest.fixture
def load(tmp_path, capfd):
    """Return a function that writes a model and loads its aircraft over a flat Earth."""
    jsbsim = pytest.importorskip("jsbsim", reason="flies exports in JSBSim: pip install jsbsim")

    def loaded(model, full=FULL):
        (path,) = write_jsbsim(tmp_path, model, full=full)
        (tmp_path / "flat.xml").write_text(PLANET)
        fdm = jsbsim.FGFDMExec(str(tmp_path))
        fdm.set_debug_level(0)
        assert fdm.load_planet(str(tmp_path / "flat.xml"), False)
        assert fdm.load_model(path.stem)
        return fdm

    yield loaded
    assert "argument" not in "".join(capfd.readouterr())


def placed(fdm, model, x):
    """Set a state and controls, and return the coefficients that JSBSim computes."""
    row = dict(zip(model.regressor_names, x, strict=True))
    fdm["ic/vt-fps"] = AIRSPEED / FOOT
    fdm["ic/h-sl-ft"] = 1000.0
    fdm["ic/alpha-rad"] = row["alpha"]
    fdm["ic/beta-rad"] = row["beta"]
    for rate, length in zip("pqr", model.aircraft.moment_lengths, strict=True):
        fdm[f"ic/{rate}-rad_sec"] = row.get(f"{rate}_hat", 0.0) * 2 * AIRSPEED / length
    for surface, largest in FULL.items():
        fdm[f"fcs/{surface}-cmd-norm"] = row[surface] / largest
    fdm["fcs/throttle-cmd-norm"] = row.get("throttle", fdm["fcs/throttle-cmd-norm"])
    fdm.run_ic()
    return np.array([fdm[f"aero/coefficient/{name}"] for name in COEFFICIENTS])


def density(fdm):
    return fdm["atmosphere/rho-slugs_ft3"] * POUND_FORCE / FOOT**4


def of_aircraft(model, **changes):
    return replace(model, aircraft=Aircraft.from_dict(model.aircraft.to_dict() | changes))


def test_coefficients_are_those_of_the_pipeline(written, load):
    fdm = load(written.model)
    written.assert_mean([placed(fdm, written.model, x) for x in written.X], 1e-7)
    q_hat = written.X[-1][written.model.regressor_names.index("q_hat")]
    assert_allclose(fdm["aero/regressor/q_hat"], q_hat, rtol=0, atol=1e-8)


def test_regressors_are_those_of_the_state(load, portable_of):
    model = portable_of("trend")
    state = {"airspeed": 25.0, "altitude": 300.0, "phi": 0.3, "theta": 0.1, "psi": 1.2}
    regressors = [replace(model.regressors[0], name=name) for name in (*state, "throttle")]
    fdm = load(replace(model, regressors=tuple(regressors)), None)
    for place, value in {
        "vt-fps": 25.0 / FOOT, "h-sl-ft": 300.0 / FOOT, "phi-rad": 0.3, "theta-rad": 0.1, "psi-true-rad": 1.2,
    }.items():  # fmt: skip
        fdm[f"ic/{place}"] = value
    fdm["fcs/throttle-cmd-norm"] = 0.6
    fdm.run_ic()
    found = {name: fdm[f"aero/regressor/{name}"] for name in (*state, "throttle")}
    assert found == pytest.approx(state | {"throttle": 0.6})


def test_a_command_of_1_is_the_full_deflection(load, portable_of):
    """Of the argument, else of the aircraft; 1 of parts of it."""
    model = of_aircraft(portable_of("trend"), full_deflections={"aileron": 0.5, "elevator": 0.4})
    assert load(model, FULL) is not None
    with pytest.raises(ValueError, match="Got no full deflection of rudder"):
        load(model, {"elevator": 0.42})
    fdm = load(model, {"elevator": 0.42, "rudder": 0.3})
    assert_allclose(deflections(fdm, model), [0.42, 0.5, 0.3])

    parts = [
        replace(each, unit="full throw" if each.name in FULL else each.unit)
        for each in model.regressors
    ]
    fdm = load(replace(model, regressors=tuple(parts)), None)
    assert_allclose(deflections(fdm, model), [1.0, 1.0, 1.0])


def deflections(fdm, model):
    """Return the positions of elevator, aileron and rudder at a command of 1."""
    fdm.run_ic()
    for surface in FULL:
        fdm[f"fcs/{surface}-cmd-norm"] = 1.0
    fdm.run_ic()
    return [fdm[f"fcs/{name}-pos-rad"] for name in ("elevator", "left-aileron", "rudder")]


def loads(fdm, kind):
    """Return the forces [N] and the moments [N m] of a kind in body axes."""
    force = [fdm[f"forces/fb{axis}-{kind}-lbs"] for axis in "xyz"]
    moment = [fdm[f"moments/{axis}-{kind}-lbsft"] for axis in "lmn"]
    return POUND_FORCE * np.array(force), POUND_FORCE * FOOT * np.array(moment)


def test_loads_and_accelerations_are_those_of_the_coefficients(load, portable_of):
    model = portable_of("trend")
    uav = model.aircraft
    fdm = load(model)
    C = placed(fdm, model, model.reference.regressors[3])
    qbar_area = 0.5 * density(fdm) * AIRSPEED**2 * uav.wing_area
    force, moment = loads(fdm, "aero")
    assert_allclose(force, qbar_area * C[:3], rtol=1e-6)
    assert_allclose(moment, qbar_area * uav.moment_lengths * C[3:], rtol=1e-6)
    omega = [fdm[f"velocities/{rate}-rad_sec"] for rate in "pqr"]
    found = [fdm[f"accelerations/{rate}dot-rad_sec2"] for rate in "pqr"]
    expected = np.linalg.solve(uav.inertia, moment - np.cross(omega, uav.inertia @ omega))
    assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
    assert_allclose(fdm["inertia/mass-slugs"] * POUND_FORCE / FOOT, uav.mass)


def test_thrust_is_that_of_the_propeller(load, portable_of):
    line = ThrustLine(position=(-0.5, 0.1, -0.2), direction=(1.0, 0.0, 0.1))
    changes = {"name": 'a::b */ "é" <&> $x --', "propeller": PROPELLER, "thrust_line": line}
    model = of_aircraft(portable_of("trend"), **changes)
    fdm = load(model)
    fdm["fcs/throttle-cmd-norm"] = 0.6
    placed(fdm, model, model.reference.regressors[0])
    state = (580.0, AIRSPEED, density(fdm))
    expected = line.loads(PROPELLER.thrust(*state), PROPELLER.torque(*state))
    assert_allclose(loads(fdm, "external"), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_surfaces_follow_commands_with_delay_and_lag_of_the_servos(load, portable_of, delay):
    model = replace(portable_of("trend"), servos=np.array([0.2, delay, np.inf]))
    fdm = load(model)
    placed(fdm, model, np.zeros(6))
    fdm["fcs/elevator-cmd-norm"] = 0.5
    begin = fdm.get_sim_time()
    while fdm.get_sim_time() < begin + 0.4:
        fdm.run()
    elapsed = fdm.get_sim_time() - begin - max(0.0, delay - fdm.get_delta_t())
    expected = 0.5 * FULL["elevator"] * (1 - np.exp(-elapsed / 0.2))
    assert_allclose(fdm["fcs/elevator-pos-rad"], expected, rtol=0.03)


@pytest.mark.parametrize("propeller", [None, PROPELLER])
def test_trim_is_that_of_jsbsim(load, fitted, portable_of, propeller):
    """JSBSim's full trim, to 0.001 ft/s^2, from controls at zero; with a propeller it finds the throttle."""
    model = of_aircraft(portable_of("trend"), propeller=propeller)
    fdm = load(model)
    placed(fdm, model, np.zeros(6))
    air = Air(density=density(fdm))
    expected = trim(fitted("trend").pipeline, model.aircraft, AIRSPEED, air=air)
    if propeller is None:
        fdm["external_reactions/thrust/magnitude"] = expected.controls["thrust"] / POUND_FORCE
    fdm["simulation/do_simple_trim"] = 1
    for place, value in {
        "aero/alpha-rad": expected.alpha,
        "attitude/phi-rad": expected.phi,
        "attitude/theta-rad": expected.theta,
        "fcs/elevator-pos-rad": expected.controls["elevator"],
        "fcs/left-aileron-pos-rad": expected.controls["aileron"],
        "fcs/rudder-pos-rad": expected.controls["rudder"],
    }.items():
        assert_allclose(fdm[place], value, rtol=0, atol=1e-4)
    assert_allclose(fdm["forces/fbx-external-lbs"] * POUND_FORCE, expected.thrust, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("short_flights", "short_fits")
@pytest.mark.parametrize("short_flights", [1500], indirect=True)
def test_code_of_the_page_flies_steadily(blocks_of, tmp_path, monkeypatch):
    """The aircraft of export.md, whose trim by JSBSim is that of this package, flown for 10 s."""
    pytest.importorskip("jsbsim", reason="flies the page: pip install jsbsim")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec("\n".join(blocks_of("export.md", heading="JSBSim")), names)
    fdm, steady = names["fdm"], names["steady"]
    assert_allclose(fdm["aero/alpha-rad"], steady.alpha, rtol=0.01)
    assert_allclose(fdm["fcs/throttle-cmd-norm"], steady.controls["throttle"], rtol=0.01)
    assert_allclose(fdm["velocities/vt-fps"] * FOOT, 35.0, rtol=1e-3)


def test_what_cannot_be_written_is_refused(portable_of, tmp_path):
    model = portable_of("trend")
    with pytest.raises(ValueError, match=r"without \['CX'\], but expected all six"):
        write_jsbsim(tmp_path, replace(model, outputs=("CT", *model.outputs[1:])))
    assert not list(tmp_path.iterdir())
    renamed = replace(model.regressors[0], name="p_dot")
    with pytest.raises(ValueError, match="'p_dot', an acceleration"):
        write_jsbsim(
            tmp_path, replace(model, regressors=(renamed, *model.regressors[1:])), full=FULL
        )
    assert not list(tmp_path.iterdir())

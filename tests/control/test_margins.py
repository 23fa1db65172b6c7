"""Margins against closed forms and the eigenvalues of closed loops; gains that have them; files of parameters."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq, newton

from skdgp.control import autopilot_loops, margins, read_parameters, suggest_gains
from skdgp.dynamics import Servos, linearize, trim

AIRSPEED, DELAY = 20.0, 0.04
FULL = {"aileron": 0.42, "elevator": 0.4, "rudder": 0.35}
pytestmark = pytest.mark.filterwarnings("ignore:The parameters lack")
# Without gains, filters and scaling; the loops of the attitude are too slow to count
UNFILTERED = {
    "IMU_GYRO_CUTOFF": 0.0, "IMU_DGYRO_CUTOFF": 0.0, "FW_ARSP_SCALE_EN": 0.0, "FW_R_TC": 1e9, "FW_P_TC": 1e9,
}  # fmt: skip
UNFILTERED |= {f"FW_{axis}R_{gain}": 0.0 for axis in "RPY" for gain in ("P", "I", "FF")}
PX4 = UNFILTERED | {
    "FW_RR_P": 0.1, "FW_RR_I": 0.2, "FW_RR_FF": 0.1, "FW_R_TC": 0.4,
    "FW_PR_P": 0.2, "FW_PR_I": 0.3, "FW_PR_FF": 0.1, "FW_P_TC": 0.5,
    "FW_YR_P": 0.3, "FW_YR_I": 0.1, "FW_AIRSPD_TRIM": 16.0, "FW_ARSP_SCALE_EN": 1.0,
}  # fmt: skip


def roll_loop(parameters):
    """Return the loop of the aileron alone, which moves by up to 0.4 rad."""
    (loop,) = autopilot_loops(parameters, {"aileron": 0.4})
    return loop


def linear_of(glider, slopes=None, n_paths=0, delay=DELAY, **options):
    """Return the linear model of an aircraft, whose slopes paths change by some 10 %."""
    model = glider.model(slopes, **options)
    steady = trim(model, glider.aircraft, AIRSPEED, altitude=100.0)
    return linearize(model, glider.aircraft, steady, n_paths=n_paths, delay=delay)


@pytest.fixture(scope="module")
def linear(glider):
    return linear_of(glider, n_paths=20)


def only_roll(glider, damping=-0.4, **options):
    """Return the linear model of an aircraft of a Cl_p that does nothing but roll."""
    slopes = glider.slopes.copy()
    slopes[[1, 5]] = 0.0
    slopes[3] = [0, 0, damping, 0, 0, 0, 0.1, 0]
    return linear_of(glider, slopes, **options)


@pytest.mark.parametrize(
    ("damping", "P", "I", "delay"),
    [(-0.4, 3.5, 0.0, 0.02), (-0.4, 1.7, 0.0, 0.05), (0.001, 0.8, 0.01, DELAY)],
)
def test_of_a_roll_mode_are_those_of_the_closed_form(damping, P, I, delay, glider):
    """L = (P + I / s) g / (s + a) exp(-s T): real at -180 deg, also where a rise of the gain first makes it stable."""
    linear = only_roll(glider, damping, delay=delay)
    a, g = -linear.A.loc["p", "p"], 0.4 * linear.B.loc["p", "aileron"]
    P, I = P * abs(a) / g, I / g
    loop = roll_loop(UNFILTERED | {"FW_RR_P": P, "FW_RR_I": I})

    def L(w):
        return (P + I / (1j * w)) * g / (1j * w + a) * np.exp(-1j * w * delay)

    at_180 = brentq(lambda w: L(w).imag, 0.25 * np.pi / delay, np.pi / delay)
    found = margins(linear, [loop])["value"]["roll"]
    assert_allclose(found["gain"], -20 * np.log10(abs(L(at_180))), atol=0.02)
    if I == 0.0:
        crossover = np.sqrt((P * g) ** 2 - a**2)
        assert_allclose(found["crossover"], crossover, rtol=1e-3)
        assert_allclose(found["phase"], 180.0 + np.rad2deg(np.angle(L(crossover))), atol=0.2)
    beyond = loop.scaled(1.003 * 10 ** (found["gain"] / 20))
    assert margins(linear, [beyond])["value"]["roll"]["gain"] == -np.inf


@pytest.mark.parametrize(("damping", "factor"), [(-0.4, 1.0), (0.03, 1.0), (-0.4, -0.4)])
def test_a_growing_mode_of_a_closed_loop_is_told(damping, factor, glider):
    """s - a + g exp(-s T) = 0 has a root that grows: of too high gains, or of a turned sign."""
    linear = only_roll(glider, damping)
    loop = roll_loop(UNFILTERED | {"FW_RR_P": 6.0})
    a, g = linear.A.loc["p", "p"], 0.4 * 6.0 * linear.B.loc["p", "aileron"]
    root = newton(lambda s: s - a + factor * g * np.exp(-s * DELAY), 10 + 40j * (factor > 0))
    assert root.real > 1.0
    assert margins(linear, [loop.scaled(factor)]).attrs["unstable"] == {"roll": 1.0}
    assert margins(linear, [loop.scaled(0.1)]).attrs["unstable"] == {}


def test_bands_hold_the_errors_of_the_servos(glider):
    """In the limit of exact lags and delays the bands are those of the aircraft."""
    loops = autopilot_loops(PX4, {"aileron": FULL["aileron"]})
    widths = {}
    for std in (0.0, 1e-9, 0.01, 0.02):
        servos = Servos(lag=0.05, delay=0.02, lag_std=std, delay_std=std / 2)
        table = margins(linear_of(glider, n_paths=60, servos=servos), loops).loc["roll"]
        widths[std] = (table["upper"] - table["lower"])[["gain", "phase"]]
    assert_allclose(widths[1e-9], widths[0.0], rtol=1e-5)
    assert (widths[0.01] > widths[0.0]).all()
    assert (widths[0.02] > widths[0.01]).all()


@pytest.fixture(scope="module")
def with_spiral(glider):
    """Return the linear model of an aircraft whose spiral grows faster than 0.1 1/s, and is moved by the ailerons."""
    slopes = glider.slopes.copy()
    slopes[3, 1] = 0.05  # Cl_beta
    slopes[5, [1, 4]] = [0.04, -0.04]  # Cn_beta, Cn_r
    linear = linear_of(glider, slopes, n_paths=20)
    assert linear.modes()["eigenvalue"]["spiral"].real > 0.2
    return linear


def test_a_spiral_does_not_count_where_the_roll_loop_is_open(with_spiral):
    """The elevator moves the attitude along the plane of symmetry alone."""
    pitch = autopilot_loops(PX4, {"elevator": FULL["elevator"]})
    alone = margins(with_spiral, pitch)
    both = autopilot_loops(PX4 | {"FW_RR_P": 0.5}, {k: FULL[k] for k in ("aileron", "elevator")})
    together = margins(with_spiral, both)
    assert_allclose(alone.loc["pitch", "value"], together.loc["pitch", "value"], rtol=1e-3)
    assert np.isfinite(alone["lower"]["pitch"]).all()
    assert suggest_gains(with_spiral, pitch)[0].P > 0.0


def test_a_mode_that_a_loop_moves_and_leaves_unstable_is_not_the_pitch_loops(with_spiral):
    """The elevator does not move the spiral."""
    weak = {"FW_RR_P": 1e-4, "FW_RR_I": 0.0, "FW_RR_FF": 0.0}
    roll, pitch, _ = autopilot_loops(PX4 | weak, FULL)
    table = margins(with_spiral, [roll, pitch])
    assert table["value"]["roll"]["gain"] == -np.inf
    assert np.isfinite(table["value"]["pitch"]).all()
    assert table.attrs["unstable"] == {"roll": 1.0}
    with pytest.raises(ValueError, match="gains given are unstable in 100%"):
        suggest_gains(with_spiral, [roll])


@pytest.mark.parametrize(
    ("parameters", "mix"),
    [
        (PX4 | {"FW_RLL_TO_YAW_FF": 0.3}, 0.3),
        ({"RLL_RATE_P": 0.2, "RLL_RATE_I": 0.2}, 0.5),  # KFF_RDDRMIX of the firmware
    ],
)
def test_the_rudder_follows_the_roll_loop(parameters, mix, linear):
    """Margins of roll are those of an aircraft whose aileron moves the rudder."""
    (loop,) = autopilot_loops(parameters, {"aileron": FULL["aileron"]})
    rolling = {name: FULL[name] for name in ("aileron", "rudder")}
    mixed, *_ = autopilot_loops(parameters, rolling)
    signs = np.sign([linear.B.loc["p", "aileron"], linear.B.loc["r", "rudder"]])
    ratio = signs.prod() * mix * FULL["rudder"] / FULL["aileron"]
    B, D = linear.B.copy(), linear.D.copy()
    for table in (B, D):
        table["aileron"] += ratio * table["rudder"]
    expected = margins(replace(linear, B=B, D=D, paths=None), [loop])["value"]["roll"]
    assert_allclose(margins(linear, [mixed])["value"]["roll"], expected, rtol=1e-6)
    assert not np.allclose(margins(linear, [loop])["value"]["roll"], expected, rtol=1e-3)


UNIT = np.rad2deg(1.0) / 45.0  # outputs of ArduPilot are degrees of 45
ROLL = {"RLL_RATE_P": 1e-9, "RLL_RATE_I": 0.0, "RLL_RATE_FF": 0.3, "RLL2SRV_TCONST": 0.4}
PITCH = {name.replace("RLL", "PTCH"): value for name, value in ROLL.items()}
RATE = {
    "RLL_RATE_P": 0.2, "RLL_RATE_I": 0.0, "RLL_RATE_FF": 0.0, "SCALING_SPEED": 15.0, "INS_GYRO_FILTER": 0.0,
}  # fmt: skip
S = 30j
BY_RATE = -0.4 * 0.2 * UNIT * 15**2 / 20**2 * 1.225 / 0.9
# The loop of parameters and a surface of 0.4 rad: its command for a channel at s, 20 m/s and density 0.9
LAWS = {
    "AlphaFilter of PX4's derivative": (
        UNFILTERED | {"FW_RR_P": 0.1, "FW_RR_D": 0.02, "IMU_DGYRO_CUTOFF": 25.0}, "aileron", "p", S,
        -0.4 * (0.1 + 0.02 * S / (1.0 + S / (2 * np.pi * 25.0))),
    ),
    "PX4's feed-forward alone": (
        UNFILTERED | {"FW_RR_P": 0.0, "FW_RR_FF": 0.3, "FW_R_TC": 0.5}, "aileron", "phi", 2j, -0.4 * 0.3 / 0.5
    ),
    **{f"PX4 without airspeed, {name}": (PX4 | {name: value}, "aileron", "p", 1e9j, -0.4 * PX4["FW_RR_P"])
       for name, value in (("FW_ARSP_MODE", 1.0), ("FW_USE_AIRSPD", 0.0))},
    # AP_FW_Controller: "FF should be scaled by scaler/eas2tas"
    "ArduPilot's feed-forward of roll": (ROLL, "aileron", "phi", 1e-6, -0.4 * 0.3 * UNIT * 15 / 20 / 0.4),
    "ArduPilot's feed-forward of pitch": (PITCH, "elevator", "theta", 1e-6, -0.4 * 0.3 * UNIT * 15 / 20 / 0.4),
    "ArduPilot's rate": (RATE, "aileron", "p", 1e-6, BY_RATE),
    # RLL2SRV_TCONST of the firmware
    "ArduPilot's attitude": (
        RATE, "aileron", "phi", 1e-6, BY_RATE / 0.5
    ),
}  # fmt: skip


@pytest.mark.parametrize(("parameters", "surface", "channel", "s", "law"), LAWS.values(), ids=LAWS)
def test_laws_are_those_of_the_firmware(parameters, surface, channel, s, law):
    (loop,) = autopilot_loops(parameters, {surface: 0.4})
    found = loop.feedback(np.array([s + 0j]), 20.0, 0.9)[channel]
    assert_allclose(found, law, rtol=1e-3)


@pytest.mark.parametrize(
    ("gains", "limits", "trim"),
    [
        ({"FW_RR_P": 0.1}, (7.0, 20.0), 15.0),
        ({"FW_RR_P": 0.1, "FW_AIRSPD_TRIM": 12.0, "FW_AIRSPD_STALL": 9.0}, (9.0, 20.0), 12.0),
        ({"RLL_RATE_P": 0.1}, (0.7 * 9.0, 44.0), 15.0),
    ],
)
def test_airspeeds_that_a_file_lacks_are_the_firmwares_defaults(gains, limits, trim):
    """Gains are scaled by trim over airspeed, squared, between limits of the airspeed."""
    roll = roll_loop(gains)
    fast = np.array([1e-6 + 0j])  # below all filters
    at_trim = roll.feedback(fast, trim, 1.225)["p"]
    for airspeed in (1.0, 10.0, 30.0, 100.0):
        scaling = trim / np.clip(airspeed, *limits)
        assert_allclose(roll.feedback(fast, airspeed, 1.225)["p"], scaling**2 * at_trim)


@pytest.mark.parametrize("number", range(3))
def test_at_the_gain_margin_an_oscillation_of_the_closed_loops_lasts(linear, number):
    """The other loops stay closed: i w I - A - B K exp(-i w T) is singular at a frequency."""
    loops = autopilot_loops(PX4, FULL)
    found = margins(linear, loops)["value"][loops[number].name]["gain"]
    kept = linear.A.columns.drop(["north", "east", "down", "psi"])
    A, B = linear.A.loc[kept, kept].to_numpy(), linear.B.loc[kept]
    s = 1j * np.geomspace(1.0, 50.0, 8000)

    def smallest(factor):
        """Return the least size of the determinant over w, over its size without loops."""
        closed = s[:, None, None] * np.eye(len(kept)) - A
        without = np.linalg.det(closed)
        factors = np.where(np.arange(3) == number, factor, 1.0)
        for loop, rate, times in zip(loops, "pqr", factors, strict=True):
            late = times * np.sign(B.loc[rate, loop.control]) * np.exp(-s * DELAY)[:, None]
            for name, law in loop.feedback(s, AIRSPEED, linear.density).items():
                moved = late * law[:, None] * B[loop.control].to_numpy()
                closed[:, :, kept.get_loc(name)] -= moved
        return np.abs(np.linalg.det(closed) / without).min()

    margin = 10 ** (found / 20)
    assert smallest(margin) < 2e-3
    assert smallest(0.97 * margin) > 0.02


def test_suggested_gains_are_the_largest_that_have_the_margins(linear):
    probability = 0.95
    loops = autopilot_loops(PX4, FULL)
    wanted = {"gain_margin": 8.0, "phase_margin": 50.0, "probability": probability}
    chosen = suggest_gains(linear, loops, **wanted)
    for before, after in zip(loops, chosen, strict=True):
        factor = after.P / before.P
        assert_allclose([after.I, after.FF], [factor * before.I, before.FF])
        name = f"FW_{before.name[0].upper()}R_P"
        assert_allclose(after.parameters[name], factor * PX4[name])
        name = name.removesuffix("P") + "FF"
        assert after.parameters.get(name, 0.0) == PX4[name]

    def shares(loops):
        """Parts of the paths that have both margins of each loop."""
        paths = [margins(linear_of_path(linear, k), loops)["value"].unstack() for k in range(20)]
        return np.mean([(v["gain"] >= 7.99) & (v["phase"] >= 49.9) for v in paths], axis=0)

    larger = [chosen[0], chosen[1].scaled(1.1), chosen[2]]
    names = sorted(loop.name for loop in loops)
    assert probability > shares(larger)[names.index(chosen[1].name)]
    assert (shares(chosen) >= probability).all()


def linear_of_path(linear, number):
    """Return one path as a linear model."""
    tables = {}
    for name in "ABCD":
        table = getattr(linear, name)
        path = getattr(linear.paths, name)[number]
        tables[name] = pd.DataFrame(path, table.index, table.columns)
    return replace(linear, **tables, paths=None)


def test_the_yaw_damper_of_ardupilot_washes_out_a_steady_rate():
    """At the rate of the main loop, as the state of its filter decays by 0.003992 at each turn."""
    parameters = {"RLL_RATE_P": 0.2, "YAW2SRV_DAMP": 0.5, "SCALING_SPEED": 20.0}
    _, yaw = autopilot_loops(
        parameters | {"SCHED_LOOP_RATE": 300.0}, {"aileron": 0.4, "rudder": 0.3}
    )
    s = 1j * 300 * 0.003992 * np.array([1e-4, 1.0, 1e2])
    slow, corner, fast = np.abs(yaw.feedback(s, 20.0, 1.225)["r"] / yaw.of_gyro[0](s))
    gain = 0.3 * 0.5 * UNIT
    assert_allclose(
        [slow, corner, fast], [0.0, gain / np.sqrt(2), gain], rtol=1e-3, atol=1e-3 * gain
    )


@pytest.mark.parametrize(
    ("parameters", "limits"),
    [
        (PX4 | {"FW_AIRSPD_STALL": 14.0, "FW_AIRSPD_MAX": 18.0}, (14.0, 18.0)),
        (PX4 | {"FW_AIRSPD_STALL": 14.0, "FW_ARSP_MODE": 1.0}, (16.0, 16.0)),
        ({"RLL_RATE_P": 0.2, "YAW2SRV_DAMP": 0.5, "AIRSPEED_MIN": 14.0}, (14.0, np.inf)),
    ],
)
def test_the_turn_rate_of_the_yaw_loop_has_the_equivalent_airspeed(parameters, limits):
    """In firmware g phi over the calibrated airspeed within limits, at any density."""
    *_, yaw = autopilot_loops(parameters, {"aileron": 0.4, "rudder": 0.3})
    density, s = 0.9, np.array([2j])
    for equivalent in (10.0, 16.0, 22.0):
        laws = yaw.feedback(s, equivalent * np.sqrt(1.225 / density), density)
        gyro = np.prod([each(s) for each in yaw.of_gyro], axis=0)
        turn_rate = laws["phi"] / laws["r"] * gyro
        assert_allclose(-turn_rate, 9.80665 / np.clip(equivalent, *limits), rtol=1e-4)


def response(loop, frequency, of):
    """Return the command for a channel at a frequency [Hz]."""
    return loop.feedback(np.array([2j * np.pi * frequency]), 20.0, 1.225)[of][0]


@pytest.mark.parametrize(
    ("firmware", "notch", "width", "depth"),
    [
        (PX4, {"IMU_GYRO_NF0_FRQ": 15.0, "IMU_GYRO_NF0_BW": 10.0}, 10.0, 0.0),
        (
            {"RLL_RATE_P": 0.1, "PTCH_RATE_P": 0.1},
            {
                "INS_HNTCH_ENABLE": 1,
                "INS_HNTCH_FREQ": 15.0,
                "INS_HNTCH_BW": 10.0,
                "INS_HNTCH_HMNCS": 1,
            },
            12.5,  # 15 Hz less half of 10 Hz, and as much above in octaves: 10 to 22.5 Hz
            0.01,
        ),
    ],
)
def test_static_notches_are_in_the_loop(firmware, notch, width, depth):
    """Of a width B and a depth d about f_0: (f_0^2 - f^2 + i d B f) / (f_0^2 - f^2 + i B f)."""
    without, with_notch = (roll_loop(firmware | extra) for extra in ({}, notch))

    def ratio(frequency):
        return response(with_notch, frequency, "p") / response(without, frequency, "p")

    for frequency in (1.0, 4.3, 15.0, 60.0):
        apart, beside = 15.0**2 - frequency**2, 1j * width * frequency
        assert_allclose(ratio(frequency), (apart + depth * beside) / (apart + beside), atol=1e-9)


def test_the_derivative_of_the_target_feeds_forward():
    """AC_PID: DFF is the derivative of the filtered target times D_FF, of rates scaled by the airspeed, squared."""
    gains = {"RLL_RATE_P": 0.1, "RLL2SRV_TCONST": 0.5, "SCALING_SPEED": 15.0}
    loop = roll_loop(gains | {"RLL_RATE_D_FF": 0.02})
    s = 2j * np.pi * 2.0
    added = response(loop, 2.0, "phi") - response(roll_loop(gains), 2.0, "phi")
    expected = -0.4 * UNIT * (15.0 / 20.0) ** 2 * 0.02 * s / (1 + s / (2 * np.pi * 3.0)) / 0.5
    assert_allclose(added, expected)


ELEVONS = {"SERVO1_FUNCTION": 77, "SERVO2_FUNCTION": 78}
VTAILS = {"SERVO2_FUNCTION": 79, "SERVO4_FUNCTION": 80}


@pytest.mark.parametrize(
    ("servos", "full"),
    [
        ({}, (0.42, 0.4, 0.35)),
        (ELEVONS, (0.21, 0.2, 0.35)),
        (ELEVONS | {"MIXING_GAIN": 1.0}, (0.42, 0.4, 0.35)),
        (VTAILS | {"MIXING_GAIN": 0.8}, (0.42, 0.32, 0.28)),
    ],
)
def test_mixed_servos_move_by_the_mixing_gain(servos, full):
    """channel_function_mixer: left = (pitch - roll) MIXING_GAIN."""
    gains = {"RLL_RATE_P": 0.1, "PTCH_RATE_P": 0.1, "YAW2SRV_DAMP": 0.2}
    loops = autopilot_loops(gains | servos, FULL)
    assert_allclose([loop.full for loop in loops], full)
    assert_allclose(loops[0].rudder, 0.5 * full[2])


FILES = {
    "ground.params": "# Vehicle-Id Component-Id Name Value Type\n1\t1\tFW_RR_P\t0.05\t9\n1\t1\tFW_AIRSPD_TRIM\t15\t9\n",
    "show.txt": "x + FW_RR_P [123,456] : 0.0500\n  * FW_AIRSPD_TRIM [1,2] : 15.0\n",
    "mission_planner.param": "FW_RR_P,0.05\nFW_AIRSPD_TRIM,15\n",
    "windows.params": "\ufeffFW_RR_P,0.05\r\nFW_AIRSPD_TRIM,15\r\n",
    "comments.parm": "// saved\nFW_RR_P 0.05 // roll\nFW_RR_I 0.1\n@delete FW_RR_I\nFW_AIRSPD_TRIM 15\n",
    "columns.csv": "FW_RR_P,0.05,1\nFW_AIRSPD_TRIM,15.0,7\n",
    "mavproxy.parm": "FW_RR_P          0.050000\nFW_AIRSPD_TRIM   15.0  # a remark\n",
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_ground_stations_are_read(name, tmp_path):
    path = tmp_path / name
    path.write_text(FILES[name], encoding="utf-8")
    assert read_parameters(path) == {"FW_RR_P": 0.05, "FW_AIRSPD_TRIM": 15.0}


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"MC_ROLLRATE_P": 0.1}, "not those of a multicopter"),
        ({"BATT_CAPACITY": 5.0}, "without gains of a rate loop"),
        ({"RLL2SRV_P": 1.0}, "4.1 .RLL2SRV_P., which has another"),
        (UNFILTERED, "no gains other than zero"),
        ({"FW_RR_P": 0.1, "RLL_RATE_P": 0.1}, "of one autopilot"),
        ({"FW_RR_P": np.nan}, "FW_RR_P=nan"),
        ({"FW_RR_P": 0.1, "FW_AIRSPD_TRIM": 0.0}, "above zero"),
        # the default of FW_AIRSPD_MAX is 20 m/s
        ({"FW_RR_P": 0.1, "FW_AIRSPD_TRIM": 30.0}, "airspeeds that increase"),
    ],
)
def test_parameters_that_are_of_no_use_are_refused(parameters, words):
    with pytest.raises(ValueError, match=words):
        roll_loop(parameters)


@pytest.mark.parametrize(
    ("full", "words"),
    [
        ({"aileron": 24.0}, "radians, not degrees"),
        (["aileron"], "expected deflections"),
        ({}, "full={}, but expected deflections"),
        ({"rudder": 0.4}, "yaw rate controller"),
    ],
)
def test_full_deflections_of_no_use_are_refused(full, words):
    with pytest.raises(ValueError, match=words):
        autopilot_loops({"RLL_RATE_P": 0.1, "YAW_RATE_ENABLE": 1.0}, full)


def test_a_control_without_gains_is_named():
    with pytest.warns(UserWarning, match="no gains other than zero for rudder"):
        autopilot_loops(UNFILTERED | {"FW_RR_P": 0.1}, {"aileron": 0.4, "rudder": 0.3})


def test_gains_that_do_not_settle_are_said(linear, monkeypatch):
    monkeypatch.setattr("skdgp.control._margins.ROUNDS", 1)
    with pytest.raises(ValueError, match=r"\['roll', .* that still change after 1 rounds"):
        suggest_gains(linear, autopilot_loops(PX4, FULL))


def test_suggested_gains_are_within_twenty_times_the_present_ones(linear):
    """However many rounds the search takes; these could be raised much farther."""
    (pitch,) = autopilot_loops(PX4, {"elevator": FULL["elevator"]})
    weak = pitch.scaled(1e-3)
    (chosen,) = suggest_gains(linear, [weak])
    assert_allclose(chosen.P / weak.P, 10 ** (26 / 20))


def test_suggested_gains_beyond_the_ranges_of_the_firmware_are_warned_of(linear):
    rates = {"RLL_RATE_P": 0.3, "RLL_RATE_I": 0.1, "RLL_RATE_FF": 0.1, "YAW2SRV_DAMP": 0.1}
    (roll,) = autopilot_loops(rates, {"aileron": FULL["aileron"]})
    with pytest.warns(UserWarning, match=r"RLL_RATE_P .* \(up to 0.35\)"):
        (chosen,) = suggest_gains(linear, [roll])
    assert chosen.parameters["RLL_RATE_P"] > 0.35


HARMONIC = {"RLL_RATE_P": 0.1, "INS_HNTCH_ENABLE": 1, "INS_HNTCH_FREQ": 20.0}


@pytest.mark.parametrize(
    ("notch", "frequencies"),
    [
        ({"INS_HNTCH_BW": 10.0, "INS_HNTCH_HMNCS": 5}, [20.0, 60.0]),
        ({"INS_HNTCH_BW": 0}, []),
    ],
)
def test_harmonics_of_ardupilot_are_notches(notch, frequencies):
    _, *notches = roll_loop(HARMONIC | notch).of_gyro
    assert_allclose([notch.frequency for notch in notches], frequencies)
    assert len({notch.quality for notch in notches}) <= 1


def test_a_notch_that_follows_the_engine_or_is_double_is_named():
    follows = {"INS_HNTCH_BW": 20.0, "INS_HNTCH_MODE": 1, "INS_HNTCH_REF": 0.3, "INS_HNTCH_OPTS": 1}
    with pytest.warns(UserWarning, match="INS_HNTCH_REF 0.3, INS_HNTCH_OPTS 1"):
        roll_loop(HARMONIC | follows)
    for fixed in ({"INS_HNTCH_MODE": 1}, {"INS_HNTCH_MODE": 0, "INS_HNTCH_REF": 0.3}):
        roll_loop(HARMONIC | {"INS_HNTCH_BW": 20.0} | fixed)


@pytest.mark.parametrize(
    ("extra", "names"),
    [
        ({"RLL_RATE_PDMX": 0.1, "RLL_RATE_SMAX": 150.0}, "RLL_RATE_PDMX 0.1, RLL_RATE_SMAX 150"),
        ({"RLL_RATE_NEW": 0.1}, "RLL_RATE_NEW 0.1"),
        ({"RLL_RATE_NEF": 2.0}, "RLL_RATE_NEF 2"),
        ({"MIXING_OFFSET": 50.0}, "MIXING_OFFSET 50"),
        ({"YAW2SRV_DAMP": 0.5, "YAW2SRV_SLIP": 3.0}, "YAW2SRV_SLIP 3"),
    ],
)
def test_parameters_of_the_loops_that_are_not_known_are_named(extra, names):
    given = {"RLL_RATE_P": 0.1, "PTCH_RATE_SMAX": 150.0, "RLL_RATE_IMAX": 0.5} | extra
    with pytest.warns(UserWarning, match=f"margins do not contain what they do: {names}\\."):
        autopilot_loops(given, {"aileron": 0.4, "rudder": 0.3})


def test_an_integrator_without_room_is_none():
    assert roll_loop(UNFILTERED | {"FW_RR_P": 0.1, "FW_RR_I": 0.2, "FW_RR_IMAX": 0.0}).I == 0.0


def test_gains_that_a_file_lacks_are_the_firmwares_defaults():
    with pytest.warns(UserWarning, match="lack .*FW_RR_I 0.1.* defaults of PX4"):
        roll = roll_loop({"FW_RR_P": 0.2})
    assert (roll.P, roll.I, roll.FF, roll.time_constant) == (0.2, 0.1, 0.5, 0.4)
    assert roll.parameters == {"FW_RR_P": 0.2, "FW_RR_I": 0.1, "FW_RR_FF": 0.5}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("the gains are fine\n", "without parameters"),
        ("FW_RR_P 0.05\nFW_RR_P 0.06\n", "FW_RR_P twice"),
        ("1\t1\tFW_RR_P\t0.05\t9\n2\t1\tFW_RR_I\t0.1\t9\n", "vehicles 1, 2"),
        ("@include plane.parm\nRLL_RATE_P 0.1\n", "in one file"),
    ],
)
def test_files_that_are_not_of_one_vehicle_are_refused(text, words, tmp_path):
    path = tmp_path / "plane.parm"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        read_parameters(path)


@pytest.mark.parametrize(
    "value",
    [
        "",
        "nan",
        "0,3",
        ",",
    ],
)
def test_a_gain_that_is_no_number_is_refused(value, tmp_path):
    path = tmp_path / "plane.params"
    path.write_text(f"RLL_RATE_P 0.1\nRLL_RATE_FF {value}\n")
    with pytest.raises(
        ValueError, match=r"Got the line 'RLL_RATE_FF.*a decimal point behind RLL_RATE_FF"
    ):
        read_parameters(path)


def test_a_loop_of_a_control_that_the_model_lacks_is_refused(linear, glider):
    loop = roll_loop({"FW_RR_P": 0.1})
    with pytest.raises(ValueError, match="flaperon"):
        margins(linear, [replace(loop, control="flaperon")])
    with pytest.raises(ValueError, match="each of its own control"):
        margins(linear, [loop, loop])
    with pytest.raises(ValueError, match="between 0 and 1"):
        suggest_gains(linear, [loop], probability=95)
    with pytest.raises(ValueError, match="without paths"):
        suggest_gains(linear_of(glider), [loop])

"""An aircraft of a mass and a span: its inertia is of the right size, and its errors scale what is computed with it."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from made_flights import rms
from numpy.testing import assert_allclose

from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    KINDS,
    MOMENTS,
    QUANTITIES,
    Aerodynamics,
    Air,
    Aircraft,
    stability_derivatives,
)

EXAMPLE = load_example_flights(duration=1.0)
BRUMBY = EXAMPLE.aircraft
# Lengths, planforms, all of ADMIRE and the products of Zagi and Cessna are from memory, not read
# again.
PUBLISHED = {  # mass, span, wing area, length, (Ixx, Iyy, Izz)
    "Aerosonde, Beard & McLain 2012, table E.2": (13.5, 2.8956, 0.55, 1.7, (0.8244, 1.135, 1.759)),
    "Ultra Stick 25e, University of Minnesota": (1.959, 1.27, 0.3097, 1.05, (0.07151, 0.08636, 0.15364)),
    "FASER, Ultra Stick 120, NASA": (10.0, 1.93, 0.736, 1.7, (0.672, 0.889, 1.578)),
    "Skyhunter, ROSflight": (2.28, 1.795, 0.4296, 1.4, (0.141, 0.208, 0.293)),
    "Cessna 172R": (1111.0, 11.0, 16.2, 8.28, (1285.0, 1824.0, 2666.0)),
}  # fmt: skip
PRODUCTS = {  # Ixx, Izz, Ixz
    "Aerosonde": (0.8244, 1.759, 0.1204),
    "Ultra Stick 25e": (0.07151, 0.15364, 0.014),
    "Zagi": (0.1147, 0.1712, 0.0015),
    "Cessna 172": (1285.0, 2666.0, 0.0),
    "Saab J 35": (13050.0, 86200.0, 2520.0),
    "ADMIRE, Forssell & Nilsson 2005": (21000.0, 101000.0, 2500.0),
    "F-16, Stevens & Lewis 2003": (12875.0, 85552.0, 1331.0),
    "F-4, Heffley & Jewell 1972": (33898.0, 189496.0, 2952.0),
}
PLANFORMS = {  # of deltas: span, wing area, length
    "F-102": (11.61, 61.5, 20.82), "F-106": (11.67, 64.8, 21.55), "Mirage III": (8.22, 34.85, 15.03),
    "Mirage 2000": (9.13, 41.0, 14.36), "J 35": (9.42, 49.2, 15.35), "Tejas": (8.2, 38.4, 13.2),
    "Vulcan": (30.2, 330.0, 29.6), "Gripen": (8.4, 30.0, 14.1), "Typhoon": (10.95, 51.2, 15.96),
    "Rafale": (10.9, 45.7, 15.27),
}  # fmt: skip


AXES = ("roll inertia", "pitch inertia", "yaw inertia")


def off_by(aircraft, moments):
    """Return how far published moments of inertia lie from the estimated ones, logarithms over their deviations."""
    stds = [aircraft.deviations[axis].std for axis in AXES]
    return np.log(moments / aircraft.inertia.diagonal()) / stds


class TestPublishedAircraft:
    def test_moments_of_inertia_lie_within_two_standard_deviations(self):
        """With the length told; the deviations of the rule are those of this list, so one in twenty may lie outside."""
        off = []
        for mass, span, area, length, moments in PUBLISHED.values():
            off.append(
                off_by(Aircraft.estimate(mass, span, wing_area=area, length=length), moments)
            )
        assert_allclose(off, 0.0, atol=2.0)
        assert 0.6 < rms(np.ravel(off)) < 1.4  # neither too narrow nor too wide

    def test_planforms_of_deltas(self):
        spans, areas, lengths = np.transpose(list(PLANFORMS.values()))
        rules = KINDS["delta"]["aspect ratio"], KINDS["delta"]["length"]
        for (middle, std), published in zip(
            rules, (spans**2 / areas, lengths / spans), strict=True
        ):
            assert abs(np.mean(np.log(published)) - np.log(middle)) < 0.05
            assert std / 1.5 < np.std(np.log(published)) < std

    def test_products_of_inertia(self):
        std = Aircraft.estimate(2.0, 1.5).deviations["product of inertia"].std
        xx, zz, xz = np.transpose([*PRODUCTS.values()])
        assert_allclose(np.sqrt(np.mean(xz**2 / (xx * zz))), std, atol=0.005)

    @pytest.mark.parametrize("kind", KINDS)
    def test_every_kind_is_a_body(self, kind):
        """No principal moment exceeds the sum of the others (a warning, here an error)."""
        Aircraft.estimate(3.0, 2.0, kind=kind)


def test_the_page_has_the_ratios_of_the_kinds():
    page = Path(__file__).parents[2] / "docs" / "identification.md"
    lines = [line.strip("| ").split(" | ") for line in page.read_text("utf-8").splitlines()]
    (head,) = [line[1:] for line in lines if line[0] == "kind"]
    for kind, ratios in KINDS.items():
        (cells,) = [line[1:] for line in lines if line[0] == kind]
        shown = {name: cell for name, cell in zip(head, cells, strict=True) if cell != "-"}
        assert shown == {name: f"{x:g} ± {100 * std:g} %" for name, (x, std) in ratios.items()}


SIZES = {"mass": 3.0, "span": 1.8}
TOLD = [{}, {"chord": 0.2}, {"wing_area": 0.4}, {"length": 1.1}]


@pytest.mark.parametrize("told", TOLD, ids=str)
def test_powers_of_told_sizes_are_derivatives(told):
    """Factors carry the powers with which quantities follow a told one: the same as of a second estimate."""
    step = 1e-4
    sizes = SIZES | told
    for name, size in sizes.items():
        aircraft = Aircraft.estimate(**sizes | {name: (size, 0.1 * size)})
        more = Aircraft.estimate(**sizes | {name: size * (1 + step)})
        powers = aircraft.deviations[name.replace("_", " ")].powers
        quantities = [
            [each.mass, each.wing_area, each.span, each.chord, *each.inertia.diagonal()]
            for each in (more, aircraft)
        ]
        changes = np.log(np.divide(*quantities)) / step
        names = ("mass", "wing_area", "span", "chord", "Ixx", "Iyy", "Izz")
        assert_allclose(changes, [powers.get(quantity, 0.0) for quantity in names], atol=1e-3)


def test_errors_of_several_causes_add_as_squares():
    """A tape that is 1.5 % long, a drawing whose area is small by 4 %, and a mass: 3, 4 and none of 5 %."""
    deviations = {
        "tape": {"std": 0.015, "powers": {"wing_area": 2.0}},
        "drawing": {"std": 0.04, "powers": {"wing_area": -1.0}},
        "scales": {"std": 0.1, "powers": {"mass": 1.0}},
    }
    aircraft = Aircraft.from_dict(BRUMBY.to_dict() | {"deviations": deviations})
    assert_allclose(aircraft.relative_std("wing_area"), 0.05)


class TestFiles:
    def test_round_trip(self, tmp_path):
        aircraft = Aircraft.estimate((3.2, 0.05), 1.6, name="mine")
        (tmp_path / "a.json").write_text(aircraft.to_json())
        again = Aircraft.from_file(tmp_path / "a.json")
        assert again == aircraft
        assert again.deviations == aircraft.deviations

    def test_pairs_in_a_file_of_everything(self):
        diagonal = np.diag([0.1, 0.15, 0.2]).tolist()
        values = {
            "mass": [3.2, 0.05],
            "inertia": [diagonal, [0.01, 0.015, 0.04]],
            "wing_area": 0.4,
            "span": 1.6,
        }
        aircraft = Aircraft.from_dict(json.loads(json.dumps(values | {"chord": [0.25, 0.01]})))
        assert_allclose(aircraft.relative_std("mass"), 0.05 / 3.2)
        assert_allclose(aircraft.relative_std("Izz"), 0.2)
        found = {cause: round(each.std, 4) for cause, each in aircraft.deviations.items()}
        expected = {
            "mass": 0.0156,
            "chord": 0.04,
            "roll inertia": 0.1,
            "pitch inertia": 0.1,
            "yaw inertia": 0.2,
        }
        assert found == expected
        assert_allclose(aircraft.mass, 3.2)

    @pytest.mark.parametrize(
        ("values", "words"),
        [
            ({"kind": "blimp", "mass": 1.0, "span": 1.0}, "kind='blimp'.*conventional"),
            ({"kind": "twin", "mass": 1.0}, r"lacks \['span'\]"),
            (
                {"kind": "twin", "mass": 1.0, "span": 1.0, "cord": 0.2},
                "unknown key 'cord'.*did you mean 'chord'",
            ),
            (
                {"kind": "twin", "mass": [1.0, -0.1], "span": 1.0},
                "standard deviation of mass=-0.1",
            ),
            ({"mass": 1.0, "span": 1.0}, "kind = one of .* to estimate them"),
        ],
    )
    def test_errors(self, values, words):
        with pytest.raises(ValueError, match=words):
            Aircraft.from_dict(values)


class TestWhatErrorsDo:
    """The same log with the sizes of another aircraft: its forces and accelerations are what they are."""

    CONTROLS = {"elevator": -0.03, "aileron": 0.02, "rudder": 0.04}

    def learned(self, aircraft):
        """Return the coefficients of one log with the sizes of an aircraft: F / (qbar S), I omega_dot / (qbar S b)."""
        force = np.eye(3) * aircraft.mass / BRUMBY.mass
        moments = aircraft.inertia / BRUMBY.inertia.diagonal() * BRUMBY.moment_lengths
        moments = moments / aircraft.moment_lengths[:, None]
        scale = scipy.linalg.block_diag(force, moments) * BRUMBY.wing_area / aircraft.wing_area
        reduced = np.ones(10)
        reduced[2:5] = BRUMBY.moment_lengths / (2 * 36.0)  # p, q, r
        reduced[5:7] = BRUMBY.moment_lengths[1:] / (2 * 36.0)  # alpha_dot, beta_dot
        names = EXAMPLE.regressor_names
        return Aerodynamics(lambda X: EXAMPLE.aerodynamics(X * reduced) @ scale.T, names)

    @pytest.mark.parametrize(
        "cause", ["mass", "span", "aspect ratio", "length", "product of inertia", *AXES[::2]]
    )
    def test_relative_errors_are_those_of_a_second_identification(self, cause, state):
        factor = Aircraft.estimate((60.0, 0.6), (BRUMBY.span, 0.01)).deviations[cause]
        sizes = BRUMBY.to_dict() | {"deviations": {cause: {"std": 1e-5, "powers": factor.powers}}}
        diagonal = np.diag(BRUMBY.inertia.diagonal())
        known = Aircraft.from_dict(sizes | {"inertia": diagonal})
        growth = {name: 1.00001**power for name, power in factor.powers.items()}
        grown = {name: getattr(known, name) * growth.get(name, 1.0) for name in QUANTITIES}
        inertia = diagonal * [growth.get(name, 1.0) for name in MOMENTS]
        inertia[[0, 2], [2, 0]] = (
            -1e-5 * factor.powers.get("Ixz", 0.0) * np.sqrt(inertia[0, 0] * inertia[2, 2])
        )
        other = Aircraft.from_dict(sizes | grown | {"inertia": inertia})
        at = {"thrust": None, "air": Air(density=1.1)}
        table, changed = (
            stability_derivatives(self.learned(each), each, state, self.CONTROLS, **at)
            for each in (known, other)
        )
        change = changed["value"] - table["value"]
        assert_allclose(np.abs(change), table["std_aircraft"], rtol=1e-3, atol=1e-9)
        assert set(table["aircraft"]) <= {cause, ""}

"""DAVE-ML files, read by an evaluator written from the standard (AIAA S-119)."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from skdgp.export import build_up, write_dave_ml

pytestmark = pytest.mark.filterwarnings("ignore:The fit stopped at max_iter")
COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
D, M = "{http://daveml.org/2010/DAVEML}", "{http://www.w3.org/1998/Math/MathML}"


def numbers(text):
    return np.array([float(word) for word in text.replace(",", " ").split()])


class Evaluator:
    """Variables by name and ID; functions of gridded tables, the last breakpoint varies fastest; content MathML."""

    def __init__(self, path):
        self.root = ET.parse(path).getroot()
        self.variables = {v.get("varID"): v for v in self.root.iter(f"{D}variableDef")}
        self.ids = {v.get("name"): key for key, v in self.variables.items()}
        self.points = {b.get("bpID"): numbers(b.find(f"{D}bpVals").text) for b in self.root.iter(f"{D}breakpointDef")}
        self.functions = {f.find(f"{D}dependentVarRef").get("varID"): f for f in self.root.iter(f"{D}function")}

    def value(self, key, given):
        if key in given:
            return given[key]
        if key in self.functions:
            return self.looked_up(self.functions[key], given)
        calculation = self.variables[key].find(f"{D}calculation")
        if calculation is None:
            return float(self.variables[key].get("initialValue"))
        return self.computed(calculation.find(f"{M}math")[0], given)

    def computed(self, element, given):
        if element.tag == f"{M}ci":
            return self.value(element.text, given)
        if element.tag == f"{M}cn":
            return float(element.text)
        operator, *rest = element
        values = [self.computed(each, given) for each in rest]
        return {"plus": sum, "times": np.prod, "minus": lambda v: v[0] - v[1]}[operator.tag.removeprefix(M)](values)

    def looked_up(self, function, given):
        refs = function.findall(f"{D}independentVarRef")
        assert all(ref.get("extrapolate") == "neither" for ref in refs)
        grid = function.find(f"{D}functionDefn/{D}griddedTableDef")
        axes = [self.points[ref.get("bpID")] for ref in grid.iter(f"{D}bpRef")]
        at = [np.clip(self.value(ref.get("varID"), given), p[0], p[-1]) for ref, p in zip(refs, axes, strict=True)]
        cells = numbers(grid.find(f"{D}dataTable").text).reshape([len(points) for points in axes])
        return RegularGridInterpolator(axes, cells)(at)[0]

    def signals(self, parent):
        for signal in parent:
            yield self.ids[signal.find(f"{D}signalName").text], float(signal.find(f"{D}signalValue").text)


@pytest.fixture(scope="module")
def build(fitted, uav):
    return build_up(fitted("joint"), uav, max_loss=np.inf, tolerance=1.0)


@pytest.fixture(scope="module")
def model(build, tmp_path_factory):
    path = tmp_path_factory.mktemp("dave") / "uav.dml"
    write_dave_ml(path, build)
    return Evaluator(path)


def test_check_cases_are_reproduced(model, build):
    shots = list(model.root.iter(f"{D}staticShot"))
    assert len(shots) == 16
    for shot in shots:
        given = dict(model.signals(shot.find(f"{D}checkInputs")))
        assert list(given) == list(build.regressors)
        for key, expected in model.signals(shot.find(f"{D}checkOutputs")):
            assert model.value(key, given) == pytest.approx(expected, abs=1e-9)


def test_outputs_are_the_build_up_beyond_the_flights_too(model, build):
    X = build.samples[:4] * 1.5
    for x, expected in zip(X, build.evaluate(X), strict=True):
        given = dict(zip(build.regressors, x, strict=True))
        np.testing.assert_allclose([model.value(name, given) for name in COEFFICIENTS], expected, atol=1e-9)


def test_stated_deviations_are_those_of_the_posterior(model, fitted, build):
    """One standard deviation: of derivatives and constants of a trend exactly, of cells as in the build-up."""
    normal = f"{D}uncertainty/{D}normalPDF"
    for name in COEFFICIENTS:
        for k, table in enumerate(build.tables[name]):
            grid = model.functions[f"{name}_t{k}"].find(f"{D}functionDefn/{D}griddedTableDef")
            assert grid.find(normal).get("numSigmas") == "1"
            stated = numbers(grid.find(f"{normal}/{D}bounds/{D}dataTable").text)
            np.testing.assert_allclose(stated, table.std.ravel(), rtol=0.01)
        stated = [float(model.variables[f"{name}_{r}"].find(f"{normal}/{D}bounds").text) for r in build.regressors]
        np.testing.assert_allclose(stated, build.derivatives_std.loc[name], rtol=0.01)


def test_elements_stand_in_the_order_of_the_standard(model):
    tags = [element.tag.removeprefix(D) for element in model.root]
    order = ["fileHeader", "variableDef", "breakpointDef", "function", "checkData"]
    assert list(dict.fromkeys(tags)) == order
    assert [order.index(tag) for tag in tags] == sorted(order.index(tag) for tag in tags)
    own = {"variableDef": "varID", "breakpointDef": "bpID", "griddedTableDef": "gtID"}
    identifiers = [e.get(key) for tag, key in own.items() for e in model.root.iter(f"{D}{tag}")]
    assert len(identifiers) == len(set(identifiers))


def test_number_of_checks(build, tmp_path):
    with pytest.raises(ValueError, match="at least one check case"):
        write_dave_ml(tmp_path / "uav.dml", build, n_checks=0)

"""DAVE-ML files, read by an evaluator written from the standard (AIAA S-119)."""

import math
import xml.etree.ElementTree as ET
from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import RegularGridInterpolator
from sklearn.pipeline import Pipeline

from skdgp.export import build_up, portable_model, write_dave_ml
from skdgp.preprocessing import RegressorSelector

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
D, M = "{http://daveml.org/2010/DAVEML}", "{http://www.w3.org/1998/Math/MathML}"
NORMAL = f"{D}uncertainty/{D}normalPDF"
OPERATORS = {
    "plus": sum,
    "times": math.prod,
    "minus": lambda v: v[0] - v[1],
    "power": lambda v: v[0] ** v[1],
}
CHILDREN = {  # of the elements that occur, in the order of the standard; + for one or more
    "DAVEfunc": "fileHeader variableDef+ breakpointDef+ function+ checkData",
    "fileHeader": "author creationDate description",
    "variableDef": "description calculation isInput isOutput uncertainty",
    "breakpointDef": "description bpVals",
    "function": "independentVarRef+ dependentVarRef functionDefn",
    "griddedTableDef": "breakpointRefs uncertainty dataTable",
    "normalPDF": "bounds correlatesWith+ correlation+",
    "staticShot": "checkInputs internalValues checkOutputs",
    "signal": "signalName signalUnits varID signalValue tol",
}
IDENTIFIERS = {"variableDef": "varID", "breakpointDef": "bpID", "griddedTableDef": "gtID"}
REFERENCES = {
    "variableRef",
    "independentVarRef",
    "dependentVarRef",
    "bpRef",
    "correlatesWith",
    "correlation",
}


def numbers(text):
    return np.array([float(word) for word in text.replace(",", " ").split()])


class Evaluator:
    """Variables by name and ID; functions of gridded tables, the last breakpoint varies fastest; content MathML."""

    def __init__(self, path):
        self.root = ET.parse(path).getroot()
        self.variables = {v.get("varID"): v for v in self.root.iter(f"{D}variableDef")}
        self.ids = {v.get("name"): key for key, v in self.variables.items()}
        self.points = {
            b.get("bpID"): numbers(b.find(f"{D}bpVals").text)
            for b in self.root.iter(f"{D}breakpointDef")
        }
        self.functions = {
            f.find(f"{D}dependentVarRef").get("varID"): f for f in self.root.iter(f"{D}function")
        }

    def value(self, key, given):
        """Return a variable; ``given`` holds the inputs, and then all that was computed."""
        if key not in given:
            calculation = self.variables[key].find(f"{D}calculation")
            if key in self.functions:
                given[key] = self.looked_up(self.functions[key], given)
            elif calculation is None:
                given[key] = float(self.variables[key].get("initialValue"))
            else:
                given[key] = self.computed(calculation.find(f"{M}math")[0], given)
        return given[key]

    def computed(self, element, given):
        if element.tag == f"{M}ci":
            return self.value(element.text, given)
        if element.tag == f"{M}cn":
            return float(element.text)
        operator, *rest = element
        return OPERATORS[operator.tag.removeprefix(M)](
            [self.computed(each, given) for each in rest]
        )

    def looked_up(self, function, given):
        refs = function.findall(f"{D}independentVarRef")
        assert all(ref.get("extrapolate") == "neither" for ref in refs)
        grid = function.find(f"{D}functionDefn/{D}griddedTableDef")
        axes = [self.points[ref.get("bpID")] for ref in grid.iter(f"{D}bpRef")]
        at = [
            np.clip(self.value(ref.get("varID"), given), p[0], p[-1])
            for ref, p in zip(refs, axes, strict=True)
        ]
        cells = numbers(grid.find(f"{D}dataTable").text).reshape([len(points) for points in axes])
        return RegularGridInterpolator(axes, cells)(at)[0]

    def signals(self, parent):
        """Return value and tolerance of each signal, by the ID of its variable."""
        found = {}
        for signal in parent:
            key = signal.findtext(f"{D}varID") or self.ids[signal.find(f"{D}signalName").text]
            found[key] = (
                float(signal.findtext(f"{D}signalValue")),
                float(signal.findtext(f"{D}tol") or "nan"),
            )
        return found

    def shots(self):
        """Yield inputs, and the expected signals inside and at the outputs, of each check case."""
        for shot in self.root.iter(f"{D}staticShot"):
            given = {
                key: value for key, (value, _) in self.signals(shot.find(f"{D}checkInputs")).items()
            }
            inside = shot.find(f"{D}internalValues")
            yield (
                given,
                self.signals(() if inside is None else inside),
                self.signals(shot.find(f"{D}checkOutputs")),
            )

    def correlation(self, names):
        found = np.eye(len(names))
        for k, name in enumerate(names):
            normal = self.variables[name].find(NORMAL)
            assert [e.get("varID") for e in normal.iter(f"{D}correlatesWith")] == names[k + 1 :]
            for e in normal.iter(f"{D}correlation"):
                j = names.index(e.get("varID"))
                found[k, j] = found[j, k] = float(e.get("corrCoef"))
        return found


@pytest.fixture(scope="module")
def build(fitted, uav):
    return build_up(fitted("joint"), uav, max_loss=np.inf, tolerance=1.0)


@pytest.fixture(scope="module", params=["sparse", "sparse-average"])
def pipeline(request, fitted, regressors):
    """Return a pipeline of a sparse model that has a portable form."""
    names = list(regressors.columns)
    return Pipeline(
        [("selector", RegressorSelector(names).fit(regressors)), *fitted(request.param).steps]
    )


@pytest.fixture(scope="module")
def path(build, pipeline, uav, tmp_path_factory):
    """Return the file of each form, written once."""
    folder, model = tmp_path_factory.mktemp("dave"), {"tables": build, "functions": pipeline}

    @cache
    def get(form):
        write_dave_ml(folder / f"{form}.dml", model[form], uav, form=form)
        return folder / f"{form}.dml"

    return get


def test_functions_reproduce_the_model(path, pipeline, regressors):
    """Check cases are those of the pipeline to 1e-6, deviations within 1 %."""
    model = Evaluator(path("functions"))
    shots = list(model.shots())
    assert len(shots) == 16
    X = regressors.iloc[:0].reindex(range(16))
    for k, (given, _, _) in enumerate(shots):
        X.loc[k] = [given[name] for name in X]
    mean, std = pipeline[-1].predict(
        pipeline[:-1].transform(X), return_std=True, include_input_noise=False
    )
    off = []
    for (given, inside, outputs), expected, deviation in zip(shots, mean, std, strict=True):
        assert [value for value, _ in outputs.values()] == pytest.approx(expected, abs=1e-9)
        assert all(
            abs(model.value(key, given) - value) <= tol < 1e-6
            for key, (value, tol) in outputs.items()
        )
        assert [value for value, _ in inside.values()] == pytest.approx(deviation, rel=1e-6)
        off.append(
            [
                model.value(f"{name}_std", given) / s - 1
                for name, s in zip(COEFFICIENTS, deviation, strict=True)
            ]
        )
    assert np.sqrt(np.mean(np.square(off))) < 0.01
    for name in COEFFICIENTS:
        normal = model.variables[name].find(NORMAL)
        assert normal.get("numSigmas") == "1"
        assert normal.find(f"{D}bounds/{D}variableRef").get("varID") == f"{name}_std"


def test_correlation_of_the_coefficients_is_that_of_drawn_functions(
    path, pipeline, regressors, uav
):
    """At the samples of the envelope, over which it is averaged."""
    model = Evaluator(path("functions"))
    stated = model.correlation(COEFFICIENTS)
    samples = pd.DataFrame(
        portable_model(pipeline, uav).envelope.samples, columns=regressors.columns
    )
    drawn = pipeline[-1].sample_y(pipeline[:-1].transform(samples), 4000, random_state=0)
    off = drawn - drawn.mean(axis=-1, keepdims=True)
    covariance = np.einsum("nis,njs->ij", off, off)
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(stated, covariance / np.multiply.outer(size, size), atol=0.05)
    assert np.linalg.eigvalsh(stated).min() > 0


def test_tables_are_the_build_up(path, build):
    """Also beyond the flights; check cases are the model within their tolerance."""
    model = Evaluator(path("tables"))
    rows = np.linspace(0, len(build.samples) - 1, 16).astype(int)
    for (given, _, outputs), row in zip(model.shots(), rows, strict=True):
        assert [value for value, _ in outputs.values()] == pytest.approx(
            build.predicted[row], abs=1e-12
        )
        assert all(
            abs(model.value(key, given) - value) <= tol for key, (value, tol) in outputs.items()
        )
    X = build.samples[:4] * 1.5
    for x, expected in zip(X, build.evaluate(X), strict=True):
        given = dict(zip(build.regressors, x, strict=True))
        np.testing.assert_allclose(
            [model.value(name, given) for name in COEFFICIENTS], expected, atol=1e-9
        )


def test_stated_deviations_are_those_of_the_posterior(path, build):
    """One standard deviation of constants, derivatives and cells, as in the build-up."""
    model = Evaluator(path("tables"))
    for name in COEFFICIENTS:
        for k, table in enumerate(build.tables[name]):
            grid = model.functions[f"{name}_t{k}"].find(f"{D}functionDefn/{D}griddedTableDef")
            assert grid.find(NORMAL).get("numSigmas") == "1"
            stated = numbers(grid.find(f"{NORMAL}/{D}bounds/{D}dataTable").text)
            np.testing.assert_allclose(stated, table.std.ravel(), rtol=0.01)
        names = [f"{name}_0", *(f"{name}_{r}" for r in build.regressors)]
        stated = [float(model.variables[each].find(f"{NORMAL}/{D}bounds").text) for each in names]
        np.testing.assert_allclose(stated[1:], build.derivatives_std.loc[name], rtol=0.01)
        np.testing.assert_allclose(model.correlation(names), build.correlation(name), atol=1e-9)


@pytest.mark.parametrize("form", ["functions", "tables"])
def test_structure_is_that_of_the_standard(path, form):
    root = ET.parse(path(form)).getroot()
    for parent in root.iter():
        if order := CHILDREN.get(parent.tag.removeprefix(D)):
            tags, allowed = (
                [e.tag.removeprefix(D) for e in parent],
                [tag.rstrip("+") for tag in order.split()],
            )
            assert [allowed.index(tag) for tag in tags] == sorted(
                allowed.index(tag) for tag in tags
            )
            assert all(tags.count(tag) <= 1 for tag in tags if f"{tag}+" not in order.split())
    own = [e.get(key) for tag, key in IDENTIFIERS.items() for e in root.iter(f"{D}{tag}")]
    assert len(own) == len(set(own))
    references = [
        e.get("varID") or e.get("bpID") for tag in REFERENCES for e in root.iter(f"{D}{tag}")
    ]
    assert set(references) | {e.text for e in root.iter(f"{M}ci")} <= set(own)


def test_bad_input(pipeline, uav, tmp_path):
    with pytest.raises(ValueError, match="expected 'functions' or 'tables'"):
        write_dave_ml(tmp_path / "uav.dml", pipeline, uav, form="graph")

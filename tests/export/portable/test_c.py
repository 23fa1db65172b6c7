"""The model in C: compiled by a strict compiler and compared with Python."""

import ctypes
import shutil
import subprocess
from functools import partial

import numpy as np
import pytest

from skdgp.export import export_model, write_c
from skdgp.export._c import c_bytes
from skdgp.export._reduce import loss_of, reduced

STRICT = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
CHECKED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


@pytest.fixture(scope="module", autouse=True)
def compiler():
    if shutil.which("gcc") is None:
        pytest.skip("gcc compiles the exported model, and is not installed")


def compiled(folder, *words):
    done = subprocess.run(
        [*STRICT, *words], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder / words[words.index("-o") + 1]


class Library:
    """The functions of aero.c, called from Python."""

    def __init__(self, folder, model, kind):
        self.library = ctypes.CDLL(
            str(compiled(folder, "-O0", "-shared", "-fPIC", "aero.c", "-o", "aero.so", "-lm"))
        )
        self.library.aero_beyond.restype = ctypes.c_ulong
        self.kind, self.shape = kind, (len(model.outputs), len(model.regressors))

    def __call__(self, name, values, shape):
        given, out = (
            np.ascontiguousarray(values, dtype=self.kind),
            [np.empty(s, dtype=self.kind) for s in shape],
        )
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (given, *out)]
        found = getattr(self.library, name)(*pointers)
        return [array.astype(float) for array in out] or found

    def predict(self, x):
        return self("aero_predict", x, [self.shape[:1]] * 2)

    def gradient(self, x):
        return self("aero_gradient", x, [self.shape])[0]

    def inputs(self, source):
        return self("aero_inputs", source, [self.shape[1:]])[0]

    def beyond(self, x):
        return self("aero_beyond", x, [])


@pytest.mark.parametrize(
    ("kind", "precision", "tolerance"),
    [("full", "double", 1e-9), ("sparse", "double", 1e-9), ("sparse", "float", 1e-4)],
)
def test_says_what_the_model_says(portable_of, kind, precision, tolerance, flight, tmp_path):
    model = portable_of(kind)
    write_c(tmp_path, model, precision=precision)
    test = compiled(tmp_path, *CHECKED, "aero.c", "test_aero.c", "-o", "test", "-lm")
    done = subprocess.run([test], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    assert "passed: 40 points" in done.stdout

    number = np.float64 if precision == "double" else np.float32
    library, X = Library(tmp_path, model, number), model.regressor_values(flight)
    X = X.astype(number).astype(float)
    mean, std = model.predict(X, return_std=True, include_input_noise=False)
    found = np.array([library.predict(x) for x in X])
    for ours, theirs, error in ((mean, found[:, 0], 0.0), (std, found[:, 1], model.rounding(X))):
        assert (
            np.abs(theirs - ours) <= np.maximum(tolerance * np.abs(ours).max(axis=0), error)
        ).all()
    slopes = model.predict_gradient(X) * model.scale
    slopes_found = np.array([library.gradient(x) for x in X]) * model.scale
    np.testing.assert_allclose(slopes_found, slopes, atol=tolerance * np.abs(slopes).max())
    outside = [bool(library.beyond(x)) for x in X]
    assert outside == (~model.envelope.inside(X)).tolist()
    assert library.beyond(np.where(np.arange(5) == 2, np.nan, X[np.argmin(outside)])) == 2**2


def test_inputs_of_flight_data(portable_of, flight, tmp_path):
    model = portable_of("trend")
    write_c(tmp_path, model)
    library = Library(tmp_path, model, np.float64)
    names = ["alpha", "beta", "q", "airspeed", "elevon_left", "elevon_right"]
    assert ", ".join(names) in (tmp_path / "aero.h").read_text()
    found = np.array([library.inputs(row) for row in flight[names].to_numpy()])
    np.testing.assert_allclose(found, model.regressor_values(flight), rtol=1e-14)


def test_make_test_passes(portable_of, tmp_path):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    write_c(tmp_path, portable_of("trend"))
    done = subprocess.run(
        ["make", "test"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "time of a row" in done.stdout


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_size_is_kept(portable_of, precision, tmp_path):
    model = portable_of("sparse-constant")
    most = 0.6 * c_bytes(model, precision) / 1024
    small = reduced(model, partial(c_bytes, precision=precision), int(1024 * most))
    facts = export_model(tmp_path, model, "c", precision=precision, max_kb=most)
    assert facts["loss"] == loss_of(small) != {}
    compiled(tmp_path, "-Os", "-c", "aero.c", "-o", "aero.o")
    size = subprocess.run(
        ["size", "aero.o"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    assert (
        sum(map(int, size.splitlines()[1].split()[:3])) < c_bytes(small, precision) <= 1024 * most
    )
    assert export_model(tmp_path, model, "c", precision=precision, max_kb=1e4)["loss"] == {}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"precision": "half"}, r"precision='half', but expected 'double' or 'float'"),
        ({"max_kb": 0}, "max_kb=0, but expected a size > 0"),
        ({"max_kb": 1}, "the smallest form of this model takes"),
    ],
)
def test_what_is_no_option_is_refused(portable_of, tmp_path, words, message):
    with pytest.raises(ValueError, match=message):
        export_model(tmp_path, portable_of("sparse"), "c", **words)
    assert not list(tmp_path.iterdir())


def test_a_model_too_large_for_a_compiler(portable_of, tmp_path, monkeypatch):
    monkeypatch.setattr("skdgp.export._c.MAX_BYTES", 1000)
    with pytest.raises(ValueError, match="give max_kb=256"):
        write_c(tmp_path, portable_of("exact"))

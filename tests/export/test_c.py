"""The model in C: compiled by a strict compiler and compared with the pipeline."""

import ctypes
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from skdgp.export import export_model

STRICT = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Wtrigraphs", "-Werror", "-pedantic"]
CHECKED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


@pytest.fixture(scope="module", autouse=True)
def compiler():
    if shutil.which("gcc") is None:
        pytest.skip("gcc compiles the exported model, and is not installed")


def done(folder, *words):
    """Run a command in a folder, and return what it printed."""
    run = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr + run.stdout
    return run.stdout


class Library:
    """The functions of aero.c, called from Python."""

    def __init__(self, folder, model):
        done(folder, *STRICT, "-O0", "-shared", "-fPIC", "aero.c", "-o", "aero.so", "-lm")
        self.library = ctypes.CDLL(str(folder / "aero.so"))
        self.shape = (len(model.outputs), len(model.regressors))

    def __call__(self, name, values, *shapes):
        arrays = [np.ascontiguousarray(values), *(np.empty(shape) for shape in shapes)]
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]
        getattr(self.library, f"aero_{name}")(*pointers)
        return arrays[1:]


def test_equals_the_pipeline(written, read, tmp_path):
    model = written.model
    export_model(tmp_path, model, "c")
    done(tmp_path, *STRICT, *CHECKED, "aero.c", "test_aero.c", "-o", "test", "-lm")
    assert "passed: 40 points, with the values of the pipeline" in done(tmp_path, "./test")
    export_model(tmp_path, model, "c")  # over its own files
    (tmp_path / "Makefile").write_text("all:\n")
    with pytest.raises(FileExistsError, match="Makefile, which is of something else"):
        export_model(tmp_path, model, "c")

    library = Library(tmp_path, model)
    P, d = library.shape
    found = np.array([library("predict", x, P, P) for x in written.X])
    written.assert_mean(found[:, 0])
    written.assert_std(found[:, 1])
    written.assert_slopes([library("gradient", x, (P, d))[0] for x in written.X])
    limits = (ctypes.c_double * (2 * d)).in_dll(library.library, "aero_limits")
    assert_array_equal(np.reshape(limits, (2, d)), model.limits)
    sources = written.flight[:50][list(model.columns)]
    inputs = [library("inputs", row, d)[0] for row in sources.to_numpy(float)]
    assert_allclose(inputs, read(model).regressors(sources), rtol=1e-12, atol=1e-14)
    header = (tmp_path / "aero.h").read_text()
    assert ", ".join(model.columns) in header
    assert "AERO_SERVO_RATE 0.0\n" in header  # without a limit


WRONG = {
    "trend": lambda model: replace(
        model,
        parts=[
            replace(model.parts[0], trend_weights=model.parts[0].trend_weights + 0.001),
            *model.parts[1:],
        ],
    ),
    "deviation": lambda model: replace(
        model,
        parts=[replace(part, prior_variance=part.prior_variance + 1e-4) for part in model.parts],
    ),
    "slope": lambda model: replace(
        model,
        reference=replace(model.reference, slopes=model.reference.slopes * (1 + 1e-8)),
    ),
    "scale": lambda model: replace(model, output_scale=model.output_scale * (1 + 1e-6)),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_model_that_differs_from_its_pipeline_fails_its_test(case_of, tmp_path, wrong):
    export_model(tmp_path, WRONG[wrong](case_of("identified").model), "c")
    done(tmp_path, *STRICT, "aero.c", "test_aero.c", "-o", "test", "-lm")
    run = subprocess.run("./test", cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert "FAILED" in run.stdout

"""CasADi and ONNX, evaluated by their own runtimes."""

import sys

import numpy as np
import pytest

from skdgp.export import _reduce as reduce_module
from skdgp.export import casadi_function, export_model, onnx_model

KINDS = ["exact", "full", "constant", "trend", "sparse-additive", "precise"]


def close(ours, theirs, tolerance=1e-9):
    np.testing.assert_allclose(ours, theirs, atol=tolerance * np.abs(theirs).max())


def close_deviations(ours, model, X):
    std = model.predict(X, return_std=True, include_input_noise=False)[1]
    assert (np.abs(ours - std) <= np.maximum(1e-9 * std.max(), model.rounding(X))).all()


@pytest.mark.parametrize("kind", KINDS)
def test_casadi(portable_of, flight, kind, tmp_path):
    casadi = pytest.importorskip(
        "casadi", reason='evaluates the function: pip install "skdgp[export]"'
    )
    model = portable_of(kind)
    export_model(tmp_path, model, "casadi")
    function = casadi.Function.load(str(tmp_path / "aero.casadi"))
    X = model.regressor_values(flight)[:5]
    mean, std, jacobian = (np.array(values) for values in zip(*map(function, X), strict=True))
    close(mean[..., 0], model.predict(X))
    close_deviations(std[..., 0], model, X)
    close(jacobian * model.scale, model.predict_gradient(X) * model.scale, 1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_onnx(portable_of, flight, kind, tmp_path):
    pytest.importorskip("onnx", reason='writes the graph: pip install "skdgp[export]"')
    runtime = pytest.importorskip(
        "onnxruntime", reason="evaluates the graph: pip install onnxruntime"
    )
    model = portable_of(kind)
    export_model(tmp_path, model, "onnx")
    session = runtime.InferenceSession(tmp_path / "aero.onnx")
    X = model.regressor_values(flight)
    mean, std = session.run(None, {"x": X})
    close(mean, model.predict(X), 1e-10)
    close_deviations(std, model, X)
    names = session.get_modelmeta().custom_metadata_map
    assert names["regressors"].split(",") == list(model.regressor_names)
    assert names["content_hash"] == model.content_hash


@pytest.mark.parametrize(("write", "package"), [(casadi_function, "casadi"), (onnx_model, "onnx")])
def test_what_is_not_installed_is_named(exact, write, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=r'pip install "skdgp\[export\]"'):
        write(exact)


def test_a_model_too_large_for_a_graph(exact, monkeypatch):
    monkeypatch.setattr(reduce_module, "MAX_TERMS", 1000)
    with pytest.raises(ValueError, match="give max_kb=256"):
        reduce_module.check_terms(exact)

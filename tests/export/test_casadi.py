"""The function of CasADi, evaluated by CasADi."""

import sys

import numpy as np
import pytest

from skdgp.export import casadi_function, export_model


def assert_close(found, expected, tolerance=1e-9):
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


def assert_close_deviations(found, model, X):
    std = model.predict(X, return_std=True, include_input_noise=False)[1]
    assert (np.abs(found - std) <= np.maximum(1e-9 * std.max(), model.rounding(X))).all()


def test_casadi(portable, flight, tmp_path):
    reason = 'evaluates the function: pip install "skdgp[export]"'
    casadi = pytest.importorskip("casadi", reason=reason)
    (path,) = export_model(tmp_path, portable, "casadi")["files"]
    function = casadi.Function.load(str(path))
    X = portable.regressor_values(flight)[:5]
    mean, std, jacobian = (np.array(values) for values in zip(*map(function, X), strict=True))
    assert_close(mean[..., 0], portable.predict(X))
    assert_close_deviations(std[..., 0], portable, X)
    assert_close(jacobian * portable.scale, portable.predict_gradient(X) * portable.scale, 1e-8)


def test_what_is_not_installed_is_named(portable_of, monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ImportError, match=r"pip install 'skdgp\[export\]'"):
        casadi_function(portable_of("trend"))

"""The function of CasADi, evaluated by CasADi."""

import sys

import numpy as np
import pytest

from skdgp.export import casadi_function, export_model


def test_equals_the_pipeline(written, tmp_path):
    reason = 'evaluates the function: pip install "skdgp[export]"'
    casadi = pytest.importorskip("casadi", reason=reason)
    both, alone = export_model(tmp_path, written.model, "casadi")
    function = casadi.Function.load(str(both))
    mean, std, jacobian = (
        np.array(values) for values in zip(*map(function, written.X), strict=True)
    )
    written.assert_mean(mean[..., 0])
    written.assert_std(std[..., 0])
    written.assert_slopes(jacobian, 1e-8)
    mean_function = casadi.Function.load(str(alone))
    assert (mean_function.name(), mean_function.name_out()) == ("aero_mean", ["mean"])
    written.assert_mean(np.array([mean_function(x) for x in written.X])[..., 0])


def test_what_is_not_installed_is_named(portable_of, monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ImportError, match=r"pip install 'skdgp\[export\]'"):
        casadi_function(portable_of("trend"))

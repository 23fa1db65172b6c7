"""The function of CasADi, evaluated by CasADi."""

import sys
from pathlib import Path

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


class Saved:
    """A function of CasADi that is saved, or cannot be."""

    def __init__(self, name, fails):
        self.name = lambda: name
        self.fails = fails

    def save(self, path):
        Path(path).write_text("half" if self.fails else "whole")
        if self.fails:
            raise OSError("the disk is full")


@pytest.mark.parametrize("fails", [False, True])
def test_saves_both_files_or_none(fails, portable_of, monkeypatch, tmp_path):
    """The second one fails: an earlier export stays as it was."""
    files = [tmp_path / "aero.casadi", tmp_path / "aero_mean.casadi"]
    for file in files:
        file.write_text("earlier")
    functions = {False: Saved("aero", False), True: Saved("aero_mean", fails)}
    monkeypatch.setattr(
        "skdgp.export._casadi.casadi_function", lambda model, mean_only: functions[mean_only]
    )
    if fails:
        with pytest.raises(OSError, match="the disk is full"):
            export_model(tmp_path, portable_of("trend"), "casadi")
    else:
        assert export_model(tmp_path, portable_of("trend"), "casadi") == files
    assert [file.read_text() for file in files] == ["earlier" if fails else "whole"] * 2
    assert sorted(tmp_path.iterdir()) == files

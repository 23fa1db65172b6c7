"""A surface under another name is refused with its name, a missing elevator is warned of."""

import warnings

import pandas as pd
import pytest

from skdgp.identification._flights import check_controls

TABLE = pd.DataFrame({"time": [0.0, 0.1]}).assign(alpha=0.0, q=0.0, aileron=0.0, rudder=0.0)


def test_another_name():
    with pytest.raises(ValueError, match=r"did you mean 'de'\?.*--rename de=elevator"):
        check_controls({"a": TABLE.assign(de=0.0)}, "quasi-steady")


def test_no_elevator():
    with pytest.warns(UserWarning, match="without an elevator"):
        check_controls({"a": TABLE}, "quasi-steady")


@pytest.mark.parametrize("given", ["elevator", "elevon_left"])
def test_what_needs_none(given):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_controls({"a": TABLE.assign(**{given: 0.0})}, "quasi-steady")
        check_controls({"a": TABLE.assign(de=0.0)}, ["alpha", "aileron"])

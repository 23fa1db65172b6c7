"""Whatever a table is written as, the same numbers are read."""

import csv

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp.io import read_flight

NUMBERS = [1 / 3, -5e-324, 1.7976931348623157e308, np.nan, 123456789.12345679, 1e-7]
STRANGE = 'wind, "left";\nof the\tmast'


@pytest.mark.parametrize("flights", [("=1+1", "-1"), ("007", "1e3"), ("Höhe; 3", 'the "last", b')])
@pytest.mark.parametrize("quoting", [csv.QUOTE_MINIMAL, csv.QUOTE_ALL, csv.QUOTE_NONNUMERIC])
@pytest.mark.parametrize(
    ("separator", "mark"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]
)
def test_csv(tmp_path, flights, quoting, separator, mark):
    table = pd.DataFrame({STRANGE: NUMBERS[::-1], "time": 0.02 * np.arange(6), "north": NUMBERS})
    table["flight"] = np.repeat(flights, 3)
    path = tmp_path / "log.csv"
    table.to_csv(path, sep=separator, decimal=mark, quoting=quoting, index=False)
    found = read_flight(path)
    assert set(found) == set(table)
    assert found["flight"].tolist() == table["flight"].tolist()
    numbers = [STRANGE, "time", "north"]
    # old versions of pandas round the last digit
    assert_allclose(found[numbers], table[numbers], rtol=4e-16)

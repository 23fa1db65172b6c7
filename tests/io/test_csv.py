"""CSV files as people and programs write them: the table of the page, case by case."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.io import FlightReadError, read_flight

RIGHT = {"time": [0.0, 0.02], "alpha": [0.1, 0.2]}
DEGREE = np.pi / 180

# Case of the page: files, and the columns that come of each, or words of the refusal.
CASES = {
    "separator": (
        [
            "time,alpha\n0,.1\n.02,.2\n",
            "time;alpha\n0;.1\n.02;.2\n",
            "time\talpha\n0\t.1\n.02\t.2\n",
        ],
        RIGHT,
    ),
    "byte order mark, line ends": (
        [
            "\ufefftime,alpha\r\n0,.1\r\n.02,.2\r\n",
            "time,alpha\r0,.1\r.02,.2\r",
            "time,alpha\n0,.1\n.02,.2",
        ],
        RIGHT,
    ),
    "quoted name": (
        ['"pilot, name",time,airspeed,alpha\nAnn,0,20,.1\nBob,.02,21,.2\n'],
        {**RIGHT, "airspeed": [20, 21], "pilot, name": ["Ann", "Bob"]},
    ),
    "quoted name over two lines": (
        ['"wind\nspeed",time,alpha\n7,0,.1\n8,.02,.2\n'],
        {**RIGHT, "wind\nspeed": [7, 8]},
    ),
    "quotes within quotes": (
        ['"a ""b""",time,alpha\n7,0,.1\n8,.02,.2\n'],
        {**RIGHT, 'a "b"': [7, 8]},
    ),
    "quoted cell": (
        [
            'time,note,alpha\n0,"gust, left",.1\n.02,"a\nb",.2\n',
            'time, note, alpha\n0, "gust, left", .1\n.02,"a\nb",.2\n',
        ],
        {**RIGHT, "note": ["gust, left", "a\nb"]},
    ),
    "quotes that do not end": (['time,alpha\n0,".1\n.02,.2\n'], "not a CSV table|unequal length"),
    "units in the header": (
        ["time [ms],alpha [deg]\n0,1\n20,2\n", "time (ms);alpha (°)\n0;1\n20;2\n"],
        {"time": [0, 0.02], "alpha": [DEGREE, 2 * DEGREE]},
    ),
    "unit of another quantity or system, such as kgf": (
        ["time,thrust_x [kgf]\n0,1\n0.02,2\n", "time,alpha [m/s]\n0,1\n0.02,2\n"],
        r"Got unit '(kgf|m/s)' for column '\w+', but expected one of",
    ),
    "units under the header": (
        ["time,alpha\nms,deg\n0,1\n20,2\n", "time [ms],alpha\ns,deg\n0,1\n20,2\n"],
        "in column 'time' at row 0 .* unit in the header",
    ),
    "dates": (
        [
            "time,alpha\n2024-05-01T23:59:59.99Z,.1\n2024-05-02T00:00:00.01Z,.2\n",
            "time;alpha\n2024-05-01T12:00:00;0,1\n2024-05-01T12:00:00,02;0,2\n",
            "time;alpha\n2024-05-01T10:00:00.0Z;0,1\n2024-05-01T10:00:00.02Z;0,2\n",
        ],
        RIGHT,
    ),
    "decimal comma": (
        [
            "time;alpha\n0,00;0,1\n0,02;0,2\n",
            "time\talpha\n0,00\t0,1\n0,02\t0,2\n",
            "time;alpha\n0;0,1\n0,02;,2\n",
        ],
        RIGHT,
    ),
    "decimal comma between commas": (
        ["time,alpha\n0,00,0,1\n0,02,0,2\n", 'time,alpha\n"0,00","0,1"\n"0,02","0,2"\n'],
        "decimal commas need another|are not numbers",
    ),
    "both decimal marks": (
        ["time;altitude\n0.00;1,200\n0.02;1,201\n"],
        "'1,200' in column 'altitude' .* one decimal mark",
    ),
    "separators of thousands": (
        ['time,altitude\n0,"1,200"\n0.02,"1,201"\n', "time;altitude\n0,00;1.200,5\n0,02;1.201,5\n"],
        "write no separators of thousands",
    ),
    "lines above the header": (
        [
            "\n\ntime,alpha\n0,.1\n.02,.2\n",
            "# logger 3, A\n;;\nsep=,\r\ntime,alpha\n0,.1\n.02,.2\n",
        ],
        RIGHT,
    ),
    "empty lines": (["time,alpha\n0,.1\n\n  \n.02,.2\n\n"], RIGHT),
    "remarks between rows": (
        ["time,alpha\n0,.1\n# gust\n.02,.2\n"],
        "line 3 has 1 cells, the header has 2",
    ),
    "no header": (["0,.1\n.02,.2\n", "# time,alpha\n0,.1\n.02,.2\n"], "no column 'time'"),
    "name twice": (
        ["time,alpha,alpha\n0,.1,.1\n.02,.2,.2\n", "time,alpha [deg],alpha\n0,1,1\n.02,1,1\n"],
        r"columns \['alpha'\] repeated",
    ),
    "no name": ([",time,alpha\n0,0,.1\n1,.02,.2\n", ",time,alpha,\n0,0,.1,\n1,.02,.2,\n"], RIGHT),
    "separator at the end": (
        [
            "time,alpha,\n0,.1,\n.02,.2,\n",
            "time,alpha\n0,.1,\n.02,.2,,\n",
            "time,alpha,\n0,.1\n.02,.2\n",
        ],
        RIGHT,
    ),
    "row longer than the header": (
        ["time,alpha\n0,.1\n.02,.2,5\n", "time,alpha\n5,0,.1\n6,.02,.2\n"],
        r"line [23] has 3 cells, the header has 2",
    ),
    "row shorter than the header": (
        ["time,q,alpha\n0,1,.1\n.02,.2\n.04,1,.2\n"],
        "line 3 has 2 cells, the header has 3",
    ),
    "last row shorter": (["time,q,alpha\n0,1,.1\n.02,1,.2\n.04,1"], {**RIGHT, "q": [1, 1]}),
    "empty cell": (["time,q,alpha\n0,,.1\n.02,NaN,.2\n"], {**RIGHT, "q": [np.nan, np.nan]}),
    "flights": (
        ["time,alpha,flight\n0,.1,007\n.02,.2, 007 \n"],
        {**RIGHT, "flight": ["007", "007"]},
    ),
    "not UTF-8": (
        ["time,alpha [°]\n0,1\n".encode(other) for other in ("utf-16", "latin-1")],
        "not text .* expected a CSV in UTF-8",
    ),
}


@pytest.mark.parametrize(
    ("text", "expected"), [(text, given) for texts, given in CASES.values() for text in texts]
)
@pytest.mark.filterwarnings("ignore:log.csv. line 4 has 2 cells, so it was cut off")
def test_case(tmp_path, text, expected):
    path = tmp_path / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    if isinstance(expected, str):
        with pytest.raises(FlightReadError, match=expected):
            read_flight(path)
        return
    found = read_flight(path)
    assert set(found) == {"flight", *expected}
    for name, values in expected.items():
        if isinstance(values[0], str):
            assert found[name].tolist() == values
        else:
            assert_allclose(found[name], values, rtol=1e-15, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("airspeed [mph]", 0.44704),
        ("airspeed [kt]", 1852 / 3600),
        ("airspeed [KTS]", 1852 / 3600),
        ("airspeed [m/sec]", 1.0),
        ("airspeed [ft/sec]", 0.3048),
        ("airspeed [ft/min]", 0.00508),
        ("q (deg/s)", np.pi / 180),
        ("az [ft/sec²]", 0.3048),
        ("wind speed [kt]", 1.0),  # unknown columns stay as they are
    ],
)
def test_units(read, name, factor):
    assert_allclose(read(f"time,{name}\n0,40\n0.1,50\n").iloc[:, -1], [40 * factor, 50 * factor])

"""MATLAB files: loose vectors or a struct, by the words of the vocabulary."""

import numpy as np
import pytest
from scipy.io import savemat

from skdgp.io import FlightReadError, read_flight

TIME = np.arange(50) * 0.02
VECTORS = {"time": TIME, "alpha": 0.1 * np.sin(TIME), "airspeed": 20 + TIME, "my_sensor": TIME**2}


@pytest.fixture
def save(tmp_path):
    """Save variables, return the path."""

    def to(name="log.mat", **content):
        savemat(tmp_path / name, content)
        return tmp_path / name

    return to


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(
    "kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "bool"]
)
def test_every_kind_of_number_beside_what_is_no_vector(tmp_path, kind, compressed):
    others = {
        "word": "H\u00f6he", "words": np.array(["a", "bcd"], dtype=object), "z": np.ones(50) * 1j,
        "deep": {"er": {"x": np.arange(5.0), "e": ""}}, "few": np.zeros((0, 3)), "grid": np.eye(50),
    }  # fmt: skip
    alpha = np.arange(50).astype(kind)
    content = {"time": TIME, "north": alpha, **others}
    savemat(tmp_path / "a.mat", content, do_compression=compressed)
    table = read_flight(tmp_path / "a.mat")
    assert set(table) == {"time", "flight", "north"}
    np.testing.assert_array_equal(table["north"], alpha.astype(float))


@pytest.mark.parametrize(
    "content", [{"data": VECTORS}, {"log": VECTORS | {"note": "calm"}, "x": 1.0}]
)
def test_a_struct(save, content):
    np.testing.assert_allclose(read_flight(save(**content)).airspeed, VECTORS["airspeed"])


def test_flights_by_name(save):
    table = read_flight(save(**VECTORS, flight=np.array(["x"] * 25 + ["y"] * 25, dtype=object)))
    assert table.flight.unique().tolist() == ["x", "y"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"alpha": TIME}, "no vector 'time' among"),
        ({"a": VECTORS, "b": VECTORS}, r"several tables, \['a', 'b'\]"),
        ({"time": TIME, "alpha": TIME[:-1]}, r"lengths {'alpha': 49}, but expected 50"),
        ({"time": TIME, "alpha": 20 * np.ones(50)}, "look like degrees"),
    ],
)
def test_refusals(save, content, message):
    path = save(**content)
    with pytest.raises(FlightReadError, match=message) as error:
        read_flight(path)
    assert str(path) in str(error.value)


def test_version_7_3(tmp_path):
    (tmp_path / "log.mat").write_bytes(
        b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n"
    )
    with pytest.raises(FlightReadError, match=r"save\('flight.mat', '-v7'"):
        read_flight(tmp_path / "log.mat")


@pytest.mark.parametrize("content", [b"", b"MATLAB", b"time,alpha\n0,1\n", bytes(200)])
def test_what_is_no_matlab_file(tmp_path, content):
    (tmp_path / "log.mat").write_bytes(content)
    with pytest.raises(
        FlightReadError, match=r"not a whole MATLAB file .* expected one of version 5 to 7"
    ):
        read_flight(tmp_path / "log.mat")

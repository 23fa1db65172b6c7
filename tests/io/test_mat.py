"""MATLAB files: loose vectors or a struct, by the words of the vocabulary."""

import struct

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from skdgp.io import FlightReadError, read_flight
from skdgp.io._mat import parse_mat5

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
def test_every_kind_of_variable_as_scipy(tmp_path, compressed):
    rng = np.random.default_rng(0)
    kinds = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "bool"]
    numbers = {f"of_{kind}": rng.normal(0, 50, (3, 4)).astype(kind) for kind in kinds}
    texts = {"word": "Höhe", "words": np.array(["a", "bcd"], dtype=object), "rows": ["ab", "cd"]}
    others = {
        "z": np.ones(3) * 1j,
        "deep": {"er": {"x": np.arange(5.0), "e": ""}},
        "few": np.zeros((0, 3)),
    }
    savemat(tmp_path / "a.mat", numbers | texts | others, do_compression=compressed)
    ours = parse_mat5((tmp_path / "a.mat").read_bytes())
    theirs = loadmat(tmp_path / "a.mat")
    for name in (*numbers, "few"):
        np.testing.assert_array_equal(ours[name], theirs[name])
    assert ours["word"] == ["Höhe"]
    assert ours["words"] == ["a", "bcd"]
    assert ours["rows"] == ["ab", "cd"]
    assert ours["z"] is None
    np.testing.assert_array_equal(ours["deep"]["er"]["x"], [[0.0, 1, 2, 3, 4]])


def test_the_other_order_of_bytes(tmp_path):
    """Big-endian files are those of old workstations; written by hand."""

    def element(kind, content):
        return struct.pack(">II", kind, len(content)) + content.ljust(
            -(-len(content) // 8) * 8, b"\0"
        )

    def variable(name, values):
        head = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">ii", len(values), 1))
        return element(
            14, head + element(1, name) + element(9, struct.pack(f">{len(values)}d", *values))
        )

    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    (tmp_path / "a.mat").write_bytes(
        head + variable(b"time", [0.0, 0.5]) + variable(b"alpha", [0.1, 0.2])
    )
    assert read_flight(tmp_path / "a.mat").alpha.tolist() == [0.1, 0.2]


@pytest.mark.parametrize("shape", [(-1,), (-1, 1), (1, -1)])
def test_loose_vectors(save, shape):
    table = read_flight(
        save(**{name: values.reshape(shape) for name, values in VECTORS.items()}, mass=3.0)
    )
    for name, values in VECTORS.items():
        np.testing.assert_allclose(table[name], values)
    assert (table.flight == "log").all()
    assert table.attrs["unknown_columns"] == ["my_sensor"]
    assert "mass" not in table


@pytest.mark.parametrize("content", [{"data": VECTORS}, {"log": {"deep": VECTORS, "note": "calm"}}])
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

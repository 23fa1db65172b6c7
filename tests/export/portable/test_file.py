"""The file of a portable model: it travels, and what is none is refused at once."""

import hashlib
import io
import json
import re
import subprocess
import sys
import tracemalloc
import zipfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

from skdgp.export import PortableFileError, load_portable, save_portable

ROOT = Path(__file__).resolve().parents[3]
STORED = Path(__file__).with_name("stored.npz")
NO_PICKLE = """
import pickle, pickletools, sys
import numpy as np
from skdgp.export import load_portable

class Forbidden(pickle.Unpickler):
    def __init__(self, *words, **keywords):
        raise SystemExit("a pickle was read")
    find_class = None

pickle.Unpickler = pickle._Unpickler = Forbidden
pickle.load = pickle.loads = Forbidden
model = load_portable(sys.argv[1])
X = np.load(sys.argv[2], allow_pickle=False)
np.save(sys.argv[3], np.stack(model.predict(X, return_std=True)))
"""


@pytest.fixture
def path(exact, tmp_path):
    return save_portable(tmp_path / "model.npz", exact)


def reader():
    spec = spec_from_file_location("read_portable", ROOT / "examples" / "read_portable.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def sealed(data: bytes) -> bytes:
    """The bytes of an archive with the checksum that a hostile writer would give it."""
    return data[:-64] + hashlib.sha256(data[:-64]).hexdigest().encode()


def rewritten(path, *, head=None, arrays=None, drop=(), compress=False, twice=False):
    """The same archive with other members, and a checksum that fits."""
    data = io.BytesIO()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(data, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "model.json" and head is not None:
                content = (
                    head
                    if isinstance(head, bytes)
                    else json.dumps(json.loads(content) | head).encode()
                )
            if arrays is not None and name.removesuffix(".npy") in arrays:
                content = arrays[name.removesuffix(".npy")]
                if isinstance(content, np.ndarray):
                    held = io.BytesIO()
                    np.save(held, content, allow_pickle=True)
                    content = held.getvalue()
            if name not in drop:
                new.writestr(
                    name, content, zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
                )
        new.comment = b"0" * 64
    return sealed(data.getvalue())


def test_predicts_the_same(portable, flight, tmp_path):
    found = load_portable(save_portable(tmp_path / "model.npz", portable))
    for ours, theirs in zip(
        portable.predict(flight, True), found.predict(flight, True), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(
        portable.predict_gradient(flight), found.predict_gradient(flight), rtol=1e-9, atol=1e-10
    )
    assert found.content_hash == portable.content_hash
    assert found.aircraft == portable.aircraft
    assert found.provenance == portable.provenance
    assert [block.regressors for block in found.blocks] == [
        block.regressors for block in portable.blocks
    ]


def test_the_reader_of_the_examples(portable, flight, tmp_path):
    model = reader().Model(save_portable(tmp_path / "model.npz", portable))
    X = model.regressors(dict(flight))
    np.testing.assert_allclose(X, portable.regressor_values(flight), rtol=1e-9, atol=1e-10)
    (mean, std), (ours, deviation) = model.predict(X), portable.predict(flight, True)
    np.testing.assert_allclose(mean, ours, rtol=1e-12, atol=1e-12 * np.abs(ours).max())
    assert (np.abs(deviation - std) <= np.maximum(1e-9 * std, portable.rounding(flight))).all()
    exact = portable.predict(flight, True, False)[1]
    assert (
        np.abs(model.predict(X, 0)[1] - exact)
        <= np.maximum(1e-9 * exact, portable.rounding(flight))
    ).all()


def test_loads_where_no_pickle_is_read(path, exact, flight, tmp_path):
    X = exact.regressor_values(flight)
    np.save(tmp_path / "X.npy", X)
    words = [sys.executable, "-c", NO_PICKLE, path, tmp_path / "X.npy", tmp_path / "out.npy"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    expected = np.stack(exact.predict(X, return_std=True))
    np.testing.assert_allclose(
        np.load(tmp_path / "out.npy"), expected, rtol=1e-11
    )  # BLAS on other threads


def test_the_reader_imports_numpy_alone():
    text = (ROOT / "examples" / "read_portable.py").read_text()
    assert set(re.findall(r"^(?:import|from) (\w+)", text, re.MULTILINE)) == {
        "argparse",
        "json",
        "numpy",
    }


def test_a_stored_model_predicts_what_it_did():
    """Another format needs another version."""
    model = load_portable(STORED)
    assert len(model.mixture) == 3
    with np.load(STORED.with_name("stored_says.npz")) as said:
        mean, std = model.predict(said["X"], return_std=True, include_input_noise=False)
        np.testing.assert_allclose(mean, said["mean"], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(std, said["std"], rtol=1e-8)
    assert model.aircraft.name == "glider"


def agrees(value, schema):
    """Whether a value agrees with a JSON schema, as far as ours go."""
    kinds = {"object": dict, "array": list, "string": str, "number": (int, float), "integer": int}
    return (
        isinstance(value, kinds.get(schema.get("type"), object))
        and value == schema.get("const", value)
        and value in schema.get("enum", [value])
        and all(name in value for name in schema.get("required", ()))
        and all(
            agrees(value[k], sub) for k, sub in schema.get("properties", {}).items() if k in value
        )
        and all(agrees(item, schema["items"]) for item in (value if "items" in schema else ()))
    )


def test_the_schema_of_the_page(path):
    schema = json.loads((ROOT / "docs" / "portable.schema.json").read_text())
    for file in (path, STORED):
        with zipfile.ZipFile(file) as archive:
            head = json.loads(archive.read("model.json"))
        assert agrees(head, schema)
        assert set(head) == set(schema["required"]) == set(schema["properties"])
    assert not agrees(head | {"version": 4}, schema)
    assert not agrees(head | {"outputs": [1]}, schema)


def test_every_array_is_on_the_page(path):
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    with np.load(path) as file:
        names = {re.sub(r"_\d+$", "_0", name) for name in file.files} - {"model.json"}
    assert not [name for name in names if f"`{name}`" not in page]


def test_any_changed_byte_and_any_missing_end_is_noticed(path):
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for place in [0, len(whole) - 1, *rng.integers(len(whole), size=60)]:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(PortableFileError, match="checksum"):
            load_portable(path)
    for size in [0, 1, 64, len(whole) // 2, len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(PortableFileError):
            load_portable(path)


ABSURD = (
    b"\x93NUMPY\x01\x00\x76\x00"
    + b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000,), }"
).ljust(127) + b"\n"
HOSTILE = {
    "no JSON": {"head": b"{"},
    "a list": {"head": b"[]"},
    "a deep list": {"head": b"[" * 100_000},
    "another format": {"head": {"format": "another"}},
    "a later version": {"head": {"version": 4}},
    "no version": {"head": b'{"format": "skdgp portable model"}'},
    "no regressors": {"head": {"regressors": []}},
    "a regressor of no formula": {"head": {"regressors": [{"name": "alpha", "unit": "", "sources": []}] * 5}},
    "too many outputs": {"head": {"outputs": ["CX"] * 10**5}},
    "other outputs": {"head": {"outputs": ["CX"]}},
    "many readouts": {"head": {"n_readouts": 10**9}},
    "no aircraft": {"head": {"aircraft": {}}},
    "another hash": {"head": {"content_hash": ""}},
    "no JSON member": {"drop": ["model.json"]},
    "no centres": {"drop": ["centres.npy"]},
    "no weights": {"drop": ["weights_0.npy"]},
    "compressed members": {"compress": True},
    "no array": {"arrays": {"shift": b"junk"}},
    "an absurd shape": {"arrays": {"shift": ABSURD}},
    "objects": {"arrays": {"shift": np.array([None] * 5, dtype=object)}},
    "not a number": {"arrays": {"shift": np.full(5, np.nan)}},
    "another type": {"arrays": {"shift": np.zeros(5, dtype=np.float32)}},
    "blocks outside": {"arrays": {"block_place": np.full((40, 4), 10**15)}},
    "a negative place": {"arrays": {"readout_of": np.full(18, -1)}},
    "no members": {"arrays": {"mixture": np.empty((0, 6))}},
    "too few members": {"arrays": {"mixture": np.full((2, 6), 0.5)}},
    "members of other outputs": {"arrays": {"mixture": np.ones((18, 1))}},
    "a root of no triangle": {"arrays": {"root_0": np.zeros(7)}},
}  # fmt: skip


@pytest.mark.parametrize("change", HOSTILE.values(), ids=list(HOSTILE))
def test_hostile_files_are_refused_in_little_memory(path, change):
    path.write_bytes(rewritten(path, **change))
    tracemalloc.start()
    try:
        with pytest.raises(
            PortableFileError, match="is not a portable model of this version"
        ) as error:
            load_portable(path)
        assert tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()
    assert "\n" not in str(error.value)


def test_a_bomb_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("model.json", b" " * 10**8)
        archive.comment = b"0" * 64
    (tmp_path / "bomb.npz").write_bytes(sealed((tmp_path / "bomb.npz").read_bytes()))
    with pytest.raises(PortableFileError, match="compressed, repeated or larger"):
        load_portable(tmp_path / "bomb.npz")


def test_no_such_file_and_no_model(tmp_path, exact):
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        load_portable(tmp_path / "model.npz")
    with pytest.raises(TypeError, match="Got dict to save, but expected a PortableModel"):
        save_portable(tmp_path / "model.npz", {})
    with pytest.raises(FileNotFoundError, match="does not exist"):
        save_portable(tmp_path / "no" / "model.npz", exact)

"""The file of a portable model: the same model elsewhere, without code, and refused where it is damaged."""

import io
import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.export import PortableFileError, load_portable, save_portable

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def path(portable_of, tmp_path):
    return save_portable(tmp_path / "model.npz", portable_of("average"))


def test_is_the_same_model(portable, flight, tmp_path):
    """The hash is of names and all numbers, those of the reference included."""
    found = load_portable(save_portable(tmp_path / "model.npz", portable))
    assert_allclose(found.predict(flight, True), portable.predict(flight, True), rtol=1e-12)
    for name in ("content_hash", "aircraft", "provenance"):
        assert getattr(found, name) == getattr(portable, name)


def test_the_reader_of_the_examples(example, written, tmp_path):
    """It predicts what the pipeline predicts, and imports NumPy alone."""
    reader = example("read_portable")
    model = reader.Model(save_portable(tmp_path / "model.npz", written.model))
    X = model.regressors({name: written.flight[name] for name in written.model.columns})
    assert_allclose(X, written.model.regressor_values(written.flight), rtol=1e-12)
    for noise in (1.0, 0.0):
        written.with_noise(noise).assert_moments(model.predict(written.X, noise))
    text = Path(reader.__file__).read_text()
    imports = re.findall(r"^(?:import|from) (\w+)", text, re.MULTILINE)
    assert imports == ["argparse", "json", "numpy"]


def test_changed_content_and_a_missing_end_are_noticed(path, portable_of):
    """A changed bit is either noticed, or in a date of the archive."""
    whole = path.read_bytes()
    noticed = 0
    for place in default_rng(0).integers(len(whole), size=60):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        try:
            assert load_portable(path).content_hash == portable_of("average").content_hash
        except PortableFileError:
            noticed += 1
    assert noticed > 50
    for size in [0, 1, 64, len(whole) // 2, len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(PortableFileError):
            load_portable(path)


def rewritten(path, head, arrays, drop):
    """Return the bytes of the same archive with other members."""
    data = io.BytesIO()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(data, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "model.json":
                content = (
                    head if isinstance(head, bytes) else json.dumps(json.loads(content) | head)
                )
            if (own := arrays.get(name.removesuffix(".npy"))) is not None:
                held = io.BytesIO()
                np.save(held, own, allow_pickle=True)
                content = held.getvalue()
            if name != drop:
                new.writestr(name, content)
    return data.getvalue()


@pytest.mark.parametrize(
    ("head", "arrays", "drop"),
    [
        (b"[]", {}, ""),
        ({"version": 3}, {}, ""),
        ({"outputs": ["CX"]}, {}, ""),
        ({"aircraft": {}}, {}, ""),
        ({"content_hash": ""}, {}, ""),
        ({}, {}, "model.json"),
        ({}, {}, "centres.npy"),
        ({}, {"shift": np.array([None] * 6, dtype=object)}, ""),
        ({}, {"mixture": np.ones((18, 1))}, ""),
    ],
)  # fmt: skip
def test_another_content_is_refused(path, head, arrays, drop):
    path.write_bytes(rewritten(path, head, arrays, drop))
    with pytest.raises(PortableFileError, match="is not a portable model of this version") as error:
        load_portable(path)
    assert "\n" not in str(error.value)

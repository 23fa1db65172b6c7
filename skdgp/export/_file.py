"""The file of a portable model: arrays and JSON in a zip archive, with a checksum and no code."""

from __future__ import annotations

import io
import json
import os
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import BinaryIO

import numpy as np

from skdgp._compute.files import LARGEST, parse_json, sha256_of, write_atomically
from skdgp.dynamics import Aircraft
from skdgp.export._model import Block, LearnedRange, PortableModel, Readout, Regressor

FORMAT, VERSION = "skdgp portable model", 3
HEAD = "model.json"
DIGITS = 64  # of the SHA-256 at the end of the file
EPOCH = (1980, 1, 1, 0, 0, 0)  # equal models are equal files
MAX_NAMES = 1000  # regressors or outputs
SHAPES = {
    "d": "shift scale trend_center envelope_low envelope_high",
    "P": "center output_scale deviation_scale noise_variance drift_variance drift_memory",
    "K P": "mixture",
    "J": "prior_variance readout_of",
    "J e": "trend_scale trend_weights",
    "m d": "centres",
    "d d": "input_covariance",
    "B": "block_gain",
    "B 4": "block_place",
    "B d": "block_shift block_regressors",
    "s d": "envelope_samples",
}
"""Arrays by shape: d regressors, e = d + 1, P outputs, K members, J = K P parts, m centres, B blocks, s samples."""
SHAPE_OF = {name: letters for letters, names in SHAPES.items() for name in names.split()}
TYPES = {"block_place": "<i8", "readout_of": "<i8", "block_regressors": "|u1"}  # else "<f8"


class PortableFileError(ValueError):
    """A file could not be read as a portable model."""


def save_portable(path: str | os.PathLike[str], model: PortableModel) -> Path:
    """Write a portable model into one file, which appears whole or not at all, and return its path.

    The file is an uncompressed zip archive, which ``numpy.load`` opens: ``model.json`` and one ``.npy`` for each array.
    Its comment is the SHA-256 of all bytes before it. Raises TypeError if ``model`` is no `PortableModel`.
    """
    if not isinstance(model, PortableModel):
        raise TypeError(
            f"Got {type(model).__name__} to save, but expected a PortableModel: make one with "
            "skdgp.export.portable_model(pipeline, aircraft)."
        )
    return write_atomically(path, lambda temporary: _write(temporary, model))


def load_portable(path: str | os.PathLike[str]) -> PortableModel:
    """Return a portable model that :func:`save_portable` or ``python -m skdgp export`` wrote, the same to the bit.

    No code is run. Raises FileNotFoundError if there is no such file, PortableFileError if it is not a portable model,
    differs from what was written in a single bit, or is of another format version.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Got {path}, but there is no such file: python -m skdgp export writes model.npz.")
    with path.open("rb") as file:
        try:
            if sha256_of(file, max(0, file.seek(0, os.SEEK_END) - DIGITS)) != file.read():
                raise ValueError("its checksum does not fit: it was cut off or changed, or is another file")
            return _read(file)
        except Exception as error:  # a hostile archive may raise anything
            words = " ".join(str(error).split()) or type(error).__name__
            raise PortableFileError(
                f"Got {path}, which is not a portable model of this version ({words}): copy it again, or export the "
                "model again."
            ) from error


# -- writing -----------------------------------------------------------------------------------------------------


def _write(path, model) -> None:
    head = {
        "format": FORMAT,
        "version": VERSION,
        "outputs": list(model.outputs),
        "regressors": [asdict(regressor) for regressor in model.regressors],
        "aircraft": model.aircraft.to_dict(),
        "n_readouts": len(model.readouts),
        "content_hash": model.content_hash,
        "provenance": model.provenance,
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(zipfile.ZipInfo(HEAD, EPOCH), json.dumps(head, indent=1, allow_nan=False))
        for name, array in model.arrays().items():
            data = io.BytesIO()
            contiguous = np.ascontiguousarray(array, dtype=TYPES.get(name, "<f8"))
            np.lib.format.write_array(data, contiguous, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", EPOCH), data.getbuffer())
        archive.comment = b"0" * DIGITS
    with path.open("rb+") as file:
        digest = sha256_of(file, path.stat().st_size - DIGITS)
        file.seek(-DIGITS, os.SEEK_END)
        file.write(digest)


# -- reading -----------------------------------------------------------------------------------------------------


def _read(file: BinaryIO) -> PortableModel:
    size = file.seek(0, os.SEEK_END)
    with zipfile.ZipFile(file) as archive:
        members = {member.filename: member for member in archive.infolist()}
        stored = all(m.compress_type == zipfile.ZIP_STORED and m.compress_size == m.file_size for m in members.values())
        if not stored or len(members) < len(archive.infolist()) or sum(m.file_size for m in members.values()) > size:
            raise ValueError("its members are compressed, repeated or larger than the file")
        if HEAD not in members or members[HEAD].file_size > LARGEST:
            raise ValueError(f"it has no {HEAD} of at most 16 MB")
        head = parse_json(archive.read(HEAD).decode(), f"{HEAD} is not JSON")
        if not isinstance(head, dict) or head.get("format") != FORMAT or head.get("version") != VERSION:
            found = [head.get("format"), head.get("version")] if isinstance(head, dict) else head
            raise ValueError(f"its format is {found}, but expected {FORMAT} {VERSION}")
        arrays = {
            name.removesuffix(".npy"): _array(archive, member) for name, member in members.items() if name != HEAD
        }
    return _assembled(head, arrays)


def _array(archive, member) -> np.ndarray:
    """Return an array whose header agrees with the size of the member; nothing larger is allocated."""
    name, data = member.filename.removesuffix(".npy"), io.BytesIO(archive.read(member))
    if np.lib.format.read_magic(data) != (1, 0):
        raise ValueError(f"{name} is of another version of npy")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(data)
    if dtype.str != TYPES.get(name, "<f8") or (fortran and len(shape) > 1):
        raise ValueError(f"{name} is of type {dtype.str}")
    values = np.frombuffer(data.getbuffer()[data.tell() :], dtype=dtype).reshape(shape)
    if not (np.isfinite(values).all() or (name in ("envelope_low", "envelope_high") and not np.isnan(values).any())):
        raise ValueError(f"{name} is not finite")
    return values


def _assembled(head, arrays) -> PortableModel:
    """Return the model of checked names and arrays."""
    regressors, outputs = tuple(_regressor(r) for r in head["regressors"]), tuple(map(str, head["outputs"]))
    d, P, n = len(regressors), len(outputs), int(head["n_readouts"])
    sizes = {"d": d, "e": d + 1, "P": P, "4": 4}
    _check_shape("mixture", arrays, SHAPE_OF["mixture"], sizes)
    J = sizes["J"] = sizes["K"] * P
    if not (0 < d <= MAX_NAMES and 0 < P <= MAX_NAMES and 0 < n <= J):
        raise ValueError(f"it has {d} regressors, {P} outputs and {n} readouts")
    for name, letters in SHAPE_OF.items():
        _check_shape(name, arrays, letters, sizes)
    _check_shape("block_root", arrays, "B d d" if np.ndim(arrays["block_root"]) == 3 else "B d", sizes)
    for k in range(n):
        _check_shape(f"weights_{k}", arrays, f"k{k}", sizes)
        sizes[f"t{k}"] = sizes[f"k{k}"] * (sizes[f"k{k}"] + 1) // 2
        _check_shape(f"root_{k}", arrays, f"t{k}", sizes)
    readout_of = arrays["readout_of"]
    _check_range("readout_of", readout_of, n)
    for j in range(J):
        _check_shape(f"trend_root_{j}", arrays, f"e r{j}", sizes)
        k = sizes[f"k{readout_of[j]}"]
        if not k <= sizes[f"r{j}"] <= k + d + 1:
            raise ValueError(f"trend_root_{j} has {sizes[f'r{j}']} columns for {k} functions")
    model = PortableModel(
        regressors=regressors,
        outputs=outputs,
        aircraft=Aircraft.from_dict(head["aircraft"]),
        **{name: arrays[name] for name in SHAPE_OF if not name.startswith(("block_", "envelope_"))},
        blocks=_blocks(arrays, sizes),
        readouts=tuple(Readout(arrays[f"weights_{k}"], arrays[f"root_{k}"]) for k in range(n)),
        trend_roots=tuple(arrays[f"trend_root_{j}"] for j in range(J)),
        envelope=LearnedRange(**{name: arrays[f"envelope_{name}"] for name in LearnedRange.__dataclass_fields__}),
        provenance=dict(head["provenance"]),
    )
    if model.content_hash != head["content_hash"]:
        raise ValueError("its content is not what its hash says")
    return model


def _regressor(values) -> Regressor:
    r = Regressor(**values)
    sources, factors = tuple(map(str, r.sources)), tuple(map(float, r.factors))
    regressor = Regressor(str(r.name), str(r.unit), sources, factors, float(r.length), int(r.power))
    if regressor.power not in (0, 1, 2) or len(regressor.factors) != len(regressor.sources) or not regressor.sources:
        raise ValueError(f"the regressor {regressor.name} has no formula")
    return regressor


def _blocks(arrays, sizes) -> tuple[Block, ...]:
    places = arrays["block_place"]
    outputs, first_centre, first_column, counts = places.T
    _check_range("block_place", outputs, sizes["J"])
    width = np.array([sizes[f"k{k}"] for k in arrays["readout_of"]])[outputs]
    for first, most in ((first_centre, sizes["m"]), (first_column, width)):
        if (first < 0).any() or (counts < 0).any() or (first > most - counts).any():
            raise ValueError("block_place is outside of the centres or columns")
    columns = (arrays["block_gain"], arrays["block_shift"], arrays["block_root"], arrays["block_regressors"])
    return tuple(
        Block(i, centre, column, size, float(gain), shift, root, tuple(np.flatnonzero(used).tolist()))
        for (i, centre, column, size), gain, shift, root, used in zip(places.tolist(), *columns, strict=True)
    )


def _check_shape(name, arrays, letters, sizes) -> None:
    """Raise ValueError unless an array has the shape of these sizes; sizes that are new become known."""
    if name not in arrays:
        raise ValueError(f"it lacks {name}")
    shape, expected = arrays[name].shape, letters.split()
    if len(shape) == len(expected):
        for letter, size in zip(expected, shape, strict=True):
            sizes.setdefault(letter, size)
    if shape != tuple(sizes.get(letter, -1) for letter in expected):
        raise ValueError(f"{name} is of shape {shape}, but expected {tuple(sizes.get(x, x) for x in expected)}")


def _check_range(name, values, n) -> None:
    if ((values < 0) | (values >= n)).any():
        raise ValueError(f"{name} is outside of 0 to {n - 1}")

"""Fuzz of model files: one flipped bit, and the file is refused, or the model predicts the same bits."""

import contextlib
import io
import os
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from _fuzzing import Campaign, Difference, only
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.identification import ModelFileError, load_model, save_model
from skdgp.preprocessing import RegressorSelector

DOCUMENTED = (".* was made by .* and this is",)


class Prepared(NamedTuple):
    """A model file, where its damaged copies stand, and what the model says."""

    raw: np.ndarray
    path: Path
    asked: pd.DataFrame
    expected: bytes


def prepare(folder, seed) -> Prepared:
    own = Path(folder) / f"flips-{os.getpid()}"
    own.mkdir(exist_ok=True)
    whole = Path(folder) / "whole.joblib"
    table = flight()
    if not whole.exists():  # the processes damage copies of one file
        made = own / "whole.joblib"
        save(made, table)
        with contextlib.suppress(FileExistsError):
            os.link(made, whole)
    raw = np.frombuffer(whole.read_bytes(), np.uint8)
    return Prepared(raw, own / "model.joblib", table, answer(load_model(whole), table))


def flight():
    t = np.arange(12) * 0.25
    return pd.DataFrame({"time": t, "alpha": 0.1 * np.sin(t), "q": np.cos(3 * t), "elevator": 0.1 * np.sin(2 * t)})


def save(path, table):
    """Write the file of a small model."""
    aircraft = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    regressor = DependentGPRegressor(n_latent=1, max_iter=3, random_state=0)
    pipeline = make_pipeline(RegressorSelector(["alpha", "q", "elevator"]), StandardScaler(), regressor)
    Y = pd.DataFrame({"CZ": -4 * table.alpha, "Cm": -0.5 * table.alpha - 0.6 * table.elevator})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a short search
        save_model(path, pipeline.fit(table, Y), aircraft, options={"thrust": "columns"})


def answer(model, table) -> bytes:
    """Return the bits of what a model predicts, and of its aircraft."""
    mean, std = model.pipeline.predict(table, return_std=True)
    craft = model.aircraft
    said = [mean, std, craft.mass, craft.inertia, craft.wing_area, craft.span, craft.chord]
    return b"".join(np.asarray(each, dtype=float).tobytes() for each in said)


def case(prepared, rng):
    """Return "same" or "refused"."""
    at, bit = int(rng.integers(len(prepared.raw))), int(rng.integers(8))
    copy = prepared.raw.copy()
    copy[at] ^= 1 << bit
    prepared.path.write_bytes(copy.tobytes())
    try:
        with only(*DOCUMENTED), contextlib.redirect_stdout(io.StringIO()):
            found = answer(load_model(prepared.path), prepared.asked)
    except ModelFileError:
        return "refused"
    except (Exception, Warning) as error:
        error.add_note(f"byte {at} of {len(copy)}, bit {bit}")
        raise
    if found != prepared.expected:
        raise Difference(f"predictions or aircraft of other bits; byte {at}, bit {bit}")
    return "same"


FLIPS = Campaign("flips", 5000, 0.1, "same", prepare, case)

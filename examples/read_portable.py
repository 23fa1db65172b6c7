"""
Read a portable model with NumPy alone
======================================

``python -m skdgp export model.joblib --to portable -o out`` writes ``out/model.npz``: arrays and JSON, no code. These
lines read it and predict mean and standard deviation of every coefficient. They need NumPy and nothing else, and are
the description of the file for a reader in any other language.
"""

import json
import sys

import numpy as np


class Model:
    """A portable model: ``names`` of regressors and ``outputs``, and ``predict``."""

    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            self.__dict__.update({name: file[name] for name in file.files if name != "model.json"})
            head = json.loads(file["model.json"])
        if (head["format"], head["version"]) != ("skdgp portable model", 1):
            raise ValueError(f"{path} is of format {head['format']} {head['version']}")
        self.regressors, self.outputs = head["regressors"], head["outputs"]
        self.names = [regressor["name"] for regressor in self.regressors]

    def regressor_values(self, table):
        """Return the regressors (n, d) of a flight table: a dict of columns, SI units and radians."""
        columns = []
        for r in self.regressors:
            x = sum(c * np.asarray(table[name]) for c, name in zip(r["factors"], r["sources"]))
            columns.append(x * (r["length"] / (2 * np.asarray(table["airspeed"]))) ** r["power"] if r["power"] else x)
        return np.column_stack(columns)

    def basis(self, z, i):
        """Return the Gaussian functions of output i at scaled regressors z (n, d), (n, k)."""
        g = np.zeros((len(z), len(getattr(self, f"weights_{self.readout_of[i]}"))))
        blocks = zip(self.block_place, self.block_gain, self.block_shift, self.block_root)
        for (output, centre, column, size), gain, shift, root in blocks:
            if output == i:
                away = (z - shift)[:, None, :] - self.centres[centre : centre + size]
                away = away * root if root.ndim == 1 else away @ root
                g[:, column : column + size] += gain * np.exp(-0.5 * (away**2).sum(axis=2))
        return g

    def predict(self, X):
        """Return mean and standard deviation of the outputs, (n, P), at regressors X (n, d), at most some thousands."""
        z = (np.asarray(X, dtype=float) - self.shift) / self.scale
        p = np.column_stack([np.ones(len(z)), z - self.trend_center])
        mean, variance = np.empty((2, len(z), len(self.outputs)))
        for i, readout in enumerate(self.readout_of):
            g, w = self.basis(z, i), getattr(self, f"weights_{readout}")
            root = np.zeros((len(w), len(w)))
            root.T[np.tril_indices(len(w))] = getattr(self, f"root_{readout}")
            half = p @ getattr(self, f"trend_root_{i}")
            half[:, half.shape[1] - len(w) :] += g @ root
            prior = self.prior_variance[i] + ((p * self.trend_scale[i]) ** 2).sum(axis=1)
            mean[:, i] = p @ self.trend_weights[i] + g @ w
            variance[:, i] = np.maximum(prior - (half**2).sum(axis=1), np.finfo(float).eps * prior)
        return self.center + self.output_scale * mean, self.deviation_scale * np.sqrt(variance)


if __name__ == "__main__" and len(sys.argv) > 1:
    model = Model(sys.argv[1])
    for name, mean, std in zip(model.outputs, *(row[0] for row in model.predict(model.envelope_samples[:1]))):
        print(f"{name:4} {mean:9.5f} +- {std:.5f}")

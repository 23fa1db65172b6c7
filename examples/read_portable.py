"""
Read a portable model with NumPy alone
======================================

Predict mean and standard deviation of the coefficients from ``model.npz``, arrays and JSON without
code, which ``skdgp export model.joblib --to portable -o portable`` writes::

    python examples/read_portable.py portable/model.npz

It needs NumPy and nothing else; a reader in another language has the same lines.
"""

import argparse
import json

import numpy as np


class Model:
    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            self.head, self.arrays = (
                json.loads(file["model.json"]),
                {name: file[name] for name in file.files[1:]},
            )
        if self.head["format"] != "skdgp portable model" or self.head["version"] != 3:
            raise ValueError(
                f"{path} is of the format {self.head['format']} {self.head['version']}"
            )

    def regressors(self, table):
        """Regressors (n, d) of a flight table, a dict of columns in SI units and radians."""
        columns = []
        for r in self.head["regressors"]:
            x = sum(
                c * np.asarray(table[name])
                for c, name in zip(r["factors"], r["sources"], strict=True)
            )
            columns.append(
                x * (r["length"] / (2 * np.asarray(table["airspeed"]))) ** r["power"]
                if r["power"]
                else x
            )
        return np.column_stack(columns)

    def predict(self, X, input_noise=1.0):
        """Mean and standard deviation (n, P) at regressors X (n, d), some thousands at most.

        ``input_noise`` multiplies the variance of the noise of the regressors: 1 as in the flights
        of the fit, 0 for exact regressors, of a simulation. Measured ones without it have
        deviations that are several times too small.
        """
        a, P = self.arrays, len(self.head["outputs"])
        mixture = a["mixture"]
        z = (np.asarray(X, dtype=float) - a["shift"]) / a["scale"]
        p = np.column_stack([np.ones(len(z)), z - a["trend_center"]])
        means, variances = np.empty((2, len(z), *mixture.shape))
        slopes = np.zeros((len(z), P, len(a["shift"])))
        for j, k in enumerate(a["readout_of"]):
            member, i = divmod(j, P)
            w, g = a[f"weights_{k}"], np.zeros((len(z), len(a[f"weights_{k}"])))
            slope = np.tile(a["trend_weights"][j, 1:], (len(z), 1))
            blocks = (a[f"block_{name}"] for name in ("place", "gain", "shift", "root"))
            for (part, centre, column, size), gain, shift, root in zip(*blocks, strict=True):
                if part == j:
                    away = (z - shift)[:, None] - a["centres"][centre : centre + size]
                    root = np.diag(root) if root.ndim == 1 else root
                    values = gain * np.exp(-0.5 * ((away @ root) ** 2).sum(axis=2))
                    g[:, column : column + size] += values
                    slope -= (
                        (values * w[column : column + size])[:, None] @ (away @ root @ root.T)
                    )[:, 0]
            triangle = np.zeros((len(w), len(w)))
            triangle.T[np.tril_indices(len(w))] = a[f"root_{k}"]
            half = p @ a[f"trend_root_{j}"]
            half[:, half.shape[1] - len(w) :] += g @ triangle
            prior = a["prior_variance"][j] + ((p * a["trend_scale"][j]) ** 2).sum(axis=1)
            means[:, member, i] = p @ a["trend_weights"][j] + g @ w
            variances[:, member, i] = np.maximum(
                prior - (half**2).sum(axis=1), np.finfo(float).eps * prior
            )
            slopes[:, i] += mixture[member, i] * slope / a["scale"]
        mean = (mixture * means).sum(axis=1)
        variance = (mixture * (variances + (means - mean[:, None]) ** 2)).sum(axis=1)
        variance += input_noise * ((slopes @ a["input_covariance"]) * slopes).sum(axis=2)
        return a["center"] + a["output_scale"] * mean, a["deviation_scale"] * np.sqrt(variance)


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "file", nargs="?", help="model.npz: its coefficients at a flown point are printed"
    )
    path = parser.parse_args(arguments).file
    if path is not None:
        model = Model(path)
        mean, std = model.predict(model.arrays["envelope_samples"][:1])
        for name, value, deviation in zip(model.head["outputs"], mean[0], std[0], strict=True):
            print(f"{name:4} {value:9.5f} +- {deviation:.5f}")


if __name__ == "__main__":
    main()

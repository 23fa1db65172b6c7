"""
Read a portable model with NumPy alone
======================================

Predict mean and standard deviation of the coefficients from ``model.npz``, arrays and JSON without
code, which ``skdgp export model.joblib --to portable -o portable`` writes::

    python examples/read_portable.py portable/model.npz --output portable.png

It needs NumPy and nothing else, matplotlib for the picture: the coefficients along the first
regressor, with two standard deviations. A reader in another language has the same lines.
"""

import argparse
import json

import numpy as np


class Model:
    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            self.head = json.loads(file["model.json"])
            self.arrays = {name: file[name] for name in file.files if name != "model.json"}
        found = self.head["format"], self.head["version"]
        if found != ("skdgp portable model", 10):
            raise ValueError(f"Got {path} of the format {found}.")

    def regressors(self, table):
        """Regressors (n, d) of a flight table, a dict of columns in SI units and radians."""
        columns = []
        for r in self.head["regressors"]:
            sources = [np.asarray(table[name], dtype=float) for name in r["sources"]]
            x = np.tensordot(r["factors"], sources, 1)
            if r["power"]:
                x *= (r["length"] / (2 * np.asarray(table["airspeed"]))) ** r["power"]
            columns.append(x)
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
        p = np.column_stack([np.ones(len(z)), z])
        means, variances = np.empty((2, len(z), *mixture.shape))
        slopes = np.zeros((len(z), P, len(a["shift"])))
        ends = np.cumsum(a["term_place"][:, 2])
        for j, k in enumerate(a["readout_of"]):
            component, i = divmod(j, P)
            w = a[f"weights_{k}"]
            g = np.zeros((len(z), len(w)))
            slope = np.tile(a["trend_weights"][j, 1:], (len(z), 1))
            for t, (part, first, size) in enumerate(a["term_place"]):
                if part == j:
                    f, own = a["term_inverse_widths"][t], slice(first, first + size)
                    away = (f * z)[:, None] - a["centres"][ends[t] - size : ends[t]]
                    values = a["term_gain"][t] * np.exp(-0.5 * (away**2).sum(axis=2))
                    g[:, own] += values
                    slope -= f * np.einsum("nk,nkd->nd", values * w[own], away)
            triangle = np.zeros((len(w), len(w)))
            triangle.T[np.tril_indices(len(w))] = a[f"root_{k}"]
            half = p @ a[f"trend_root_{j}"]
            half[:, half.shape[1] - len(w) :] += g @ triangle
            prior = a["prior_variance"][j] + ((p @ a[f"trend_prior_{j}"]) ** 2).sum(axis=1)
            variance = prior - (half**2).sum(axis=1)
            means[:, component, i] = p @ a["trend_weights"][j] + g @ w
            variances[:, component, i] = np.maximum(variance, np.finfo(float).eps * prior)
            slopes[:, i] += mixture[component, i] * slope
        mean = (mixture * means).sum(axis=1)
        variance = (mixture * (variances + (means - mean[:, None]) ** 2)).sum(axis=1)
        slopes /= a["scale"]
        variance += input_noise * ((slopes @ a["input_covariance"]) * slopes).sum(axis=2)
        return a["center"] + a["output_scale"] * mean, a["output_scale"] * np.sqrt(variance)


def draw(model, path):
    """Draw the coefficients along the first regressor, the others as in the file's reference."""
    from matplotlib.figure import Figure

    a = model.arrays
    X = np.repeat(a["reference_regressors"][:1], 100, axis=0)
    X[:, 0] = a["shift"][0] + np.linspace(-2.0, 2.0, 100) * a["scale"][0]
    mean, std = model.predict(X, input_noise=0.0)
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    figure.suptitle("Coefficients along the first regressor, with 95 % bands")
    panels = figure.subplots(2, 3, sharex=True).ravel()
    for k, (ax, name) in enumerate(zip(panels, model.head["outputs"], strict=False)):
        ax.fill_between(X[:, 0], mean[:, k] - 2 * std[:, k], mean[:, k] + 2 * std[:, k], alpha=0.3)
        ax.plot(X[:, 0], mean[:, k])
        ax.set(title=name, xlabel=model.head["regressors"][0]["name"])
    figure.savefig(path, dpi=120)


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "file", nargs="?", help="model.npz: its coefficients at a flown point, for exact regressors"
    )
    parser.add_argument("--output", help="a picture of its coefficients")
    options = parser.parse_args(arguments)
    if options.file is not None:
        model = Model(options.file)
        a = model.arrays
        mean, std = model.predict(a["reference_regressors"], input_noise=0.0)
        for name, value, deviation in zip(model.head["outputs"], mean[0], std[0], strict=True):
            print(f"{name:4} {value:9.5f} +- {deviation:.5f}")
        off = np.abs(mean - a["reference_mean"]) / a["reference_std"]
        print(f"largest difference from the pipeline: {off.max():.1e} standard deviations")
        if options.output is not None:
            draw(model, options.output)


if __name__ == "__main__":
    main()

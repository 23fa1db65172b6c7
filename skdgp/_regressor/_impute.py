"""Missing outputs of a row from the other outputs of the same row."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    Exponentiation,
    Kernel,
    Matern,
    WhiteKernel,
)

from skdgp._compute.linalg import check_memory, column_scale
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Indices, Matrix, Vector

BANDWIDTHS = (
    0.02,
    0.05,
    0.1,
)  # of the means over near rows, in standard deviations of the regressors
SEARCH_ROWS, MOST_ROWS = 300, 3000  # for hyperparameters, and for the posterior of one output
ITERATIONS = 40
LEAST_ROWS = 10  # in which the output is observed
REMEDY = "Give fewer rows at a time, the ones with missing values and their neighbours."


class Columns(Exponentiation):
    """A kernel of some columns of its input, whose slice stands in the place of scikit-learn's exponent."""

    def __call__(self, X: Matrix, Y: Matrix | None = None, eval_gradient: bool = False) -> Any:
        second = None if Y is None else Y[:, self.exponent]
        return self.kernel(X[:, self.exponent], second, eval_gradient)

    def diag(self, X: Matrix) -> Vector:
        return self.kernel.diag(X[:, self.exponent])


def imputed(X: Matrix, Y: Matrix, mean: Matrix, std: Matrix) -> tuple[Matrix, Matrix]:
    """Return Y (n, P) with missing values replaced, and their standard deviations, zero where observed.

    For the equations see ``DependentGPRegressor.impute``. ``mean`` and ``std`` (n, P) are
    predictions from the regressors alone. They stand for other outputs that are missing too, and
    for values whose row has no output that is mostly known where theirs is missing.
    """
    check_memory(len(X), "Imputation in", REMEDY, n_matrices=3)
    missing = np.isnan(Y)
    value, deviation = np.where(missing, mean, Y), np.where(missing, std, 0.0)
    logs = [
        closer_to_normal(y[~rows], z) for y, rows, z in zip(Y.T, missing.T, value.T, strict=True)
    ]
    table = np.column_stack([np.log(z) if log else z for z, log in zip(value.T, logs, strict=True)])
    scaled = (table - table.mean(axis=0)) / column_scale(table)
    x = (X - X.mean(axis=0)) / column_scale(X)
    for p, rows in enumerate(missing.T):
        known = missing[rows].mean(axis=0) < 0.5 if rows.any() else np.zeros(Y.shape[1], dtype=bool)
        asked = rows & ~missing[:, known].all(axis=1)
        learned = np.flatnonzero(~rows)
        if asked.any() and len(learned) >= LEAST_ROWS:
            moments = conditional(x, scaled[:, known], table[learned, p], learned, asked)
            value[asked, p], deviation[asked, p] = log_normal(*moments) if logs[p] else moments
    return value, deviation


def closer_to_normal(y: Vector, filled: Vector) -> bool:
    """Return whether log y has a larger normal likelihood than y, both as densities of y."""
    if np.min(filled) <= 0 or len(y) < LEAST_ROWS or np.ptp(y) == 0:
        return False
    logarithm = np.log(y)
    return bool(np.log(np.std(logarithm)) + logarithm.mean() < np.log(np.std(y)))


def log_normal(mean: Vector, std: Vector) -> tuple[Vector, Vector]:
    """Return median and standard deviation of exp(z), where z is normal."""
    median, variance = np.exp(mean), std**2
    return median, median * np.sqrt(np.exp(variance) * np.expm1(variance))


@one_blas_thread()
def conditional(
    x: Matrix, others: Matrix, y: Vector, learned: Indices, asked: Matrix
) -> tuple[Vector, Vector]:
    """Return mean and standard deviation of a measurement in the rows ``asked``, from y (m,) in ``learned``.

    They are of the mixture, with equal weights, of the processes for each bandwidth.
    """
    some, most = (
        np.linspace(0, len(y) - 1, min(len(y), limit)).astype(int)
        for limit in (SEARCH_ROWS, MOST_ROWS)
    )
    predictions = []
    for bandwidth in BANDWIDTHS:
        table = inputs(x, others, bandwidth)
        start = process(kernel_of(x.shape[1], others.shape[1]), table[learned[some]], y[some])
        model = process(likeliest(start), table[learned[most]], y[most])
        predictions.append(model.predict(table[asked], return_std=True))
    means, stds = np.array(predictions).swapaxes(0, 1)
    mean = means.mean(axis=0)
    return mean, np.sqrt(np.mean(stds**2 + (means - mean) ** 2, axis=0))


def inputs(x: Matrix, others: Matrix, bandwidth: float) -> Matrix:
    """Return x, the means of the others over near rows, deviations from these, and the others, side by side."""
    weights = np.exp(-0.5 * cdist(x, x, "sqeuclidean") / bandwidth**2)
    smooth = weights @ others / weights.sum(axis=1, keepdims=True)
    return np.hstack([x, smooth, others - smooth, others])


def kernel_of(d: int, m: int) -> Kernel:
    """Return the kernel of d regressors and m other outputs, in the columns of ``inputs``."""
    rough = ConstantKernel(1.0) * Matern(1.0, (1e-2, 1e3), nu=0.5)
    linear = ConstantKernel(0.3, (1e-6, 1e3)) * DotProduct(0.0, "fixed")
    smooth = ConstantKernel(0.1, (1e-6, 1e3)) * RBF(4.0, (1e-1, 1e3))
    return (
        Columns(rough, slice(0, d))
        + Columns(linear, slice(d, d + 2 * m))
        + Columns(smooth, slice(d + 2 * m, d + 3 * m))
        + ConstantKernel(1.0, "fixed")
        + WhiteKernel(0.1, (1e-6, 1e2))
    )


def process(kernel: Kernel, X: Matrix, y: Vector) -> GaussianProcessRegressor:
    """Return scikit-learn's process of the standardised y at the hyperparameters of the kernel."""
    model = GaussianProcessRegressor(kernel, alpha=1e-8, optimizer=None, normalize_y=True)
    return model.fit(X, y)


def likeliest(model: GaussianProcessRegressor) -> Kernel:
    """Return the kernel of a process at the largest marginal likelihood found from its start."""

    def loss(theta):
        value, gradient = model.log_marginal_likelihood(theta, eval_gradient=True)
        return -value, -gradient

    start: Any = model.kernel_
    options: Any = {"maxiter": ITERATIONS}
    end = minimize(
        loss, start.theta, jac=True, method="L-BFGS-B", bounds=start.bounds, options=options
    )
    return start.clone_with_theta(end.x)

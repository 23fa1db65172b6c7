"""Other methods of the field behind one face: ``fit(X, Y)``, ``predict(X)`` and, where a method has them, bands.

``X`` (n, d) are scaled regressors, ``Y`` (n, P) targets without gaps. ``bands(X)`` gives two
standard deviations (n, P): of the function, and of a new measurement.
"""

import numpy as np
from scipy.stats import f as f_distribution
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import LinearRegression
from sklearn.multioutput import MultiOutputRegressor
from sklearn.preprocessing import PolynomialFeatures


class EquationError:
    """Polynomials by least squares, the classical equation-error method (Klein & Morelli 2006, chapter 5).

    With ``stepwise``, terms enter one at a time, the one with the largest partial F first, while F
    is significant at 5 % and the predicted square error falls: PSE = RSS / n + s^2 p / n, with s^2
    the variance of the target and p the number of terms.
    """

    def __init__(self, degree=1, *, stepwise=False):
        self.degree = degree
        self.stepwise = stepwise

    def fit(self, X, Y):
        self.features = PolynomialFeatures(self.degree, include_bias=False).fit(X)
        C = self.features.transform(X)
        every = np.arange(C.shape[1])
        self.terms = [forward_selection(C, y) if self.stepwise else every for y in Y.T]
        self.fits = [
            _LeastSquares(C[:, terms], y) for terms, y in zip(self.terms, Y.T, strict=True)
        ]
        return self

    def predict(self, X):
        return np.column_stack([fit.predict(C) for fit, C in self._each(X)])

    def bands(self, X):
        both = np.array([fit.bands(C) for fit, C in self._each(X)])
        return tuple(both.transpose(1, 2, 0))

    def _each(self, X):
        C = self.features.transform(X)
        return [(fit, C[:, terms]) for fit, terms in zip(self.fits, self.terms, strict=True)]


def forward_selection(C, y):
    """Return the columns of C, in order of entry, that forward selection takes for y."""
    n, k = C.shape
    C = C - C.mean(axis=0)
    y = y - y.mean()
    squares = (C**2).sum(axis=0)
    total = error = y @ y
    chosen = []
    while len(chosen) < min(k, n - 2):
        left = (C**2).sum(axis=0)
        usable = left > 1e-8 * squares
        gain = np.where(usable, (C.T @ y) ** 2 / np.where(usable, left, 1.0), 0.0)
        best = int(gain.argmax())
        free = n - len(chosen) - 2
        significant = gain[best] / ((error - gain[best]) / free) > f_distribution.isf(0.05, 1, free)
        if not significant or gain[best] < total / n:  # the second: PSE would rise
            break
        chosen.append(best)
        direction = C[:, best] / np.sqrt(left[best])
        y = y - direction * (direction @ y)
        C = C - np.outer(direction, direction @ C)
        error -= gain[best]
    return np.array(chosen, dtype=int)


class _LeastSquares:
    """One target by least squares, with the standard deviations of the textbook."""

    def __init__(self, C, y):
        A = np.column_stack([np.ones(len(C)), C])
        self.weights, *_ = np.linalg.lstsq(A, y)
        self.variance = ((y - A @ self.weights) ** 2).sum() / (len(y) - A.shape[1])
        self.root = np.linalg.inv(np.linalg.qr(A, mode="r"))

    def predict(self, C):
        return self.weights[0] + C @ self.weights[1:]

    def bands(self, C):
        A = np.column_stack([np.ones(len(C)), C])
        function = self.variance * ((A @ self.root) ** 2).sum(axis=1)
        return np.sqrt(function), np.sqrt(function + self.variance)


class OnTrend:
    """A model of the residuals of a linear trend, scaled to variance one; the trend is taken as exact."""

    def __init__(self, model):
        self.model = model
        self.trend = LinearRegression()

    def fit(self, X, Y):
        rest = Y - self.trend.fit(X, Y).predict(X)
        self.scale = rest.std(axis=0)
        self.model.fit(X, rest / self.scale)
        return self

    def predict(self, X):
        return self.trend.predict(X) + self.scale * self.model.predict(X)

    def bands(self, X):
        if not hasattr(self.model, "bands"):
            return None
        return [self.scale * std for std in self.model.bands(X)]


class IndependentProcesses:
    """scikit-learn's Gaussian process, once for each target: RBF with a width for each regressor, and noise."""

    def fit(self, X, Y):
        kernel = ConstantKernel() * RBF(np.full(X.shape[1], 3.0), (1e-1, 1e4)) + WhiteKernel(
            0.1, (1e-6, 1e2)
        )
        self.models = [GaussianProcessRegressor(kernel, random_state=0).fit(X, y) for y in Y.T]
        return self

    def predict(self, X):
        return np.column_stack([model.predict(X) for model in self.models])

    def bands(self, X):
        measured = np.column_stack([model.predict(X, return_std=True)[1] for model in self.models])
        noise = np.array([model.kernel_.k2.noise_level for model in self.models])
        return np.sqrt(np.maximum(measured**2 - noise, 0)), measured


def trees():
    """Return scikit-learn's gradient-boosted trees, once for each target."""
    return MultiOutputRegressor(HistGradientBoostingRegressor(random_state=0))


def sparse_lcm():
    """Return GPyTorch's sparse linear model of coregionalisation."""
    from _gpytorch import SparseLCM

    return SparseLCM()

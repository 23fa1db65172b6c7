"""Other methods of the field behind one face: ``fit(X, Y)``, ``predict(X)`` and, where a method has them, bands.

``X`` (n, d) are scaled regressors, ``Y`` (n, P) targets. ``bands(X)`` gives two standard deviations
(n, P): of the function, and of a new measurement.
"""

import numpy as np
from scipy.stats import f as f_distribution
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import LinearRegression
from sklearn.multioutput import MultiOutputRegressor
from sklearn.preprocessing import PolynomialFeatures


class EachOutput:
    """A model of its own for each target, of the rows in which that was observed."""

    def __init__(self, make):
        self.make = make

    def fit(self, X, Y):
        self.models = []
        for y in Y.T:
            seen = np.isfinite(y)
            self.models.append(self.make().fit(X[seen], y[seen]))
        return self

    def predict(self, X):
        return np.column_stack([model.predict(X) for model in self.models])

    def bands(self, X):
        both = np.array([model.bands(X) for model in self.models])
        return tuple(both.transpose(1, 2, 0))


class EquationError:
    """A polynomial by least squares, the classical equation-error method (Klein & Morelli 2006, chapter 5).

    With ``stepwise``, terms enter one at a time, the one with the largest partial F first, while F
    is significant at 5 % and the predicted square error falls: PSE = RSS / n + s^2 p / n, with s^2
    the variance of the target and p the number of terms.
    """

    def __init__(self, degree=1, *, stepwise=False):
        self.features = PolynomialFeatures(degree, include_bias=False)
        self.stepwise = stepwise

    def fit(self, X, y):
        C = self.features.fit_transform(X)
        self.terms = forward_selection(C, y) if self.stepwise else np.arange(C.shape[1])
        A = self._matrix(X)
        self.weights, *_ = np.linalg.lstsq(A, y)
        self.variance = ((y - A @ self.weights) ** 2).sum() / (len(y) - A.shape[1])
        self.root = np.linalg.inv(np.linalg.qr(A, mode="r"))
        return self

    def predict(self, X):
        return self._matrix(X) @ self.weights

    def bands(self, X):
        function = self.variance * ((self._matrix(X) @ self.root) ** 2).sum(axis=1)
        return np.sqrt(function), np.sqrt(function + self.variance)

    def _matrix(self, X):
        terms = self.features.transform(X)[:, self.terms]
        return np.column_stack([np.ones(len(X)), terms])


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
            return ()
        return [self.scale * std for std in self.model.bands(X)]


class Process:
    """scikit-learn's Gaussian process of one target: RBF with a width for each regressor or one, and noise."""

    def __init__(self, *, one_width=False, searches=1):
        self.one_width = one_width
        self.searches = searches

    def fit(self, X, y):
        d = X.shape[1]
        widths = 3.0 if self.one_width else np.full(d, 3.0)
        bounds = (0.1 if d > 2 else 0.01, 1e4)  # with more inputs shorter widths fit noise
        kernel = ConstantKernel() * RBF(widths, bounds) + WhiteKernel(0.1, (1e-6, 1e2))
        self.model = GaussianProcessRegressor(
            kernel, n_restarts_optimizer=self.searches - 1, normalize_y=True, random_state=0
        )
        self.model.fit(X, y)
        self.noise = self.model.kernel_.k2.noise_level * np.var(y)
        return self

    def predict(self, X, return_std=False):
        return self.model.predict(X, return_std=return_std)

    def bands(self, X):
        _, measured = self.model.predict(X, return_std=True)
        return np.sqrt(np.maximum(measured**2 - self.noise, 0.0)), measured


def trees():
    """Return scikit-learn's gradient-boosted trees, once for each target."""
    return MultiOutputRegressor(HistGradientBoostingRegressor(random_state=0))


def sparse_lcm():
    """Return GPyTorch's sparse linear model of coregionalisation."""
    from _gpytorch import SparseLCM

    return SparseLCM()

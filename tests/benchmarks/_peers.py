"""Other methods of the field behind one face: ``fit(X, Y)``, ``predict(X)`` and, where a method has them, bands.

``X`` (n, d) are scaled regressors, ``Y`` (n, P) targets without gaps. ``bands(X)`` gives two
standard deviations (n, P): of the function, and of a new measurement.
"""

import warnings
from itertools import islice

import numpy as np
from _common import use_torch_threads
from scipy.stats import f as f_distribution
from sklearn.dummy import DummyRegressor
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
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
        self.degree, self.stepwise = degree, stepwise

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


def forward_selection(C, y, level=0.05):
    """Return the columns of C, in order of entry, that forward selection takes for y."""
    n, k = C.shape
    C, y = C - C.mean(axis=0), y - y.mean()
    squares = (C**2).sum(axis=0)
    total = error = y @ y
    chosen = []
    while len(chosen) < min(k, n - 2):
        left = (C**2).sum(axis=0)
        usable = left > 1e-8 * squares
        gain = np.where(usable, (C.T @ y) ** 2 / np.where(usable, left, 1.0), 0.0)
        best = int(gain.argmax())
        free = n - len(chosen) - 2
        significant = gain[best] / ((error - gain[best]) / free) > f_distribution.isf(
            level, 1, free
        )
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
    """A model of what a linear trend, fitted before by least squares, leaves; or of the targets less their mean.

    Either is scaled to variance one. The trend's own uncertainty is left out, as is usual.
    """

    def __init__(self, model, *, linear=True):
        self.model, self.trend = model, LinearRegression() if linear else DummyRegressor()

    def fit(self, X, Y):
        rest = Y - self.trend.fit(X, Y).predict(X)
        self.scale = rest.std(axis=0)
        self.model.fit(X, rest / self.scale)
        return self

    def predict(self, X):
        return self.trend.predict(X) + self.scale * self.model.predict(X)

    def bands(self, X):
        both = self.model.bands(X) if hasattr(self.model, "bands") else None
        return both and tuple(self.scale * std for std in both)


class IndependentProcesses:
    """scikit-learn's Gaussian process, once for each target: RBF with a width for each regressor, and noise."""

    def fit(self, X, Y):
        kernel = ConstantKernel() * RBF(np.full(X.shape[1], 3.0), (1e-1, 1e4)) + WhiteKernel(
            0.1, (1e-6, 1e2)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
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


class ExactLCM:
    """GPyTorch's exact linear model of coregionalisation: six latents of rank 1, Adam at rate .1.

    Fitted with GPyTorch's own settings, which are single precision and conjugate gradients;
    predictions by Cholesky.
    """

    def __init__(self, *, n_steps=100, length_scale=None):
        self.n_steps, self.length_scale = n_steps, length_scale

    def fit(self, X, Y):
        import torch
        from _gpytorch import exact_lcm, likelihood_and_gradient

        use_torch_threads()
        start = (
            0.6931 if self.length_scale is None else self.length_scale
        )  # softplus(0) is GPyTorch's own
        self.model, self.likelihood = exact_lcm(
            X, Y, 6, length_scale=start, noise=0.6931, dtype=torch.float32
        )
        parameters = {id(p): p for p in (*self.model.parameters(), *self.likelihood.parameters())}
        optimizer = torch.optim.Adam(parameters.values(), lr=0.1, maximize=True)
        step = likelihood_and_gradient(self.model, self.likelihood)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of conjugate gradients that do not converge
            for _ in range(self.n_steps):
                step()
                optimizer.step()
        self.model.double().eval()
        self.likelihood.double().eval()
        self.model.set_train_data(
            *(t.double() for t in (self.model.train_inputs[0], self.model.train_targets)), False
        )
        return self

    def predict(self, X):
        import gpytorch

        with gpytorch.settings.skip_posterior_variances():
            return self._of_parts(X, lambda posterior: posterior.mean)

    def bands(self, X):
        variance = np.maximum(self._of_parts(X, lambda posterior: posterior.variance), 0)
        return np.sqrt(variance), np.sqrt(variance + self.likelihood.task_noises.detach().numpy())

    def _of_parts(self, X, moment, rows=256):
        import torch
        from _gpytorch import cholesky

        parts = torch.as_tensor(np.asarray(X), dtype=torch.float64).split(rows)
        with torch.no_grad(), cholesky():
            return np.vstack([moment(self.model(part)).numpy() for part in parts])


class SparseLCM:
    """GPyTorch's sparse variational LCM: six latents, 150 inducing points each, Adam at rate .02, batches of 512."""

    def __init__(self, n_steps=2000):
        self.n_steps = n_steps

    def fit(self, X, Y):
        from _gpytorch import train_variational

        use_torch_threads(1)  # small matrices: faster so
        steps = train_variational(X, Y, n_inducing=min(150, len(X)))
        self.predict = next(islice(steps, self.n_steps - 1, None))
        return self

    def bands(self, X):
        return self.predict.bands(X)

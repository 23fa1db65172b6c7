"""Rows to learn from, chosen by what a model expects of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import Pipeline

from skdgp._compute.typing import Indices, Matrix
from skdgp.model_selection._thin import check_n_samples, observed_rows, only_rows


def informative_targets(
    model: Any, table: pd.DataFrame, Y: Any, n_samples: int, *, n_candidates: int = 3600, n_points: int = 400
) -> Any:
    r"""Return targets with ``n_samples`` observed rows, those that tell a model most; the others are NaN.

    Rows are chosen one by one. With the posterior covariance c of the rows chosen so far, the next is the one that
    lowers the mean posterior variance over the log most (the "active learning Cohn" criterion; Seo et al., IJCNN 2000),

    .. math:: \arg\max_x \sum_z c(z, x)^2 / (c(x, x) + 1),

    over points z spread evenly over the log. The prior covariance is that of the model, the mean over the outputs, each
    in units of its noise variance. Values of targets do not count. It helps where rows are few: see the table of
    results; :func:`thin_targets` needs no model and does as well with a thousand rows. Raises ValueError if
    ``n_samples`` is no positive number, or Y has not as many rows as the table; NotFittedError if the model is not
    fitted.

    Parameters
    ----------
    model : DependentGPRegressor or Pipeline that ends with it
        Fitted, such as on evenly thinned rows.
    table : DataFrame (n, ...)
        The log, as the model takes it.
    Y : DataFrame, Series or array-like of shape (n,) or (n, P)
        Targets; rows that are NaN in every output are not chosen.
    n_samples : int
        Rows to keep; all rows where there are fewer.
    n_candidates : int, default=3600
        Rows among which to choose, about, spread evenly.
    n_points : int, default=400
        Points z.

    Returns
    -------
    DataFrame, Series or ndarray
        A copy of ``Y`` as floats, of the same type, shape, names and index.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.model_selection import informative_targets
    >>> log = pd.DataFrame({"alpha": np.repeat([0.0, 0.1, 0.3], [180, 10, 10]) + np.linspace(0, 0.01, 200)})
    >>> y = np.sin(10 * log["alpha"]) + 0.05 * np.random.default_rng(0).standard_normal(200)
    >>> model = DependentGPRegressor(n_latent=1, random_state=0).fit(log[::5], y[::5])
    >>> chosen = informative_targets(model, log, y, 4)  # the rare angles too
    >>> np.histogram(log["alpha"][chosen.notna()], [0, 0.05, 0.2, 0.4])[0]
    array([2, 1, 1])
    """
    check_n_samples(n_samples)
    regressor, X = regressor_and_inputs(model, table)
    rows = observed_rows(Y)
    if len(np.asarray(Y)) != len(X):
        raise ValueError(f"Got {len(np.asarray(Y))} targets for a table of {len(X)} rows, but expected as many.")
    rows = rows[np.isfinite(X[rows]).all(axis=1)]
    candidates = rows[:: max(1, len(rows) // max(n_candidates, n_samples))]
    if len(candidates) > n_samples:
        noise = regressor.posterior_.noise

        def covariance(A: Matrix, B: Matrix) -> Matrix:
            return sum(regressor.kernel_.block(i, i, A, B) / one for i, one in enumerate(noise)) / len(noise)

        candidates = candidates[most_informative(covariance, X[candidates], n_samples, n_points)]
    return only_rows(Y, candidates)


def most_informative(covariance: Any, X: Matrix, n: int, n_points: int) -> Indices:
    """Return n rows of X in the order in which they are chosen; the noise variance is 1."""
    points = np.linspace(0, len(X) - 1, min(n_points, len(X))).astype(int)
    variance = np.array([covariance(x[None], x[None])[0, 0] for x in X])
    cross, factor = covariance(X[points], X), np.zeros((n, len(X)))
    chosen: list[int] = []
    for k in range(n):
        gain = (cross**2).sum(axis=0) / (variance + 1)
        gain[chosen] = -np.inf
        best = int(gain.argmax())
        scale = np.sqrt(variance[best] + 1)
        row = (covariance(X[best : best + 1], X)[0] - factor[:k, best] @ factor[:k]) / scale
        cross -= np.outer(cross[:, best] / scale, row)
        variance = np.maximum(variance - row**2, 0.0)
        factor[k] = row
        chosen.append(best)
    return np.array(chosen)


def regressor_and_inputs(model: Any, table: pd.DataFrame) -> tuple[Any, Matrix]:
    """Return the fitted regressor of a model, and what it predicts from, (n, d); NaN where it was not sampled."""
    regressor = model[-1] if isinstance(model, Pipeline) else model
    regressor = getattr(regressor, "estimator_", regressor)  # of a CalibratedRegressor
    if not hasattr(regressor, "posterior_"):
        raise NotFittedError(f"Got a {type(regressor).__name__} that is not fitted: call fit first.")
    names = getattr(regressor, "feature_names_in_", None)
    X = model[:-1].transform(table) if isinstance(model, Pipeline) else table if names is None else table[list(names)]
    return regressor, np.asarray(X, dtype=float)

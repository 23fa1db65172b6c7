"""joblib's backend of Dask, a real cluster of two worker processes: the same numbers as in one process."""

import numpy as np
import pytest
from joblib import parallel_config
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.model_selection import GridSearchCV

from skdgp import DependentGPRegressor

pytest.importorskip(
    "distributed", reason='dask.distributed is not installed: pip install "skdgp[dask]"'
)


@pytest.mark.slow
def test_the_page_runs_and_workers_find_the_same_models(blocks_of):
    """Two worker processes import the package once for the whole test."""
    names = {}
    for number, block in enumerate(blocks_of("inference.md"), start=1):
        exec(compile(block, f"inference.md, block {number}", "exec"), names)
        if "LocalCluster" in block:
            assert_same_models()
    assert names["client"].status == "closed"


def assert_same_models():
    """Compare the folds of a search."""
    rng = default_rng(0)
    X = rng.normal(size=(60, 2))
    Y = np.column_stack([np.sin(X[:, 0]), np.cos(X[:, 1])]) + 0.1 * rng.normal(size=(60, 2))
    model = DependentGPRegressor(n_latent=1, max_iter=3, random_state=0)
    search = GridSearchCV(model, {"trend": ["linear", "constant"]}, cv=2)
    here = search.fit(X, Y).cv_results_["mean_test_score"]
    with parallel_config(backend="dask"):
        there = search.fit(X, Y).cv_results_["mean_test_score"]
    assert_allclose(there, here, rtol=1e-6, atol=1e-9)

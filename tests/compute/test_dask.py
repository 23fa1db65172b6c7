"""joblib's backend of Dask, a real cluster of two worker processes: the same numbers as in one process."""

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from joblib import parallel_config
from sklearn.model_selection import GridSearchCV

from skdgp import DependentGPRegressor
from skdgp._compute.parallel import share_map

distributed = pytest.importorskip(
    "distributed", reason='dask.distributed is not installed: pip install "skdgp[dask]"'
)

SHARES = [np.full(3, float(k)) for k in range(5)]


PAGE = Path(__file__).resolve().parents[2] / "docs" / "scaling.md"


def run(number, block, names):
    exec(compile(block, f"{PAGE.name}, block {number}", "exec"), names)


@pytest.fixture(scope="module")
def page():
    """Run the page until it has a cluster; return what it has made, and what is left of it, which closes the cluster.

    Two worker processes import the package once for all tests.
    """
    names, code = (
        {},
        re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE),
    )
    blocks = list(enumerate(code, start=1))
    while "client" not in names:
        run(*blocks.pop(0), names)
    yield names, blocks
    names["client"].close()
    names["cluster"].close()


@pytest.fixture
def client(page):
    return page[0]["client"]


def test_the_same_model_and_the_same_search(client):
    """The sums of a sparse fit, the members of its average, and folds around both are each done by workers."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(600, 2))  # so many that an output has two shares
    Y = np.column_stack([np.sin(X[:, 0]), np.cos(X[:, 1])]) + 0.1 * rng.normal(size=(600, 2))
    model = DependentGPRegressor(
        n_latent=1, max_iter=3, inference="sparse", n_inducing=6, random_state=0
    )
    search = GridSearchCV(model.set_params(max_iter=1), {"trend": ["linear", "constant"]}, cv=2)
    here = model.fit(X, Y).predict(X), search.fit(X, Y).cv_results_["mean_test_score"]
    with parallel_config(backend="dask", client=client):
        there = model.fit(X, Y).predict(X), search.fit(X, Y).cv_results_["mean_test_score"]
    for mine, theirs in zip(here, there, strict=True):
        np.testing.assert_allclose(theirs, mine, rtol=1e-6, atol=1e-9)


def test_what_a_killed_worker_had_is_not_lost(client, tmp_path):
    died, home = str(tmp_path / "died"), os.getpid()

    def deadly(share):
        if os.getpid() != home and not os.path.exists(died):
            open(died, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        return share.sum()

    with parallel_config(backend="dask", client=client):
        assert share_map(deadly, (), SHARES) == [share.sum() for share in SHARES]
    assert os.path.exists(died)


def test_code_of_the_page_runs(page):
    """It is the last test: it closes the cluster."""
    names, blocks = page
    for number, block in blocks:
        run(number, block, names)
    assert names["client"].status == "closed"

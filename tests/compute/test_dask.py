"""A real cluster of two worker processes: the same numbers as in one process, whoever is killed on the way."""

import os
import re
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from joblib import parallel_config
from sklearn.model_selection import GridSearchCV
from threadpoolctl import threadpool_limits

from skdgp import DependentGPRegressor
from skdgp._compute.parallel import fit_map, share_map, sharing
from skdgp.inference import _fit, fit_exact
from skdgp.kernels import ConvolvedGaussian

distributed = pytest.importorskip("distributed", reason='dask.distributed is not installed: pip install "skdgp[dask]"')


SHARES = [np.full(3, float(k)) for k in range(5)]
SUMS = [share.sum() for share in SHARES]


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", silence_logs="CRITICAL"
    ) as cluster:  # any free port: None would ask for the usual one
        yield cluster


@pytest.fixture
def client(cluster):
    with distributed.Client(cluster, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)  # killed ones come back
        _until(lambda: len(client.run(os.getpid, on_error="ignore")) == 2)  # one may be counted that has just died
        yield client


@pytest.fixture
def on_dask(client):
    with parallel_config(backend="dask", client=client):
        yield client


def pids(client):
    return list(client.run(os.getpid).values())


def data(n=700):
    """So many samples that every output has two shares."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n, 2))
    return X, np.column_stack([np.sin(X[:, 0]), np.cos(X[:, 1])]) + 0.1 * rng.normal(size=(n, 2))


def quick(**more):
    return DependentGPRegressor(**({"n_latent": 1, "max_iter": 3, "random_state": 0} | more))


def sparse(**more):
    return quick(inference="sparse", n_inducing=6, optimizer=_two_steps, **more)


def _two_steps(objective, theta, bounds):
    _, gradient = objective(theta)
    theta = np.clip(theta - 1e-3 * gradient / np.abs(gradient).max(), *np.transpose(bounds))
    return theta, objective(theta)[0]


@pytest.fixture(scope="module")
def here():
    """The sparse fit of this process alone."""
    return sparse().fit(*data())


class TestSameNumbers:
    def test_sparse_fit(self, on_dask, here):
        there = sparse().fit(*data())
        np.testing.assert_allclose(there.theta_, here.theta_, rtol=1e-6, atol=1e-9)
        assert there.log_marginal_likelihood_value_ == pytest.approx(here.log_marginal_likelihood_value_, rel=1e-9)
        X = data()[0]
        for mine, theirs in zip(here.predict(X, return_std=True), there.predict(X, return_std=True), strict=True):
            np.testing.assert_allclose(theirs, mine, rtol=1e-6, atol=1e-9)

    def test_members_of_an_average(self, on_dask):
        model, (X, Y) = quick(), data(40)
        with threadpool_limits(1):
            there = model.fit(X, Y).predict(X)
            with parallel_config(backend="sequential"):
                np.testing.assert_allclose(model.fit(X, Y).predict(X), there, rtol=1e-6, atol=1e-9)

    def test_grid_search_over_the_estimator(self, client):
        X, Y = data(40)
        grid = {"n_latent": [0, 1]}
        model = quick(optimizer=None, inference="sparse", n_inducing=5)
        with parallel_config(backend="dask", client=client):
            there = GridSearchCV(model, grid, cv=2, error_score="raise").fit(X, Y)
        here = GridSearchCV(model, grid, cv=2).fit(X, Y)
        np.testing.assert_allclose(
            there.cv_results_["mean_test_score"], here.cv_results_["mean_test_score"], rtol=1e-6, atol=1e-9
        )
        assert there.best_params_ == here.best_params_

    def test_work_is_done_by_the_workers_on_one_thread_of_blas(self, on_dask):
        def where(share):
            from skdgp._compute.threads import n_threads

            return os.getpid(), n_threads()

        with sharing(SHARES):
            found = share_map(where, (), SHARES)
        assert {pid for pid, _ in found} == set(pids(on_dask))
        assert {threads for _, threads in found} == {1}

    def test_shares_are_sent_once(self, on_dask):
        sent = []

        class Big(float):
            def __reduce__(self):
                sent.append(float(self))
                return float, (float(self),)

        big = [Big(k) for k in range(4)]
        with sharing(big):
            for k in range(3):
                assert share_map(lambda k, share: k + share, (k,), big) == [k, k + 1, k + 2, k + 3]
        assert sorted(sent) == [0.0, 1.0, 2.0, 3.0]

    def test_a_task_of_the_cluster_works_alone(self, on_dask):
        """As in a grid search: the outermost loop is spread, and none waits for workers that wait for it."""

        def nested(shares):
            with parallel_config(backend="dask"), sharing(shares):
                inner = share_map(lambda share: os.getpid(), (), shares)
            return {os.getpid(), *inner}

        futures = [on_dask.submit(nested, SHARES, pure=False) for _ in range(4)]
        assert [len(pids) for pids in on_dask.gather(futures)] == [1] * 4


def deadly():
    """A function that kills the process of one worker."""

    def work(home, path, share):
        if os.getpid() != home:
            try:
                os.close(os.open(path, os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                pass
            else:
                os.kill(os.getpid(), signal.SIGKILL)
        return share.sum()

    return work


class TestLoss:
    def test_a_worker_killed_between_evaluations_changes_nothing(self, on_dask, here, monkeypatch):
        victim, killed, converged = pids(on_dask)[0], [], _fit._converge_noise

        def killing(*args):
            posterior = converged(*args)
            if not killed:
                os.kill(victim, signal.SIGKILL)
                killed.append(victim)
            return posterior

        monkeypatch.setattr(_fit, "_converge_noise", killing)
        there = sparse().fit(*data())
        assert killed
        np.testing.assert_allclose(there.theta_, here.theta_, rtol=1e-6, atol=1e-9)
        assert there.log_marginal_likelihood_value_ == pytest.approx(here.log_marginal_likelihood_value_, rel=1e-9)

    def test_a_worker_killed_in_the_middle_of_its_work(self, on_dask, tmp_path):
        died = tmp_path / "died"
        with sharing(SHARES):
            assert share_map(deadly(), (os.getpid(), str(died)), SHARES) == SUMS
            assert died.exists()
            assert share_map(lambda share: share.sum(), (), SHARES) == SUMS

    def test_a_worker_killed_during_its_restart(self, on_dask, tmp_path):
        died, home, kill = str(tmp_path / "died"), os.getpid(), deadly()

        def fit(k):
            from types import SimpleNamespace

            kill(home, died, np.zeros(1))
            return SimpleNamespace(value=k, interrupted=False)

        found = fit_map(fit, [{"k": k} for k in range(4)])
        assert os.path.exists(died)
        assert [end.value for end in found] == [0, 1, 2, 3]

    def test_when_all_are_gone_the_fit_ends_here_and_goes_back_when_they_return(self, cluster, on_dask, here):
        def where(share):
            return share.sum(), os.getpid()

        with sharing(SHARES):
            assert os.getpid() not in {pid for _, pid in share_map(where, (), SHARES)}
            cluster.scale(0)
            _until(lambda: not on_dask.ncores())
            with pytest.warns(RuntimeWarning, match="no worker is left.*done in this process"):
                found = share_map(where, (), SHARES)
            assert [value for value, _ in found] == SUMS
            assert {pid for _, pid in found} == {os.getpid()}
            cluster.scale(2)
            on_dask.wait_for_workers(2, timeout=60)
            assert os.getpid() not in {pid for _, pid in share_map(where, (), SHARES)}

    def test_a_closed_client(self, cluster):
        client = distributed.Client(cluster, set_as_default=False)
        with parallel_config(backend="dask", client=client), sharing(SHARES):
            assert share_map(lambda share: share.sum(), (), SHARES) == SUMS
            client.close()
            with pytest.warns(RuntimeWarning, match="done in this process"):
                assert share_map(lambda share: share.sum(), (), SHARES) == SUMS

    def test_client_closed_in_the_middle(self, cluster):
        client = distributed.Client(cluster, set_as_default=False)
        timer = threading.Timer(0.5, client.close)
        with parallel_config(backend="dask", client=client), sharing(SHARES):
            timer.start()
            with pytest.warns(RuntimeWarning, match="done in this process"):
                assert share_map(slow(os.getpid()), (), SHARES) == SUMS
        timer.join()


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C is sent otherwise there")
def test_ctrl_c_keeps_the_best_of_every_fit(on_dask, tmp_path):
    begun = tmp_path / "begun"
    path = str(begun)

    def endless(objective, theta, bounds):
        while True:
            objective(theta)
            open(path, "w").close()
            time.sleep(0.01)

    def press():
        _until(begun.exists)
        os.kill(os.getpid(), signal.SIGINT)

    def fit(seed):
        return fit_exact(ConvolvedGaussian(0), X, Y, optimizer=endless, max_iter=5, random_state=seed)

    X, Y = data(40)
    finger = threading.Thread(target=press)
    finger.start()
    ends = fit_map(fit, [{"seed": k} for k in range(4)])
    finger.join()
    assert ends
    assert all(end.interrupted and np.isfinite(end.posterior.predict(X)).all() for end in ends)
    assert _answers(on_dask)


def _answers(client):
    """Whether nothing of what was interrupted holds the workers."""
    return client.submit(abs, -1, pure=False).result(timeout=10) == 1


def slow(home):
    def work(share):
        if os.getpid() != home and share[0] < 2:  # the first of each worker
            time.sleep(2)
        return share.sum()

    return work


def _until(condition, seconds=30):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_code_of_the_page_runs():
    page = Path(__file__).resolve().parents[2] / "docs" / "scaling.md"
    names = {}
    for number, block in enumerate(
        re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    ):
        exec(compile(block, f"scaling.md, block {number + 1}", "exec"), names)
    assert names["client"].status == "closed"

"""Work elsewhere: the same results in the same order, whoever dies on the way, and nobody asked who was not invited."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from threading import Lock, Thread
from typing import NamedTuple

import numpy as np
import pytest
from joblib import Parallel, cpu_count, delayed, parallel_config
from sklearn.model_selection import GridSearchCV

from skdgp import DependentGPRegressor
from skdgp._compute.parallel import check_n_jobs, fit_map, n_threads, share_map

SHARES = [np.full(3, float(k)) for k in range(7)]
LOKY = {"backend": "loky", "n_jobs": 2}


class Ended(NamedTuple):
    value: float
    interrupted: bool = False


# Functions for workers are made inside functions: they travel by value, for no worker can import
# this file.


def processes():
    """A function that says where it is computed, and on how many BLAS threads."""

    def where(factor, share):
        import os
        import time

        from skdgp._compute.parallel import n_threads

        time.sleep(0.05)
        return factor * share.sum(), os.getpid(), n_threads()

    return where


def deadly(always=False):
    """A function that kills its process, once or whenever it is not at home."""

    def work(home, path, share):
        import os
        import signal

        if os.getpid() != home:
            try:
                os.close(os.open(path, os.O_CREAT | (0 if always else os.O_EXCL)))
            except FileExistsError:
                pass
            else:
                os.kill(os.getpid(), signal.SIGKILL)
        return share.sum(), os.getpid()

    return work


def values(found):
    return [part[0] for part in found]


SUMS = [share.sum() for share in SHARES]


class TestWhoWorks:
    @pytest.mark.parametrize(
        "config", [{}, {"backend": "threading", "n_jobs": 2}, {"backend": "loky", "n_jobs": 1}]
    )
    def test_this_process_unless_others_are_asked(self, config):
        with parallel_config(**config):
            found = share_map(processes(), (1.0,), SHARES)
        assert {pid for _, pid, _ in found} == {os.getpid()}

    def test_processes_of_the_active_backend(self):
        with parallel_config(**LOKY):
            found = share_map(processes(), (2.0,), SHARES)
            again = share_map(processes(), (3.0,), SHARES)
        assert values(found) == [2 * value for value in SUMS]
        assert values(again) == [3 * value for value in SUMS]
        assert len({pid for _, pid, _ in found} - {os.getpid()}) == 2
        assert {threads for _, _, threads in found} == {1}

    def test_no_more_workers_than_shares(self):
        with parallel_config(**LOKY):
            assert values(share_map(processes(), (1.0,), SHARES[:1])) == SUMS[:1]
        with parallel_config(**LOKY):
            assert share_map(processes(), (1.0,), []) == []

    def test_a_worker_does_not_ask_for_workers_of_its_own(self):
        def nested(shares):
            import os

            from skdgp._compute.parallel import fit_map, share_map

            inner = share_map(lambda share: os.getpid(), (), shares)
            return {os.getpid(), *inner, *fit_map(lambda interrupted: os.getpid(), [], 2)}

        pids = Parallel(n_jobs=2)(delayed(nested)(SHARES) for _ in range(2))
        assert [len(set(inside)) for inside in pids] == [1, 1]

    def test_blas_is_given_back(self):
        before = n_threads()
        with parallel_config(**LOKY):
            share_map(processes(), (1.0,), SHARES)
        assert n_threads() == before


LOST = r"did not come back \(TerminatedWorkerError.*It is done in this process"


class TestLoss:
    def test_what_a_killed_worker_had_is_done_here_and_the_next_call_has_new_ones(self, tmp_path):
        state = (os.getpid(), str(tmp_path / "died"))
        with parallel_config(**LOKY):
            with pytest.warns(RuntimeWarning, match=LOST):
                found = share_map(deadly(), state, SHARES)
            again = share_map(processes(), (1.0,), SHARES)
        assert values(found) == SUMS
        assert {pid for _, pid in found} == {os.getpid()}
        assert os.getpid() not in {pid for _, pid, _ in again}

    def test_what_cannot_travel_is_done_here_with_a_warning(self):
        lock = Lock()

        def at_home(share):
            with lock:
                return share.sum(), os.getpid()

        with pytest.warns(RuntimeWarning, match="pickle"), parallel_config(**LOKY):
            assert values(share_map(at_home, (), SHARES)) == SUMS

    @pytest.mark.parametrize(
        "error", [np.linalg.LinAlgError("not positive definite"), ArithmeticError("in the work")]
    )
    def test_an_error_of_the_work_itself_comes_through(self, error):
        def fail(share):
            raise error

        with parallel_config(**LOKY), pytest.raises(type(error), match=str(error)):
            share_map(fail, (), SHARES)
        with pytest.raises(type(error), match=str(error)):
            fit_map(fail, [{"share": 0}, {"share": 1}], 2)


def data(n=40):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n, 2))
    return X, np.column_stack([np.sin(X[:, 0]), np.cos(X[:, 1])]) + 0.1 * rng.normal(size=(n, 2))


def quick(**more):
    return DependentGPRegressor(**({"n_latent": 1, "max_iter": 2, "random_state": 0} | more))


class TestFits:
    def test_sparse_fit_is_the_same(self):
        model, (X, Y) = quick(inference="sparse", n_inducing=6), data()
        here = model.fit(X, Y).theta_
        with parallel_config(**LOKY):
            there = model.fit(X, Y).theta_
        np.testing.assert_allclose(there, here, rtol=1e-6, atol=1e-9)

    def test_members_of_an_average_follow_the_active_backend(self):
        model, (X, Y) = quick(), data()
        here = model.fit(X, Y, np.arange(float(len(X)))).predict(X)
        with parallel_config(**LOKY):
            there = model.fit(X, Y, np.arange(float(len(X)))).predict(X)
        assert len(model.weights_) == 3  # those of a log
        np.testing.assert_allclose(there, here, rtol=1e-6)

    def test_finished_fits_stay_when_a_worker_is_killed(self):
        home = os.getpid()

        def fit(k):
            import os
            import signal
            import time
            from collections import namedtuple

            if k == 3 and os.getpid() != home:
                time.sleep(1.0)
                os.kill(os.getpid(), signal.SIGKILL)
            return namedtuple("Ended", "pid interrupted")(os.getpid(), False)

        with pytest.warns(RuntimeWarning, match=LOST):
            found = fit_map(fit, [{"k": k} for k in range(4)], 2)
        assert home not in {end.pid for end in found[:2]}
        assert found[3].pid == home

    def test_an_interrupted_fit_is_the_last_one(self):
        assert fit_map(lambda k: Ended(k, k == 1), [{"k": k} for k in range(4)]) == [
            Ended(0),
            Ended(1, True),
        ]

    def test_a_search_in_processes_around_fits_of_members(self):
        X, Y = data()
        model = quick(n_jobs=2)
        search = GridSearchCV(model, {"n_latent": [0, 1]}, cv=2, n_jobs=2, error_score="raise").fit(
            X, Y
        )
        assert np.isfinite(search.best_score_)


class TestJobs:
    @pytest.mark.parametrize("n_jobs", [None, 1, 2, 1000, -1, -cpu_count(), np.int64(2)])
    def test_sense(self, n_jobs):
        check_n_jobs(n_jobs)

    @pytest.mark.parametrize("n_jobs", [0, "two", 1.5, -1000, True, np.nan, [2]])
    def test_nonsense(self, n_jobs):
        with pytest.raises(
            ValueError, match=r"Got n_jobs=.*, but expected None .* from 1 on, .* -1 is all"
        ):
            check_n_jobs(n_jobs)


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C is sent otherwise there")
class TestInterrupt:
    """A real Ctrl-C: to the parent alone, as a notebook sends it, or to all processes, as a terminal does."""

    script = """
        import os, sys, time, numpy as np
        from skdgp._compute.parallel import fit_map
        from skdgp.inference import fit_exact
        from skdgp.kernels import ConvolvedGaussian

        x = np.linspace(0, 6, 20)[:, None]

        def fit(seed, folder):
            def endless(objective, theta, bounds):
                open(os.path.join(folder, str(os.getpid())), "w").close()
                while True:
                    objective(theta)
                    time.sleep(0.01)

            return fit_exact(ConvolvedGaussian(0), x, np.sin(x), optimizer=endless, max_iter=5, random_state=seed)

        if __name__ == "__main__":
            for folder in sys.argv[1:]:
                os.mkdir(folder)
                ends = fit_map(fit, [{"seed": k, "folder": folder} for k in range(4)], 2)
                assert all(np.isfinite(end.posterior.predict(x)).all() for end in ends)
                print([end.interrupted for end in ends], flush=True)
    """

    def test_the_best_so_far_is_kept(self, tmp_path):
        """Fits that would never end, in two processes, of which both have begun when it is pressed."""
        ways = {"notebook": os.kill, "terminal": os.killpg}
        (tmp_path / "script.py").write_text(textwrap.dedent(self.script))
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        command = [sys.executable, "script.py", *ways]
        with subprocess.Popen(command, cwd=tmp_path, start_new_session=True, **pipes) as process:
            try:
                for name, send in ways.items():
                    deadline = time.monotonic() + 60
                    while len(list(tmp_path.glob(f"{name}/*"))) < 2 and time.monotonic() < deadline:
                        assert process.poll() is None, process.stderr.read()
                        time.sleep(0.05)
                    send(process.pid, signal.SIGINT)
                out, err = process.communicate(timeout=30)
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
        assert process.returncode == 0, err
        first, second = out.splitlines()
        assert "True" in first
        assert "True" in second
        assert "False" not in out


def test_the_second_ctrl_c_interrupts_as_ever():
    """The first one, of a fit in a thread, is heeded when the fit next evaluates its likelihood: here it never does."""
    former = signal.getsignal(signal.SIGINT)

    def press():
        for _ in range(2):
            time.sleep(0.5)
            os.kill(os.getpid(), signal.SIGINT)

    finger = Thread(target=press)
    finger.start()
    with parallel_config(backend="threading", n_jobs=2), pytest.raises(KeyboardInterrupt):
        fit_map(lambda k: time.sleep(2), [{"k": 0}, {"k": 1}])
    finger.join()
    assert signal.getsignal(signal.SIGINT) is former

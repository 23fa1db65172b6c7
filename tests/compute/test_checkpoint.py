"""Checkpoints: a fit killed at any moment goes on where it was and ends where it would have; nothing is left behind."""

import io
import os
import shutil
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor, checkpointing, listening
from skdgp._compute.checkpoint import CHECKSUM_SIZE, FILES, _checksum, _read
from skdgp.inference import _rows

RNG = np.random.default_rng(0)
X = RNG.uniform(-2, 2, (40, 2))
Y = np.column_stack([np.sin(X[:, 0]) * X[:, 1], np.cos(X[:, 0])]) + 0.1 * RNG.normal(size=(40, 2))
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class Killed(BaseException):
    """What ends a fit as abruptly as Python can."""


def quick(**parameters):
    return DependentGPRegressor(**({"n_latent": 1, "max_iter": 15, "random_state": 0} | parameters))


def evaluated(function, at=None, error=Killed):
    """Return what the function returns and how many evaluations it took; or raise the error at one of them."""
    calls = []

    def listen(*news):
        calls.append(news)
        if len(calls) == at:
            raise error

    with listening(listen):
        result = function()
    return result, len(calls)


def fit(folder, model=None, at=None, *, every=0.0, targets=Y[:, 0]):
    """Return the fitted model and how many evaluations it took; or be killed at one of them."""

    def function():
        with checkpointing(folder, every=every):
            return (model or quick()).fit(X, targets)

    return evaluated(function, at)


def killed(folder, at, model=None, **options):
    with pytest.raises(Killed):
        fit(folder, model, at, **options)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize(
    "parameters",
    [
        {"max_iter": 4},
        {"inference": "sparse", "n_inducing": 10, "max_iter": 4},
        {"input_noise": "learned", "n_restarts_optimizer": 1, "max_iter": 4},
        {"n_latent": "auto", "max_iter": 3},
        {"early_stopping": True, "max_iter": 15},
    ],
    ids=["exact", "sparse", "noisy regressors, restarts", "latents chosen", "early stopping"],
)
def test_killed_again_and_again_it_ends_as_if_it_had_not_been(parameters, tmp_path, monkeypatch):
    monkeypatch.setattr(_rows, "FEWEST_VALUES", 5)  # so that rows are held out of as few as these
    folder, model = tmp_path / "checkpoint", quick(**parameters)
    plain, n = evaluated(lambda: quick(**parameters).fit(X, Y))
    moments = np.sort(np.random.default_rng(1).choice(np.arange(1, n), 3, replace=False))
    for last, moment in zip([0, *moments], moments, strict=False):
        killed(folder, moment - last, model, targets=Y)
    model, rest = fit(folder, model, targets=Y)
    assert rest == pytest.approx(n - moments[-1], abs=0.1 * n)
    assert not folder.exists()
    assert model.n_evaluations_ == pytest.approx(plain.n_evaluations_, rel=0.1)
    assert model.log_marginal_likelihood_value_ == pytest.approx(plain.log_marginal_likelihood_value_, rel=1e-9)
    np.testing.assert_allclose(model.predict(X), plain.predict(X), rtol=1e-6, atol=1e-9)


def test_what_was_done_is_not_done_again(tmp_path):
    """In a pipeline, in a search: fits before the one that was killed come from their records."""
    grid = {"dependentgpregressor__n_latent": [1]}

    def search():
        with checkpointing(tmp_path / "checkpoint", every=0.0):
            return GridSearchCV(make_pipeline(StandardScaler(), quick()), grid, cv=2).fit(X, Y)

    plain, n = evaluated(lambda: GridSearchCV(make_pipeline(StandardScaler(), quick()), grid, cv=2).fit(X, Y))
    with pytest.raises(Killed):
        evaluated(search, at=n - 10)
    found, rest = evaluated(search)
    assert rest == pytest.approx(10, abs=0.1 * n)
    np.testing.assert_allclose(found.predict(X), plain.predict(X), rtol=1e-6, atol=1e-9)
    assert not (tmp_path / "checkpoint").exists()


def test_without_a_seed_it_goes_on_with_the_seeds_it_had(tmp_path):
    model = quick(random_state=None, n_restarts_optimizer=1)
    killed(tmp_path / "a", 20, model)
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    (first, n), (second, m) = fit(tmp_path / "a", model), fit(tmp_path / "b", model)
    assert n == pytest.approx(m, rel=0.1)
    np.testing.assert_allclose(second.predict(X), first.predict(X), rtol=1e-6, atol=1e-9)


def test_restarts_in_other_processes_are_kept_too(tmp_path):
    model = quick(n_restarts_optimizer=1)
    with pytest.raises(Killed), checkpointing(tmp_path / "checkpoint"):  # noqa: PT012
        model.set_params(n_jobs=2).fit(X, Y[:, 0])
        raise Killed
    assert len(list((tmp_path / "checkpoint").iterdir())) == 2
    again, n = fit(tmp_path / "checkpoint", model.set_params(n_jobs=None))
    assert n == 0
    np.testing.assert_allclose(again.predict(X), model.predict(X), rtol=1e-9, atol=1e-10)


def test_ctrl_c_keeps_the_best_and_the_next_fit_goes_on(tmp_path):
    folder, plain = tmp_path / "checkpoint", quick().fit(X, Y[:, 0])

    def interrupted():
        with checkpointing(folder, every=0.0):
            return quick().fit(X, Y[:, 0])

    with pytest.warns(ConvergenceWarning, match="interrupted"):
        best, n = evaluated(interrupted, at=8, error=KeyboardInterrupt)
    assert folder.exists()
    assert best.n_evaluations_ <= n
    model, rest = fit(folder)
    assert rest == pytest.approx(plain.n_evaluations_ - n, abs=0.1 * plain.n_evaluations_)
    np.testing.assert_allclose(model.predict(X), plain.predict(X), rtol=1e-6, atol=1e-9)
    assert not folder.exists()


def test_ctrl_c_in_a_restart_that_just_began_loses_nothing_of_those_before(tmp_path):
    model = quick(n_restarts_optimizer=1)
    n = quick().fit(X, Y[:, 0]).n_evaluations_

    def interrupted():
        with checkpointing(tmp_path / "checkpoint", every=1000.0):
            return model.fit(X, Y[:, 0])

    with pytest.warns(ConvergenceWarning, match="interrupted"):
        evaluated(interrupted, at=n + 2, error=KeyboardInterrupt)
    _, rest = fit(tmp_path / "checkpoint", model)
    whole = evaluated(lambda: model.fit(X, Y[:, 0]))[1]
    assert rest == pytest.approx(whole - n - 2, abs=0.1 * whole)


@pytest.mark.parametrize(
    ("targets", "parameters", "remark"),
    [
        (Y[:, 0] + 1e-6 * X[:, 0], {}, "other data"),
        (Y[:, 0], {"n_latent": 2, "max_iter": 4}, r"other settings \(max_iter, n_latent\)"),
    ],
)
def test_a_checkpoint_of_something_else_is_named_and_removed(targets, parameters, remark, tmp_path):
    folder = tmp_path / "checkpoint"
    killed(folder, 8)
    plain, n = evaluated(lambda: quick(**parameters).fit(X, targets))
    with pytest.warns(UserWarning, match=remark):
        model, evaluations = fit(folder, quick(**parameters), targets=targets)
    assert evaluations == pytest.approx(n, rel=0.1)
    np.testing.assert_allclose(model.predict(X), plain.predict(X), rtol=1e-6, atol=1e-9)
    assert not folder.exists()


def test_a_start_that_is_another_begins_at_the_best_that_is_known(tmp_path):
    """As where another machine rounds otherwise: never behind where it was."""
    progress = []
    folder = tmp_path / "checkpoint"
    killed(folder, 8)
    (path,) = folder.glob(FILES)
    with np.load(io.BytesIO(path.read_bytes()[:-CHECKSUM_SIZE])) as file:
        arrays = dict(file)
    (stage,) = arrays.keys() - {"header"}
    arrays[stage][0] += 0.1
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    path.write_bytes(buffer.getvalue() + _checksum(buffer.getvalue()))
    with checkpointing(folder), listening(lambda *news: progress.append(news)):
        quick().fit(X, Y[:, 0])
    assert progress[0][-1] == pytest.approx(arrays[stage][:, 0].max())


@pytest.mark.parametrize("damage", [lambda data: data[:-100], lambda data: b"", lambda data: b"PK" + data])
def test_a_damaged_file_is_ignored(damage, tmp_path):
    folder = tmp_path / "checkpoint"
    killed(folder, 8)
    (path,) = folder.glob(FILES)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.warns(UserWarning, match="cannot be read as a checkpoint"):
        model, _ = fit(folder)
    np.testing.assert_allclose(model.predict(X), quick().fit(X, Y[:, 0]).predict(X), rtol=1e-6, atol=1e-9)
    assert not folder.exists()


def test_a_flipped_bit_is_noticed(tmp_path):
    killed(tmp_path, 8)
    (path,) = tmp_path.glob(FILES)
    data = path.read_bytes()
    for place in np.random.default_rng(0).choice(8 * len(data), 300, replace=False):
        flipped = bytearray(data)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        with pytest.warns(UserWarning, match="its checksum does not fit"):
            assert _read(path) is None


def test_a_folder_that_cannot_be_written_does_not_end_the_fit(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.warns(UserWarning, match="No checkpoint could be written"):
        fit(tmp_path / "file")
    assert (tmp_path / "file").exists()


def test_it_is_written_when_it_is_time(tmp_path):
    folder = tmp_path / "checkpoint"
    killed(folder, 8, every=1000.0)
    assert not folder.exists()
    killed(folder, 8)
    changed = {path.stat().st_mtime_ns for path in folder.glob(FILES)}
    assert len(changed) == 1


def test_what_is_not_ours_stays(tmp_path):
    (tmp_path / "mine.npz").write_text("")
    (tmp_path / ".skdgp-0-start-0-12.part.npz").write_text("")  # of a process that was killed while it wrote
    fit(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.npz"]


def test_blocks_within_blocks_and_none(tmp_path):
    with checkpointing(tmp_path / "a", every=0.0), checkpointing(tmp_path / "b", every=0.0):
        quick().fit(X, Y[:, 0])
    assert list(tmp_path.iterdir()) == []


def test_says_what_it_cannot_do(tmp_path):
    with pytest.raises(ValueError, match="Got every=-1"), checkpointing(tmp_path, every=-1):
        pass
    with pytest.raises(ValueError, match=r"Got optimizer=.*define it at the top of a module"):
        fit(tmp_path, quick(optimizer=lambda function, theta, bounds: (theta, 0.0)))


@pytest.mark.skipif(os.name == "nt", reason="processes are forked and killed otherwise there")
class TestKill:
    """The real thing: kill -9, at moments drawn by chance."""

    @staticmethod
    def killed(work, moments, folder, finish=""):
        """Return what is printed by a process that kills its own work moments after it began, looks, and finishes."""
        code = f"""
import os, signal, sys, time
sys.path.insert(0, {os.path.dirname(__file__)!r})
{textwrap.dedent(work)}
for moment in {moments.tolist()!r}:
    ear, mouth = os.pipe()
    child = os.fork()
    if child == 0:
        work(begun=lambda: os.write(mouth, b"."))
        os._exit(0)
    os.read(ear, 1)
    time.sleep(moment)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    check()
{finish}
"""
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def test_a_fit(self, tmp_path):
        """It goes on each time, and in the end is where it would have been."""
        work = """
            from test_checkpoint import X, Y, quick
            from skdgp import checkpointing, listening

            def work(begun):
                calls = []

                def listener(*_):
                    calls.append(begun())
                    time.sleep(0.003)  # so that no fit ends before it is killed, which would remove its files

                with checkpointing("checkpoint", every=0.0), listening(listener):
                    model = quick().fit(X, Y)
                return len(calls), float(model.log_marginal_likelihood_value_)

            def check():
                pass
        """
        plain, moments = quick().fit(X, Y), np.random.default_rng(2).uniform(0.0, 0.05, 6)
        n, value = self.killed(work, moments, tmp_path, "print(*work(lambda: None))").split()
        assert int(n) < plain.n_evaluations_
        assert float(value) == pytest.approx(plain.log_marginal_likelihood_value_, rel=1e-9)
        assert list(tmp_path.iterdir()) == []

    def test_a_write(self, tmp_path):
        """The file is an old or a new one, and whole."""
        work = """
            import joblib, numpy as np
            from skdgp._compute.files import write_atomically

            def work(begun):
                for number in range(10**6):
                    write_atomically("model.joblib", lambda path: joblib.dump(np.full(300_000, number), path))
                    begun()

            def check():
                print(*np.unique(joblib.load("model.joblib")))
        """
        printed = self.killed(work, np.random.default_rng(3).uniform(0.0, 0.1, 6), tmp_path)
        assert [len(line.split()) for line in printed.splitlines()] == [1] * 6

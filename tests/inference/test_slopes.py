"""Errors of slopes by blocks: the scatter over many logs, and none of the method where the function is straight."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from skdgp import DependentGPRegressor
from skdgp.inference import Data, function_errors
from skdgp.inference._slopes import _instrumented, _line, _parabola, _Polynomial, _slopes_of

AT = np.array([[0.3, -0.2]])


def slopes_at(fit):
    return _slopes_of(fit.basis, AT) @ fit.weights


def instrumented(x, y):
    """Return weights of a parabola by least squares and with instruments, and errors of the latter by block."""
    weights = _Polynomial(_parabola, x, y).weights
    change, errors = _instrumented(_parabola(x), y - _parabola(x) @ weights)
    return weights, weights + change, errors


def wandering(rng, shape, memory):
    rho = np.exp(-1 / memory) if memory else 0.0
    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], rng.normal(size=shape), axis=0)


@pytest.mark.parametrize("memory", [0, 5])
def test_are_the_scatter_over_many_logs(memory):
    """Blocks of 40 samples hold the memory of regressors and errors; white deviations are too small by its factor."""
    rng, found, stated, white = np.random.default_rng(0), [], [], []
    for _ in range(120):
        x, noise = wandering(rng, (2400, 2), memory), wandering(rng, 2400, memory)
        fit = _Polynomial(_parabola, x, x @ [1.0, 2.0] + x[:, 0] ** 2 + noise)
        error, alone = fit.error(AT)
        found.append(slopes_at(fit)[0])
        stated.append(np.sum(error[0] ** 2, axis=-1))
        white.append(alone[0])
    ratio = np.std(found, axis=0) / np.sqrt(np.mean(stated, axis=0))
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.13)
    inflation = (
        np.sqrt(1 + 2 / np.expm1(2 / memory)) if memory else 1.0
    )  # of products with rho^2 for each sample
    assert np.std(found, axis=0) / np.mean(white, axis=0) == pytest.approx(
        inflation * np.ones(2), rel=0.25
    )


def test_are_of_the_polynomial():
    x = np.random.default_rng(1).normal(size=(400, 2))
    y = 1.0 + x @ [2.0, -1.0] + 0.5 * x[:, 0] * x[:, 1] - x[:, 1] ** 2
    assert slopes_at(_Polynomial(_parabola, x, y))[0] == pytest.approx(
        [2 + 0.5 * -0.2, -1 + 0.5 * 0.3 + 2 * 0.2]
    )
    assert slopes_at(_Polynomial(_line, x, x @ [2.0, -1.0]))[0] == pytest.approx([2.0, -1.0])


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(300, 2)) * [1.0, 10.0] + [0.0, 5.0]
    common = 0.1 * wandering(rng, 300, 5)
    line = x @ np.array([[1.0, 2.0], [0.1, -0.3]])
    return x, line + common[:, None], line + 1e-6 * rng.normal(size=(300, 2))


@pytest.fixture(scope="module")
def model(log):
    return DependentGPRegressor(structure="trend").fit(log[0], log[1])


def test_outputs_err_together(log, model):
    """Both outputs have the same error, so the difference of their slopes has none."""
    errors = model.slope_errors(log[0][:2])
    assert errors.random.shape[:3] == (2, 2, 2)
    assert errors.random[:, 0] == pytest.approx(errors.random[:, 1], abs=1e-6)
    assert errors.n_samples == 300
    assert (errors.white > 0).all()


def test_of_a_straight_line_all_methods_agree(log):
    model = DependentGPRegressor(structure="trend").fit(log[0], log[2])
    assert np.abs(model.slope_errors(log[0][:1]).method).max() < 1e-5


def test_errors_by_method_have_a_sign(log):
    """An output and its negative err to opposite sides, as their sum has no error; so does a reversed regressor."""
    x, y = log[0], log[1][:, :1] + log[0][:, :1] ** 2
    both = (
        DependentGPRegressor(structure="trend")
        .fit(x, np.hstack([y, -y]))
        .slope_errors(x[:3])
        .method
    )
    assert np.abs(both).min() > 1e-6
    assert both[:, 0] == pytest.approx(-both[:, 1], rel=1e-6)
    alone, turned = (
        DependentGPRegressor(structure="trend").fit(x * sign, y).slope_errors(x[:3] * sign).method
        for sign in ([1.0, 1.0], [-1.0, 1.0])
    )
    assert turned == pytest.approx(alone * np.array([[-1.0], [1.0]]), rel=1e-6)


def test_difference_to_instruments_counts_by_how_well_they_know(log):
    """d |d| / sqrt(d^2 + s^2), at a point off the middle and of regressors of different sizes."""
    x, y = log[0], log[0][:, 0] ** 2 + log[1][:, 0]
    model, at = DependentGPRegressor(structure="trend").fit(x, y), np.array([[0.7, 12.0]])
    _, weights, errors = instrumented(x, y)
    d = model.predict_gradient(at)[0] - (_slopes_of(_parabola, at) @ weights)[0]
    s = np.sqrt(np.sum((_slopes_of(_parabola, at) @ errors.T) ** 2, axis=-1))[0]
    assert model.slope_errors(at).method[0, 0, :, 0] == pytest.approx(
        d * np.abs(d) / np.hypot(d, s), rel=1e-4
    )


def test_what_instruments_hardly_know_counts_less_than_they_scatter():
    """Short doublets in white noise, whose past says little: least squares is right, instruments scatter widely."""
    rng, n, counted, found, stated = np.random.default_rng(4), 600, [], [], []
    step = np.arange(n) % 60 // 3
    for _ in range(20):
        x = np.column_stack([wandering(rng, n, 5), 0.1 * (step == 0) - 0.1 * (step == 1)])
        y = x @ [0.05, -0.3] + 0.01 * rng.normal(size=n)
        model = DependentGPRegressor(structure="trend", optimizer=None).fit(x, y)
        counted.append(model.slope_errors(np.zeros((1, 2))).method[0, 0, 1, 0])
        _, weights, errors = instrumented(x, y)
        found.append(weights[2])
        stated.append(np.sum(errors[:, 2] ** 2))
    assert np.sqrt(np.mean(stated)) == pytest.approx(np.std(found), rel=0.4)
    assert np.sqrt(np.mean(np.square(counted))) < 0.85 * np.std(found)


def test_third_powers_tell_the_slope_of_what_saturates():
    """A tail that stalls on both sides: polynomials of second order find a mean slope, which is too small at zero."""
    x = np.linspace(-1, 1, 600)[:, None]
    model = DependentGPRegressor(structure="trend").fit(x, np.tanh(1.5 * x[:, 0]))
    slope, third = (
        model.predict_gradient([[0.0]])[0, 0],
        model.slope_errors(np.zeros((1, 1))).method[0, 0, 0, 1],
    )
    assert slope < 1.2
    assert slope + np.sqrt(2) * third == pytest.approx(1.5, rel=0.07)


def test_exact_and_sparse_inference_keep_the_same_samples(log, model):
    sparse = DependentGPRegressor(structure="trend", inference="sparse").fit(log[0], log[1])
    same = model.slope_errors(log[0][:1]).random
    assert sparse.slope_errors(log[0][:1]).random == pytest.approx(same, abs=1e-9)


def test_none_without_samples_enough(log, model):
    few = DependentGPRegressor(structure="trend").fit(log[0][:20], log[1][:20])
    assert few.slope_errors(log[0][:1]) is None


def flown_in_gusts(memory=1.5):
    """Return rate and stick, and a load of -1 times the rate, the stick and a gust, (9000, 2) and (9000,).

    The load turns the rate, so its lasting error is in the rate, and least squares finds too little
    damping.
    """
    rng = np.random.default_rng(3)
    gust, stick, rate = wandering(rng, 9000, memory), wandering(rng, 9000, 20), np.zeros(9000)
    for t in range(1, 9000):
        rate[t] = 0.7 * rate[t - 1] + 0.3 * stick[t - 1] + 0.3 * gust[t - 1]
    return np.column_stack([rate, stick]), -rate + stick + gust


@pytest.mark.parametrize(
    ("memory", "every", "left"), [(1.5, 1, 0.5), (1.5, 2, 0.5), (3.0, 1, 0.65)]
)
def test_past_regressors_tell_the_damping_that_gusts_flatten(memory, every, left):
    """Of gusts that last longer, more of the bias is left; instruments one row earlier would leave .76 of the last."""
    x, load = flown_in_gusts(memory)
    flat, found, _ = instrumented(x[::every], load[::every])
    assert abs(found[1] + 1) < left * abs(flat[1] + 1)


def test_deviation_by_method_holds_what_gusts_take_from_the_damping():
    x, load = flown_in_gusts()
    model = DependentGPRegressor(structure="trend").fit(x, load)
    missing = abs(model.predict_gradient(x[:1] * 0)[0, 0] + 1)
    posterior_alone = model.sample_paths(200).gradient(x[:1] * 0)[..., 0].std()
    assert missing > 4 * posterior_alone
    assert 0.5 * missing < model.slope_errors(x[:1] * 0).method[0, 0, 0, 0] < 1.5 * missing


def noisy(share, noise, n=600):
    """Return a regressor of which a share of the variance is noise, and two outputs of slopes 2 and -1 by its truth."""
    rng = np.random.default_rng(6)
    truth, error = (
        np.sqrt(1 - share) * rng.normal(size=(n, 1)),
        np.sqrt(share) * rng.normal(size=(n, 1)),
    )
    return truth + error, truth @ [[2.0, -1.0]] + noise * rng.normal(size=(n, 2))


def flattened(x, y):
    """Return slopes by least squares, and how much steeper the true ones may be, (P,)."""
    model = DependentGPRegressor(structure="trend", optimizer=None).fit(x, y)
    middle = x.mean(axis=0, keepdims=True)  # where slopes are weights
    slopes = [_Polynomial(_parabola, x - middle, column).weights[1] for column in y.T]
    return np.array(slopes), np.sqrt(3) * model.slope_errors(middle).method[0, :, 0, 2]


def test_noise_of_a_regressor_alone_flattens_as_far_as_the_bound():
    """Without other errors the residuals are all of the regressor's noise, so the bound is the true slope."""
    slopes, more = flattened(*noisy(0.4, 0.0))
    assert slopes == pytest.approx([1.2, -0.6], rel=0.06)
    assert slopes + more == pytest.approx([2.0, -1.0], rel=0.06)


@pytest.mark.parametrize(("share", "noise"), [(0.5, 0.3), (0.2, 1.0), (0.05, 0.05)])
def test_true_slopes_lie_within_the_bound(share, noise):
    slopes, more = flattened(*noisy(share, noise))
    assert (np.sign(more) == np.sign(slopes)).all()
    assert (np.abs(slopes + more) > 0.95 * np.array([2.0, 1.0])).all()


def test_one_exact_output_bounds_the_noise_for_all():
    """What is exact in one output leaves no room for noise of the regressor in another."""
    x, y = noisy(0.0, 0.5)
    exact = np.column_stack([y[:, 0], -x[:, 0] + 0.01 * y[:, 1]])
    wide, narrow = (abs(flattened(x, targets)[1][0]) for targets in (y, exact))
    assert narrow < 0.05 * wide
    exact[:5, 1] = np.nan  # rows of the outputs differ
    assert abs(flattened(x, exact)[1][0]) < 0.05 * wide


class TestFunctionErrors:
    def test_are_the_scatter_over_many_logs(self):
        """Of a polynomial of second order, with noise and regressors that last five samples."""
        rng, found, stated = np.random.default_rng(5), [], []
        at = np.array([[0.0], [1.5]])
        for _ in range(80):
            x = wandering(rng, (1200, 1), 5)
            y = 2.0 * x[:, 0] + wandering(rng, 1200, 5)
            log = SimpleNamespace(data=Data([x], [y]))
            errors = function_errors(log)
            found.append(_parabola(at) @ _Polynomial(_parabola, x, y).weights)
            stated.append(np.sum(errors(np.broadcast_to(at, (60, 2, 1)))[..., 0] ** 2, axis=0))
        assert np.std(found, axis=0) == pytest.approx(np.sqrt(np.mean(stated, axis=0)), rel=0.3)

    def test_slopes_are_those_of_the_values_and_of_slope_errors(self, log, model):
        errors, at, step = model.function_errors(), log[0][:3], np.array([1e-3, 0.0])
        each = np.broadcast_to(at, (len(errors.weights), *at.shape))
        slopes = errors.gradient(each)
        assert slopes[..., 0] == pytest.approx(
            (errors(each + step) - errors(each - step)) / 2e-3, rel=1e-6, abs=1e-12
        )
        n_blocks = model.slope_errors(at).random.shape[-1]
        assert np.moveaxis(slopes, 0, -1)[..., :n_blocks] == pytest.approx(
            model.slope_errors(at).random, abs=1e-9
        )

    def test_draws_have_their_covariance_and_move_with_the_units(self, log, model):
        errors, at = model.function_errors(), log[0][:1]
        drawn = errors.draw(4000, 0)(np.broadcast_to(at, (4000, 1, 2)))[:, 0]
        each = errors(np.broadcast_to(at, (len(errors.weights), 1, 2)))[:, 0]
        assert drawn.T @ drawn / 4000 == pytest.approx(each.T @ each, rel=0.1)
        moved = errors.in_units(1.0, 2.0, [1, 0])(
            np.broadcast_to(1.0 + 2.0 * at, (len(errors.weights), 1, 2))
        )[:, 0]
        assert moved == pytest.approx(each[:, [1, 0]])

    def test_none_without_samples_enough(self, log):
        assert (
            DependentGPRegressor(structure="trend").fit(log[0][:20], log[1][:20]).function_errors()
            is None
        )

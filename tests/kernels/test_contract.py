"""What every multi-output kernel promises, over one list of kernels."""

import inspect
import pickle
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from made_kernels import assert_covariance, convolved, trend
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.base import clone
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

import skdgp.kernels
from skdgp.kernels import (
    Coregionalized,
    InputPair,
    LinearTrend,
    MultiOutputKernel,
    Sum,
    covariance_paths,
    inducing_features,
    prior_paths,
)


def coregionalized(kernel, **parameters):
    """One shared process and a private one of each of three outputs."""
    amplitude = np.concatenate([default_rng(2).uniform(0.5, 2.0, (1, 3)) * [1, -1, 1], np.eye(3)])
    return Coregionalized(kernel, amplitude=amplitude, **parameters)


KERNELS = {
    **{
        f"{kind}, shifted": convolved(covariance_type=kind, shift=True) for kind in ("diag", "tied")
    },
    "without private latents": convolved(2, private=False, shift=True),
    "one output": convolved(1, P=1),
    "one regressor": convolved(1, d=1),
    "four terms": trend() + (convolved(0) + (convolved(0, seed=3) + convolved(1))),
    "everything fixed": convolved(parameter_bounds={"amplitude": "fixed", "length_scale": "fixed"}),
    "bounds for each entry": convolved(
        parameter_bounds={
            "length_scale": np.stack(
                [np.full((5, 3, 2), 0.1), np.arange(30.0).reshape(5, 3, 2) + 9], axis=-1
            )
        }
    ),
    "shifts of every output": convolved(
        1, parameter_bounds={"shift": np.broadcast_to([-3.0, 3.0], (4, 3, 2, 2))}
    ),
    "trend": trend(),
    "of scikit-learn": coregionalized(Matern([0.8, 1.7], nu=2.5)),
    "product of scikit-learn, partly fixed": coregionalized(
        ConstantKernel(2.0, "fixed") * RBF(0.9),
        parameter_bounds={"amplitude": "fixed"},
    ),
    "trend + sum of scikit-learn": trend() + coregionalized(RBF(0.9) + Matern([0.8, 1.7], nu=2.5)),
    "trend + dependent": trend() + convolved(1, private=False, covariance_type="tied", seed=5),
}


# Every class, kind of width and term once, with sample paths, and those without
FEW = ["tied, shifted", "diag, shifted", "without private latents", "one output"]
FEW += ["four terms", "bounds for each entry", "everything fixed"]
FEW += ["trend + dependent"]
ALSO = ["of scikit-learn", "trend + sum of scikit-learn"]


def n_features(kernel):
    first = kernel.summands()[0]
    if isinstance(first, LinearTrend):
        return len(first.center)
    return first.n_features or 2  # of one that takes any number


def inputs(kernel, sizes=(4, 3, 5), seed=2):
    rng = default_rng(seed)
    return [rng.normal(0, 1.2, (n, n_features(kernel))) for n in sizes[: kernel.n_outputs]]


def both_inputs(kernel):
    """Return two lists of inputs, of different lengths."""
    return inputs(kernel), inputs(kernel, (2, 6, 3), seed=3)


def places(X):
    """Return the rows of each output in the stacked matrix."""
    edges = np.cumsum([0, *map(len, X)])
    return [slice(*ends) for ends in pairwise(edges)]


@pytest.fixture(scope="session")
def gradient_by_differences(central_difference):
    """Return a function of a name: dK/dtheta at the inputs of the kernel, (N, N, n_theta), by differences."""

    @cache
    def get(name):
        kernel = KERNELS[name]
        return central_difference(
            lambda theta: kernel.clone_with_theta(theta)(inputs(kernel)), kernel.theta
        )

    return get


def coupled(kernel, X):
    """Return the pairs of outputs that a kernel couples."""
    pairs = []
    for i, j in np.ndindex(len(X), len(X)):
        if kernel.couples(i, j):
            pairs.append(InputPair(i, j, X[i], X[j]))
    return pairs


def equal(a, b, **tolerance):
    assert_allclose(a, b, **({"rtol": 1e-12, "atol": 1e-13} | tolerance))


def with_features(kernel, features, X):
    """Return the covariance of the outputs at X, output-major, and the inducing variables."""
    Kfu = np.zeros((kernel.n_outputs, len(X), features.size))
    for i in range(kernel.n_outputs):
        Kfu[i][:, features.columns(i)] = features.Kfu(i, X)
    Kfu = Kfu.reshape(-1, features.size)
    return np.block([[kernel(X), Kfu], [Kfu.T, features.Kuu()]])


def stacked(paths, X):
    """Return the values of paths at X, output-major, (n_paths, P n)."""
    values = paths.values(X[None]).swapaxes(1, 2)
    return values.reshape(len(values), -1)


def test_every_public_kernel_is_in_the_list():
    public = {
        obj
        for obj in vars(skdgp.kernels).values()
        if inspect.isclass(obj) and issubclass(obj, MultiOutputKernel)
    }
    public -= {MultiOutputKernel}  # of which kernels are made
    assert public == {type(kernel) for kernel in KERNELS.values()}


@pytest.fixture(params=KERNELS)
def name(request):
    return request.param


@pytest.fixture
def kernel(name):
    return KERNELS[name]


class TestContract:
    """What depends on the formula of a kernel."""

    def test_matrix_is_symmetric_and_swapping_the_inputs_transposes(self, kernel):
        X, Z = both_inputs(kernel)
        equal(kernel(X), kernel(X).T)
        equal(kernel(X, Z), kernel(Z, X).T)
        equal(kernel(X, X), kernel(X))
        equal(kernel.diag(X), np.diag(kernel(X)))

    def test_matrix_is_a_covariance(self, kernel):
        values = np.linalg.eigvalsh(kernel(inputs(kernel, (12, 9, 15))))
        assert values.min() > -1e-13 * values.max() * len(values)

    def test_contraction_is_the_derivative_of_the_weighted_sum(
        self, kernel, name, gradient_by_differences
    ):
        X, rng = inputs(kernel), default_rng(6)
        rows, expected = places(X), gradient_by_differences(name)
        for i, j in np.ndindex(len(X), len(X)):
            W = rng.normal(size=(len(X[i]), len(X[j])))  # not symmetric, nor square
            weighted = np.einsum("ab,abt->t", W, expected[rows[i], rows[j]])
            equal(kernel.block_gradient(i, j, X[i], X[j], W), weighted, rtol=1e-8, atol=1e-9)

    def test_gradient_is_the_derivative_of_the_matrix(self, kernel, name, gradient_by_differences):
        X = inputs(kernel)
        K, gradient = kernel(X, eval_gradient=True)
        equal(K, kernel(X))
        equal(gradient, gradient_by_differences(name), rtol=1e-8, atol=1e-9)
        with pytest.raises(ValueError, match=r"eval_gradient=True with Y.*expected Y=None"):
            kernel(X, X, eval_gradient=True)

    def test_in_another_unit_it_is_the_covariance_of_the_outputs_in_that_unit(self, kernel):
        factor = np.array([1e-3, 2.0, 50.0])[: kernel.n_outputs]
        X, Z = both_inputs(kernel)
        rows = np.repeat(factor, [len(x) for x in X])
        columns = np.repeat(factor, [len(z) for z in Z])
        other = kernel.rescaled(factor)
        equal(other(X, Z), kernel(X, Z) * np.multiply.outer(rows, columns))
        equal(other.diag(X), kernel.diag(X) * rows**2)
        assert other.n_dims == kernel.n_dims
        assert (other.bounds[:, 0] < other.theta).all()
        assert (other.theta < other.bounds[:, 1]).all()
        back = other.rescaled(1 / factor)
        assert type(back) is type(kernel)
        equal(back.theta, kernel.theta)
        equal(back.bounds, kernel.bounds)

    def test_features_are_jointly_gaussian_with_the_outputs(self, kernel):
        X, features = inputs(kernel, (6, 6, 6))[0], inducing_features(kernel, inputs(kernel)[0])
        joint = with_features(kernel, features, X)
        assert np.linalg.eigvalsh(joint).min() > -1e-10 * np.abs(joint).max()
        Kfu = joint[: kernel.n_outputs * len(X), kernel.n_outputs * len(X) :]
        equal(stacked(features.paths(np.eye(features.size)), X), Kfu.T, rtol=1e-9, atol=1e-10)

    def test_theta_is_what_is_free_within_its_bounds_and_every_entry_matters(
        self, kernel, name, gradient_by_differences
    ):
        free = [h for h in kernel.hyperparameters if not h.fixed]
        assert kernel.n_dims == len(kernel.theta) == sum(h.n_elements for h in free)
        assert kernel.bounds.shape == (kernel.n_dims, 2)
        assert (kernel.bounds[:, 0] < kernel.theta).all()
        assert (kernel.theta < kernel.bounds[:, 1]).all()
        assert (np.abs(gradient_by_differences(name)).max(axis=(0, 1)) > 1e-6).all()

    def test_stationary_kernels_do_not_see_a_common_shift(self, kernel):
        rng = default_rng(8)
        d = n_features(kernel)
        here = [rng.integers(-16, 16, (n, d)) / 8 for n in (4, 3, 5)[: kernel.n_outputs]]
        # Exact in binary; a northing in millimetres is as large
        there = [x + np.arange(1, d + 1) * 2.0**30 for x in here]
        if not kernel.is_stationary():
            assert not np.allclose(kernel(there), kernel(here))
            return
        W = np.eye(4) + 0.1
        c = np.ones((1, sum(map(len, here))))
        for quantity in (
            kernel,
            lambda X: kernel.block_gradient(0, 0, X[0], X[0], W),
            lambda X: covariance_paths(kernel, X, c).slopes(X[0][None]),
        ):
            # Of 2^30 doubles keep a ten-millionth
            equal(quantity(there), quantity(here), rtol=1e-6, atol=1e-6)


class TestUse:
    """What is the same code for every formula."""

    @pytest.fixture(params=[*FEW, *ALSO])
    def name(self, request):
        return request.param

    def test_matrix_is_output_major_and_its_blocks_are_the_blocks_zero_without_coupling(
        self, kernel
    ):
        X, Z = both_inputs(kernel)
        K, rows, columns = kernel(X, Z), places(X), places(Z)
        for i, j in np.ndindex(len(X), len(Z)):
            block = kernel.block(i, j, X[i], Z[j])
            equal(K[rows[i], columns[j]], block)
            assert kernel.couples(i, j) == kernel.couples(j, i)
            assert kernel.couples(i, j) or not block.any()

    def test_block_and_gradient_are_those_that_are_computed_together(self, kernel):
        X = inputs(kernel)
        pairs = coupled(kernel, X)
        weights = [default_rng(3).normal(size=(len(pair.Xi), len(pair.Xj))) for pair in pairs]
        for pair, evaluated, W in zip(pairs, kernel.evaluate(pairs), weights, strict=True):
            equal(evaluated.covariance(), kernel.block(*pair))
            total = np.ones(kernel.n_dims)
            evaluated.add_gradient(total, W)
            equal(total - 1.0, kernel.block_gradient(*pair, W), atol=1e-9)

    def test_products_of_the_transpose_are_those_of_the_derivatives(self, kernel):
        """Those of the matrix itself are its gradient, which is tested above."""
        pairs = coupled(kernel, inputs(kernel))
        for (i, j, Xi, Xj), evaluated in zip(pairs, kernel.evaluate(pairs), strict=True):
            beta = default_rng(6).normal(size=len(Xi))
            columns = [kernel.block_gradient(i, j, Xi, x[None], beta[:, None]) for x in Xj]
            total = np.ones((len(Xj), kernel.n_dims))
            evaluated.add_products(total, beta, transposed=True)
            equal(total - 1.0, np.reshape(columns, total.shape), atol=1e-9)

    @pytest.mark.parametrize("name", FEW)
    def test_paths_of_the_prior_have_its_covariance_however_few_their_waves(self, kernel):
        X = default_rng(11).normal(0, 1.2, (4, n_features(kernel)))
        paths = prior_paths(kernel, 8000, 4, np.random.RandomState(12))
        assert_covariance(stacked(paths, X), kernel(X))

    @pytest.mark.parametrize("name", FEW)
    def test_inducing_variables_are_drawn_with_the_paths(self, kernel):
        X = default_rng(11).normal(0, 1.2, (4, n_features(kernel)))
        features = inducing_features(kernel, inputs(kernel)[0])
        paths, u = features.prior_paths(8000, 6, np.random.RandomState(4))
        draws = np.hstack([stacked(paths, X), u])
        assert_covariance(draws, with_features(kernel, features, X))

    @pytest.mark.parametrize("name", FEW)
    def test_slopes_of_paths_are_their_derivatives(self, kernel, central_difference):
        X = default_rng(13).normal(size=(3, 4, n_features(kernel)))
        paths = prior_paths(kernel, 3, 8, np.random.RandomState(14))
        found = central_difference(lambda step: paths.each(X + step), np.zeros(X.shape[-1]))
        equal(paths.gradient(X), found, rtol=1e-7, atol=1e-8)

    @pytest.mark.parametrize("name", FEW)
    def test_paths_are_multiplied_and_mixed(self, kernel):
        """Against the values of the paths that they are made of, at points of each path and at common ones."""
        X = default_rng(9).normal(size=(6, 3, n_features(kernel)))
        one, other = (prior_paths(kernel, 6, 8, np.random.RandomState(k)) for k in (1, 2))
        member = default_rng(1).integers(0, 2, (6, kernel.n_outputs))
        mixed = one.times(1.0 - member) + other.times(1.0 * member)
        for points in (X, X[:1]):
            of_other = other.each(points), other.gradient(points)
            equal(mixed.each(points), np.where(member[:, None], of_other[0], one.each(points)))
            slopes = np.where(member[:, None, :, None], of_other[1], one.gradient(points))
            equal(mixed.gradient(points), slopes)

    def test_paths_of_values_are_their_covariances_times_coefficients(
        self, kernel, central_difference
    ):
        X = inputs(kernel)
        rng = default_rng(15)
        points = rng.normal(size=(3, n_features(kernel)))
        c = rng.normal(size=(2, sum(map(len, X))))
        K = kernel([points] * len(X), X)
        expected = (K @ c.T).reshape(len(X), 3, 2).T
        paths = covariance_paths(kernel, X, c)
        equal(paths.each(points[None]), expected, rtol=1e-9, atol=1e-10)
        factor = np.arange(1.0, 1 + len(X))
        equal(paths.times(factor).each(points[None]), factor * expected, rtol=1e-9, atol=1e-10)
        found = central_difference(
            lambda step: paths.each(points[None] + step), np.zeros(points.shape[-1])
        )
        equal(paths.gradient(points[None]), found, rtol=1e-7, atol=1e-8)

    def test_theta_goes_round(self, kernel):
        X = inputs(kernel)
        K = kernel(X)
        moved = kernel.theta + default_rng(7).uniform(0.02, 0.1, kernel.n_dims)
        other = kernel.clone_with_theta(moved)
        equal(other.theta, moved)
        equal(kernel.clone_with_theta(kernel.theta)(X), K)
        changed = clone(kernel)
        changed.theta = moved
        equal(changed(X), other(X))
        equal(kernel(X), K)  # the kernel that was cloned is left alone
        assert kernel != "a kernel"
        if kernel.n_dims:
            assert other != kernel
            assert not np.allclose(other(X), K)

    def test_clone_parameters_and_pickle_go_round(self, kernel):
        X = inputs(kernel)
        rebuilt = type(kernel)(**kernel.get_params(deep=False))
        set_again = clone(kernel).set_params(**kernel.get_params())
        K = kernel(X)
        for copy in (clone(kernel), rebuilt, set_again, pickle.loads(pickle.dumps(kernel))):
            assert copy is not kernel
            assert copy == kernel
            equal(copy(X), K)

    def test_wrong_input_is_refused(self, kernel):
        X, d, n = inputs(kernel), n_features(kernel), kernel.n_dims
        with pytest.raises(ValueError, match=rf"{len(X) + 1} input arrays.*{len(X)} outputs"):
            kernel([*X, X[0]])
        for wrong in (d + 1, d - 1):
            with pytest.raises(ValueError, match=rf"{wrong}.*{d}"):
                kernel(np.zeros((5, wrong)))
        with pytest.raises(ValueError, match=r"\(5,\).*expected"):
            kernel(np.zeros(5))
        if not isinstance(kernel, Sum):  # scikit-learn's setter divides theta between the summands
            told = rf"theta of shape \({n + 1},\), but expected \({n},\)"
            with pytest.raises(ValueError, match=told):
                clone(kernel).theta = np.zeros(n + 1)

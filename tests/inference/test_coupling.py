"""How strongly outputs are coupled, and with what shift."""

import numpy as np
import pytest

from skdgp.inference import output_correlation
from skdgp.kernels import ConvolvedGaussian


def shared(amplitude, length_scale, shift=0.0, n_latent=1, **more):
    return ConvolvedGaussian(
        n_latent,
        private_latents=False,
        amplitude=amplitude,
        length_scale=length_scale,
        shift=shift,
        **more,
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_equal_filters_of_one_latent_couple_fully_at_their_shift(sign):
    shift = np.array([[[0.0, 0.0], [0.5, -0.3]]])
    found = output_correlation(shared([[2.0, sign * 0.1]], np.ones((1, 2, 2)), shift))
    np.testing.assert_allclose(found.correlation, [[1, sign], [sign, 1]])
    # Output 1 at s + shift says what output 0 says at s.
    np.testing.assert_allclose(found["shift"][1, 0], [0.5, -0.3], atol=1e-6)
    np.testing.assert_allclose(found["shift"][0, 1], [-0.5, 0.3], atol=1e-6)
    np.testing.assert_array_equal(found["shift"][[0, 1], [0, 1]], 0.0)


def test_a_silent_output_is_coupled_to_none():
    found = output_correlation(shared([[1.0, 0.0]], np.ones((1, 2, 1))))
    assert found.correlation[0, 1] == 0.0
    assert np.isfinite(found.correlation).all()


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_largest_of_all_separations(seed):
    """Latents of mixed signs, widths and shifts: a fine grid finds none larger."""
    rng = np.random.default_rng(seed)
    kernel = shared(
        rng.normal(size=(3, 2)),
        rng.uniform(0.5, 2, (3, 2, 1)),
        rng.normal(0, 1.5, (3, 2, 1)) * [[[0], [1]]],
        n_latent=3,
    )
    grid = np.linspace(-12, 12, 4801)[:, None]
    size = np.sqrt(kernel.block_diag(0, grid[:1]) * kernel.block_diag(1, grid[:1]))
    curve = kernel.block(0, 1, grid, np.zeros((1, 1)))[:, 0] / size
    found = output_correlation(kernel)
    assert abs(found.correlation[0, 1]) >= np.abs(curve).max() - 1e-6
    at = kernel.block(0, 1, found["shift"][0, 1][None], np.zeros((1, 1)))[0, 0] / size[0]
    assert at == pytest.approx(found.correlation[0, 1], abs=1e-9)


def test_opposite_latents_couple_away_from_zero():
    """Narrow and wide latents that cancel at zero separation leave their mark beside it."""
    kernel = shared(
        [[1.0, 1.0], [1.0, -0.9]], np.array([[[1.0], [1.0]], [[3.0], [3.0]]]), n_latent=2
    )
    found = output_correlation(kernel)
    assert found.correlation[0, 1] == pytest.approx(-0.3153, abs=1e-3)
    assert abs(found["shift"][0, 1, 0]) == pytest.approx(2.28, abs=0.02)


def test_matrix_is_symmetric_and_shifts_are_antisymmetric():
    rng = np.random.default_rng(3)
    kernel = shared(
        rng.normal(size=(2, 4)),
        rng.uniform(0.5, 2, (2, 4, 3)),
        rng.normal(0, 0.5, (2, 4, 3)),
        n_latent=2,
    )
    found = output_correlation(kernel)
    np.testing.assert_array_equal(found.correlation, found.correlation.T)
    np.testing.assert_array_equal(found["shift"], -found["shift"].swapaxes(0, 1))
    assert (np.abs(found.correlation) <= 1).all()

"""A reduced model: as small as asked, and near the whole one."""

import numpy as np
import pytest

from skdgp.export._reduce import loss_of, reduced


def functions(model):
    """Number of basis functions of all outputs."""
    return sum(model.readouts[k].size for k in model.readout_of)


def test_the_loss_is_small_and_true(kind, portable):
    if functions(portable) == 0:
        pytest.skip("a trend has no functions to leave out")
    most = round(0.7 * functions(portable))
    small = reduced(portable, functions, most)
    assert functions(small) <= most
    X = (
        portable.envelope.samples
        if len(portable.envelope.samples)
        else portable.shift + 0.3 * portable.scale
    )
    X = np.atleast_2d(X)
    (mean, std), (other, deviation) = (
        model.predict(X, return_std=True, include_input_noise=False) for model in (portable, small)
    )
    losses = np.array([max(loss.values()) for loss in loss_of(small).values()])
    change = np.sqrt(np.mean(((other - mean) / std) ** 2, axis=0))
    assert (change <= 3 * losses + 1e-6).all()
    assert (np.sqrt(np.mean((deviation / std - 1) ** 2, axis=0)) <= 3 * losses + 1e-6).all()


def test_more_functions_lose_less(exact):
    losses = [
        max(max(loss.values()) for loss in loss_of(reduced(exact, functions, most)).values())
        for most in (60, 150, 300)
    ]
    assert losses[0] > losses[1] > losses[2]
    assert losses[2] < 0.05


def test_a_small_model_stays(exact):
    assert reduced(exact, functions, functions(exact)) is exact
    assert loss_of(exact) == {}


def test_no_form_is_so_small(exact):
    with pytest.raises(ValueError, match="Got a size of at most -1 bytes, but the smallest form"):
        reduced(exact, functions, -1)

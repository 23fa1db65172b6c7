"""Which latent feeds which output, and which length scales are tied."""

from __future__ import annotations

import numpy as np

from skdgp._compute.linalg import column_scale, constant_columns

TIED_AXIS = {"tied": 1, "spherical": 2}  # of length_scale (M, P, d)
MOST_UNLIKE = 1e5  # standard deviations of regressors that share a length scale, largest over smallest


def who_feeds(feeds, n_latent, private_latents, P) -> np.ndarray:
    """Return (M, P), one where a latent feeds an output."""
    if feeds is None:
        feeds = np.concatenate([np.ones((n_latent, P)), np.eye(P)[: P * bool(private_latents)]])
    else:
        feeds = np.asarray(feeds, dtype=float)
    if len(feeds) == 0:
        raise ValueError(
            "Got n_latent=0 without private latents, but expected at least one latent for every output: raise "
            "n_latent, or set private_latents=True."
        )
    if feeds.ndim != 2 or feeds.shape[1] != P or not feeds.any(axis=1).all() or not feeds.any(axis=0).all():
        raise ValueError(
            f"Got latents that feed the outputs as {feeds.astype(int).tolist()}, but expected (M, {P}) with at "
            "least one latent for every output, and no idle latent: raise n_latent, or set private_latents=True."
        )
    return feeds


def check_ties(covariance_type, lengths, feeds) -> None:
    """Raise a ValueError where length scales (M, P, d) differ that the type holds equal."""
    axis = TIED_AXIS.get(covariance_type)
    if axis is None:
        return
    most = np.where(feeds[..., None] > 0, lengths, 0.0).max(axis=axis, keepdims=True)
    if not np.allclose(np.where(feeds[..., None] > 0, lengths, most), most, rtol=1e-9, atol=0.0):
        along = "regressors" if covariance_type == "spherical" else "outputs"
        raise ValueError(
            f"Got length scales that differ along the {along} with covariance_type={covariance_type!r}, but "
            "expected equal ones: use covariance_type='diag', or give one length scale to all."
        )


def common_scale(scales, X) -> np.ndarray:
    """Return one scale for all regressors: the geometric mean over those that vary in X; scales are (M, P, d, ...).

    Raises
    ------
    ValueError
        Where regressors differ too much in scale to share one.
    """
    varies = ~constant_columns(X)
    if not varies.any():
        return scales
    spread = column_scale(X)[varies]
    if spread.max() > MOST_UNLIKE * spread.min():
        raise ValueError(
            f"Got regressors with standard deviations from {spread.min():.2g} to {spread.max():.2g}, but "
            "covariance_type='spherical' has one length scale for all of them. Scale the regressors (StandardScaler), "
            "or use covariance_type='diag'."
        )
    mean = np.exp(np.log(scales[:, :, varies]).mean(axis=2, keepdims=True))
    return np.broadcast_to(mean, scales.shape).copy()

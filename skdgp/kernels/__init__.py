"""Multi-output covariance functions as scikit-learn kernels."""

from skdgp.kernels._base import FreeParameter, MultiOutputKernel, Rescaled, Sum
from skdgp.kernels._convolved import ConvolvedGaussian, Filters, independent_processes, tied
from skdgp.kernels._coregionalized import Coregionalized, as_multi_output
from skdgp.kernels._features import (
    Features,
    LatentFeatures,
    PathBundle,
    covariance_paths,
    has_prior_paths,
    inducing_features,
    prior_paths,
)
from skdgp.kernels._gaussian_filters import FilterPair, GaussianBasis
from skdgp.kernels._trend import LinearTrend

__all__ = [
    "ConvolvedGaussian",
    "Coregionalized",
    "Features",
    "FilterPair",
    "Filters",
    "FreeParameter",
    "GaussianBasis",
    "LatentFeatures",
    "LinearTrend",
    "MultiOutputKernel",
    "PathBundle",
    "Rescaled",
    "Sum",
    "as_multi_output",
    "covariance_paths",
    "has_prior_paths",
    "independent_processes",
    "inducing_features",
    "prior_paths",
    "tied",
]

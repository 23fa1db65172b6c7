"""Multi-output covariance functions as scikit-learn kernels.

Names imported as themselves are not part of the public interface: other folders of the package use
them.
"""

from skdgp.kernels._base import FreeParameter, MultiOutputKernel, Sum
from skdgp.kernels._base import InputPair as InputPair
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._convolved import Filters as Filters
from skdgp.kernels._convolved import tied as tied
from skdgp.kernels._coregionalized import Coregionalized
from skdgp.kernels._coregionalized import as_multi_output as as_multi_output
from skdgp.kernels._features import Features as Features
from skdgp.kernels._features import LatentFeatures as LatentFeatures
from skdgp.kernels._features import covariance_paths as covariance_paths
from skdgp.kernels._features import inducing_features
from skdgp.kernels._gaussian_filters import FilterPair as FilterPair
from skdgp.kernels._gaussian_filters import GaussianBasis as GaussianBasis
from skdgp.kernels._paths import LinearPaths as LinearPaths
from skdgp.kernels._paths import PathBundle as PathBundle
from skdgp.kernels._prior_paths import prior_paths
from skdgp.kernels._trend import LinearTrend

__all__ = [
    "ConvolvedGaussian",
    "Coregionalized",
    "FreeParameter",
    "LinearTrend",
    "MultiOutputKernel",
    "Sum",
    "inducing_features",
    "prior_paths",
]

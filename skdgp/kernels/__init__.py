"""Multi-output covariance functions as scikit-learn kernels."""

from skdgp.kernels._base import FreeParameter, MultiOutputKernel, Sum
from skdgp.kernels._convolved import COVARIANCE_TYPES, ConvolvedGaussian
from skdgp.kernels._trend import BasisTrend, LinearTrend, Trend

__all__ = [
    "COVARIANCE_TYPES",
    "BasisTrend",
    "ConvolvedGaussian",
    "FreeParameter",
    "LinearTrend",
    "MultiOutputKernel",
    "Sum",
    "Trend",
]

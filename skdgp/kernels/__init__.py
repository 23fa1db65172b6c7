"""The prior: multi-output covariance functions as scikit-learn kernels."""

from skdgp.kernels._base import MultiOutputKernel, Sum
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._trend import BasisTrend, LinearTrend

__all__ = ["BasisTrend", "ConvolvedGaussian", "LinearTrend", "MultiOutputKernel", "Sum"]

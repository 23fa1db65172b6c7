"""The posterior: exact and sparse inference, and the search for hyperparameters."""

from skdgp.inference._coupling import output_correlation
from skdgp.inference._exact import Data, ExactPosterior, log_likelihood
from skdgp.inference._fit import Fit, fit_exact, fit_sparse
from skdgp.inference._optimize import Optimum, maximize
from skdgp.inference._sparse import SparsePosterior

__all__ = [
    "Data",
    "ExactPosterior",
    "Fit",
    "Optimum",
    "SparsePosterior",
    "fit_exact",
    "fit_sparse",
    "log_likelihood",
    "maximize",
    "output_correlation",
]

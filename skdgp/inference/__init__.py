"""The posterior: exact inference and the search for hyperparameters."""

from skdgp.inference._coupling import output_correlation
from skdgp.inference._exact import Data, ExactPosterior, log_likelihood
from skdgp.inference._fit import fit_hyperparameters
from skdgp.inference._optimize import Optimum, maximize

__all__ = [
    "Data",
    "ExactPosterior",
    "Optimum",
    "fit_hyperparameters",
    "log_likelihood",
    "maximize",
    "output_correlation",
]

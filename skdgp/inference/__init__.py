"""Exact and sparse posteriors, and the search for hyperparameters.

Terms of this folder, beside docs/notation.md:

========  =============================================================================================================
features  the inducing variables of sparse inference; what scikit-learn calls features are the regressors here
share     samples whose part of a sum one task computes, a chunk of the data
loading   matrix that multiplies independent variables: G of the noise G G^T that regressors add to the outputs of a
          sample; A, b of a posterior mean A b
clock     time and flight number of each value, (n, 2)
drift     the part of the noise that is correlated in time
misfit    the discrepancy: the error of the function that residuals show where flights come back to the same
          regressors
errors    of the function, that a posterior does not hold: by correlated noise, by method, and the misfit
========  =============================================================================================================
"""

from skdgp._compute.statistics import autocorrelation_time
from skdgp.inference._average import AveragePosterior, CentredTerm, training_inputs
from skdgp.inference._drift import residual_drift
from skdgp.inference._errors import (
    FunctionErrors,
    PosteriorWithErrors,
    function_errors,
    mean_errors,
    narrowing,
)
from skdgp.inference._fit import Fit, as_exact, average, fit_exact, fit_sparse, mean_of
from skdgp.inference._known_slopes import KnownSlopes
from skdgp.inference._likelihood import Data, TileSettings, log_likelihood
from skdgp.inference._misfit import misfit_variance
from skdgp.inference._noise import KnownNoise
from skdgp.inference._optimizer import OptimizerSettings, Optimum, maximize
from skdgp.inference._posterior import (
    ExactPosterior,
    Paths,
    Posterior,
    PosteriorSettings,
    SinglePosterior,
)
from skdgp.inference._search import Objective, SearchSettings, n_searched, some_rows, stratified
from skdgp.inference._sparse import ShareSettings, SparsePosterior
from skdgp.inference._starts import (
    coarse,
    from_coarse,
    narrowed,
    single_output,
    starting_kernel,
)
from skdgp.inference._unbiased import unbiased_factor

__all__ = [
    "AveragePosterior",
    "CentredTerm",
    "Data",
    "ExactPosterior",
    "Fit",
    "FunctionErrors",
    "KnownNoise",
    "KnownSlopes",
    "Objective",
    "OptimizerSettings",
    "Optimum",
    "Paths",
    "Posterior",
    "PosteriorSettings",
    "PosteriorWithErrors",
    "SearchSettings",
    "ShareSettings",
    "SinglePosterior",
    "SparsePosterior",
    "TileSettings",
    "as_exact",
    "autocorrelation_time",
    "average",
    "coarse",
    "fit_exact",
    "fit_sparse",
    "from_coarse",
    "function_errors",
    "log_likelihood",
    "maximize",
    "mean_errors",
    "mean_of",
    "misfit_variance",
    "n_searched",
    "narrowed",
    "narrowing",
    "residual_drift",
    "single_output",
    "some_rows",
    "starting_kernel",
    "stratified",
    "training_inputs",
    "unbiased_factor",
]

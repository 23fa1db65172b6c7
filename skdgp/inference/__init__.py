"""Exact and sparse posteriors, and the search for hyperparameters.

Terms of this folder, beside docs/notation.md:

========  =============================================================================================================
features  the inducing variables of sparse inference; what scikit-learn calls features are the regressors here
loading   A of a posterior mean A b
added     variances of the noise of values beside the white noise of their output
clock     time and flight number of each value, (n, 2)
drift     the part of the noise that is correlated in time
errors    of the function beyond the posterior: linear functions, by noise of the regressors and errors of the log
========  =============================================================================================================

Names imported as themselves are not part of the public interface: other folders of the package use
them.
"""

from skdgp._compute.statistics import autocorrelation_time as autocorrelation_time
from skdgp.inference._average import Posterior
from skdgp.inference._average import held_out as held_out
from skdgp.inference._average import stacked as stacked
from skdgp.inference._blocks import BlockSettings as BlockSettings
from skdgp.inference._blocks import blocks_of_rows as blocks_of_rows
from skdgp.inference._blocks import leaves as leaves
from skdgp.inference._blocks import order_of_rows as order_of_rows
from skdgp.inference._drift import residual_drift as residual_drift
from skdgp.inference._errors import FunctionErrors, KnownSlopes
from skdgp.inference._errors import attenuation as attenuation
from skdgp.inference._errors import errors_by_input_noise as errors_by_input_noise
from skdgp.inference._errors import errors_of_slopes as errors_of_slopes
from skdgp.inference._errors import linear_weights as linear_weights
from skdgp.inference._fit import Fit as Fit
from skdgp.inference._fit import average as average
from skdgp.inference._fit import check_inducing as check_inducing
from skdgp.inference._fit import fit_exact, fit_sparse
from skdgp.inference._fit import mixture_of as mixture_of
from skdgp.inference._fit import widened as widened
from skdgp.inference._likelihood import Data, log_likelihood
from skdgp.inference._likelihood import Likelihood as Likelihood
from skdgp.inference._noise import KnownNoise as KnownNoise
from skdgp.inference._objective import Objective as Objective
from skdgp.inference._optimizer import Optimum as Optimum
from skdgp.inference._optimizer import maximize as maximize
from skdgp.inference._posterior import ExactPosterior, Paths
from skdgp.inference._posterior import PosteriorSettings as PosteriorSettings
from skdgp.inference._posterior import SinglePosterior as SinglePosterior
from skdgp.inference._posterior import check_spread as check_spread
from skdgp.inference._search import SearchOptions as SearchOptions
from skdgp.inference._search import SearchSettings as SearchSettings
from skdgp.inference._search import search as search
from skdgp.inference._sparse import SparsePosterior
from skdgp.inference._starts import narrowed as narrowed
from skdgp.inference._starts import single_output as single_output
from skdgp.inference._starts import starting_kernel as starting_kernel
from skdgp.inference._structures import structure_weights as structure_weights

__all__ = [
    "Data",
    "ExactPosterior",
    "FunctionErrors",
    "KnownSlopes",
    "Paths",
    "Posterior",
    "SparsePosterior",
    "fit_exact",
    "fit_sparse",
    "log_likelihood",
]

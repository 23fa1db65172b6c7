"""Fits: starting values, hyperparameters, posterior."""

from __future__ import annotations

from functools import partial
from threading import Event
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from sklearn.utils import check_random_state

from skdgp._compute.linalg import check_memory, cluster_centres, column_scale, output_scale
from skdgp._compute.parallel import sharing
from skdgp._compute.threads import thread_map
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data, log_likelihood
from skdgp.inference._noise import fit_drift
from skdgp.inference._optimize import maximize
from skdgp.inference._sparse import SparsePosterior, maximize_features
from skdgp.inference._sums import shares_of

SUBSET = 2400  # values that sparse inference learns hyperparameters from jointly
FEATURE_ITERATIONS = 12  # on the bound: where the inducing inputs stand and how wide they look
NOISE_STEPS = 10  # steps, at most, to the noise that all values show
NOISE_BOUNDS = (1e-6, 1e2)  # of the variance of an output
INPUT_BOUNDS = (1e-7, 0.3)  # of the variance of a regressor
LEAST_OWN = 0.01  # of an output's noise is its own
MEMORY_STEPS = 4  # of a drift, at the start, in steps of the samples


class Fit(NamedTuple):
    """A posterior, and how its hyperparameters were found.

    ``noise`` (P,) is the variance of a measurement, which in a sparse posterior counts for less where neighbours repeat
    each other; ``root`` (d, r) is R of the regressors' noise, R R^T, where they are noisy; ``drift`` holds the
    variances and memories (P,) of noise that drifts, the former being part of ``noise``; ``value`` is the likelihood,
    or its bound, and the kernel's prior with it: by it fits of the same data can be compared.
    """

    posterior: ExactPosterior | SparsePosterior
    noise: np.ndarray
    root: np.ndarray | None
    drift: tuple[np.ndarray, np.ndarray] | None
    value: float
    n_iter: int
    n_evaluations: int
    interrupted: bool = False
    rising: bool = False
    converged: bool = True

    def found(self, interrupted: bool) -> Hyperparameters:
        """Return the hyperparameters of an exact fit, to be taken for other values."""
        history = self.n_iter, self.n_evaluations, interrupted, self.rising, self.converged
        own = self.noise if self.drift is None else self.noise - self.drift[0]
        return Hyperparameters(self.posterior.kernel, own, self.root, self.drift, *history)


class Hyperparameters(NamedTuple):
    """Hyperparameters, and how they were found; ``noise`` is without ``drift``."""

    kernel: object
    noise: np.ndarray
    root: np.ndarray | None = None
    drift: tuple[np.ndarray, np.ndarray] | None = None
    n_iter: int = 0
    n_evaluations: int = 0
    interrupted: bool = False
    rising: bool = False
    converged: bool = True

    def fit(self, posterior, value=None, more=None) -> Fit:
        """Return the posterior with the history of how it was found; ``more`` is an Optimum that followed."""
        value = posterior.log_marginal_likelihood if value is None else value
        n_evaluations = self.n_evaluations + (more.n_evaluations if more else 0)
        interrupted = self.interrupted or bool(more and more.interrupted)
        value += posterior.kernel.log_prior()
        history = self.n_iter, n_evaluations, interrupted, self.rising, self.converged
        noise = self.noise if self.drift is None else self.noise + self.drift[0]
        return Fit(posterior, noise, self.root, self.drift, value, *history)

    def data(self, X, Y, clock) -> Data:
        """Return the values with the noise that is known of them: what regressors carry, and how it drifts."""
        drift = self.drift or (None, None)
        data = Data.from_table(X, Y, None, clock, drift)
        for _ in range(0 if self.root is None else 2):  # the slopes without that noise, then those with it
            loading = input_noise_loading(ExactPosterior(self.kernel, self.noise, data), X, self.root)
            data = Data.from_table(X, Y, loading, clock, drift)
        return data


def fit_exact(
    kernel, X, Y, *, optimizer, max_iter, random_state, input_noise=None, spread=0.0, found=None, clock=None
) -> Fit:
    """Return the exact posterior at the best hyperparameters found from one starting point.

    Parameters
    ----------
    kernel : MultiOutputKernel
        What it leaves open is taken from the data.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    optimizer : "fmin_l_bfgs_b", callable or None
        None keeps the starting values.
    max_iter : int
        Iterations on the joint likelihood.
    random_state : int, RandomState or None
    input_noise : ndarray (d, r), "learned" or None
        R of the covariance R R^T of the regressors' noise; or a variance for each regressor is learned.
    spread : float
        Standard deviation of what is added to the starting theta: for restarts.
    found : Hyperparameters or None
        Hyperparameters to take as they are.
    clock : ndarray (n, 2) or None
        Time and flight of each sample: the noise of neighbours in time may be correlated, see ``Drift``.

    Returns
    -------
    Fit
        The posterior, its hyperparameters, and how the search went.
    """
    if found is None:
        options = optimizer, max_iter, check_random_state(random_state), input_noise, spread
        found = _learn(kernel.prepared(X), X, Y, clock, slice(None), *options)
    return found.fit(ExactPosterior(found.kernel, found.noise, found.data(X, Y, clock)))


def fit_sparse(
    kernel, X, Y, *, n_inducing, optimizer, max_iter, random_state, input_noise=None, spread=0.0, found=None, clock=None
) -> Fit:
    """Return the sparse posterior on all samples, at hyperparameters learned from some of them.

    Parameters
    ----------
    kernel, X, Y
        As for ``fit_exact``.
    n_inducing : int
        Inducing inputs of each latent process; they start at the centres of k-means and are learned.
    optimizer, max_iter, random_state, input_noise, spread, found, clock
        As for ``fit_exact``.

    Returns
    -------
    Fit
        The posterior, its hyperparameters, and how the search went.

    Raises
    ------
    ValueError
        When matrices of all inducing variables would not fit the machine's memory.
    """
    random_state, kernel = check_random_state(random_state), kernel.prepared(X)
    Z = _centres(X, n_inducing, random_state)
    size = kernel.initialize(X, Y, np.random.RandomState(0)).features(Z).size
    check_memory(size, "Sparse inference with", "Lower n_inducing.", n_matrices=8)
    if found is None:
        rows = some_rows(Y, random_state)
        found = _learn(kernel, X, Y, clock, rows, optimizer, max_iter, random_state, input_noise, spread)
    kernel, features = found.kernel, found.kernel.features(Z)
    shares = shares_of(Data.from_table(X, Y))
    with sharing(shares):
        total = found.noise if found.drift is None else found.noise + found.drift[0]
        posterior = SparsePosterior(kernel, features, total, shares)
        if optimizer is None:
            return _reached(found, posterior, X, Y, clock, 1.0)
        least = NOISE_BOUNDS[0] * output_scale(Y) ** 2
        posterior = _with_converged_noise(posterior, 1.0, least)
        value, repeats = posterior.log_marginal_likelihood, _repeats(posterior, X, Y)
        # From here on so many neighbours in the log count as one: what each says is known with that much more noise.
        posterior = _with_converged_noise(posterior, repeats, least)
        noise = posterior.noise
        found = found._replace(noise=noise / repeats)
        if clock is not None:
            found = _drift_at_full_rate(found, posterior, X, Y, clock, least)
    if found.interrupted:
        return _reached(found, posterior, X, Y, clock, repeats, value)
    features, best = _learn_features(features, kernel, noise, X, Y, int(repeats.min()))
    with sharing(shares):
        posterior = SparsePosterior(kernel, features, noise, shares)
    return _reached(found, posterior, X, Y, clock, repeats, value, best)


def _reached(found, posterior, X, Y, clock, repeats, value=None, more=None) -> Fit:
    """Return the fit, where regressors are noisy with the noise that they carry, of what had seemed each output's own.

    ``repeats`` (P,) neighbours count as one, in this as in the rest of the noise, unless noise drifts.
    """
    if found.root is None and found.drift is None:
        return found.fit(posterior, value, more)
    noise, drift, loading = found.noise, found.drift, None
    if found.root is not None:
        loading = input_noise_loading(posterior, X, found.root)
        carried = np.mean(np.einsum("npr,npr->np", loading, loading), axis=0)
        loading = loading * np.sqrt(repeats * np.ones(len(noise)))[:, None]
        noise = np.maximum(noise - carried, LEAST_OWN * noise)
        if drift is not None:
            drift = np.maximum(drift[0] - (carried - (found.noise - noise)), LEAST_OWN * drift[0]), drift[1]
    shares = shares_of(Data.from_table(X, Y, loading, None if drift is None else clock, drift or (None, None)))
    with sharing(shares):
        counted = noise * repeats if drift is None else noise
        posterior = SparsePosterior(posterior.kernel, posterior.features, counted, shares)
    return found._replace(noise=noise, drift=drift).fit(posterior, value, more)


def _drift_at_full_rate(found, posterior, X, Y, clock, least):
    """Return the hyperparameters with the noise that the residuals of all samples show, white and drifting."""
    residual, total = Y - posterior.predict(X), found.noise
    noise, drift = np.array(total), np.ones((2, len(total)))
    for i, e in enumerate(residual.T):
        seen = np.isfinite(e)
        if seen.sum() > 2:
            white, variance, drift[1, i] = fit_drift(e[seen], clock[seen], least[i])
            scale = total[i] / (white + variance)  # the function, too, is uncertain
            noise[i], drift[0, i] = white * scale, variance * scale
        else:
            drift[0, i] = least[i]
    return found._replace(noise=noise, drift=tuple(drift))


def _learn_features(features, kernel, noise, X, Y, step):
    """Return the best features and the Optimum they are of: of neighbours that repeat each other one is enough."""
    if len(features.theta) == 0:
        return features, None
    shares = shares_of(Data.from_table(X[::step], Y[::step]))
    with sharing(shares):
        start = SparsePosterior(kernel, features, noise / step, shares)
        return maximize_features(start, column_scale(X), max_iter=FEATURE_ITERATIONS, stage="bound")


def _with_converged_noise(posterior, repeats, least):
    """Return the posterior at the noise that all values together show, each counted as one in so many."""
    for _ in range(NOISE_STEPS):
        noise = np.maximum(posterior.noise_seen(), least)
        change = np.abs(np.log(noise * repeats / posterior.noise)).max()
        posterior = posterior.with_noise(noise * repeats)
        if change < 0.01:
            break
    return posterior


def _repeats(posterior, X, Y):
    """Return, for each output, how many neighbouring samples count as one."""
    residual = Y - posterior.predict(X)
    return np.array([autocorrelation_time(e[np.isfinite(e)]) for e in residual.T])


def _start_of_noise(residual, scale, clock):
    """Return the noise to start from and its bounds: variances (P,), and where it drifts variances and memories too."""
    bounds = np.multiply.outer(scale**2, NOISE_BOUNDS)
    noise = np.clip(0.2 * np.nanvar(residual, axis=0), *bounds.T)
    if clock is None:
        return noise, bounds
    time, flight = clock.T
    steps = np.abs(np.diff(time))[np.diff(flight) == 0]
    step = float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 1.0
    longest = max(float(np.ptp(time[flight == one])) for one in np.unique(flight))
    memory = np.full(len(noise), MEMORY_STEPS * step)
    span = np.tile([step, max(longest, 2 * MEMORY_STEPS * step)], (len(noise), 1))
    return np.concatenate([0.5 * noise, 0.5 * noise, memory]), np.concatenate([bounds, bounds, span])


def _learn(kernel, X, Y, clock, rows, optimizer, max_iter, random_state, input_noise, spread) -> Hyperparameters:
    """Return hyperparameters: of each output alone, then of all jointly from the rows."""
    P = Y.shape[1]
    open_kernel, kernel = kernel, kernel.initialize(X, Y, random_state)
    noise, noise_bounds = _start_of_noise(kernel.residual(X, Y), output_scale(Y), clock)
    stop = Event()
    singles, n_evaluations, n_iter = None, 0, 0
    if optimizer is not None and P > 1 and not open_kernel.has_values():
        alone = fit_singles(open_kernel, noise, noise_bounds, X, Y, clock, optimizer, max_iter, random_state, stop)
        singles, noise, n_evaluations = alone
    scale, X, Y, clock = column_scale(X), X[rows], Y[rows], None if clock is None else clock[rows]
    data = Data.from_table(X, Y, None, clock)

    def hyperparameters(kernel, noise, root):
        drift = None if clock is None else (noise[P : 2 * P], noise[2 * P : 3 * P])
        return Hyperparameters(kernel, noise[:P], root, drift)

    if optimizer is None:
        return hyperparameters(kernel, noise, None if isinstance(input_noise, str) else input_noise)

    def climb(name, kernel, noise, bounds, max_iter, data, spread=0.0):
        theta = np.concatenate([kernel.theta, np.log(noise)])
        theta += spread * random_state.normal(size=theta.shape)
        best = maximize(
            likelihood_of(kernel, data, len(noise)),
            theta,
            bounds_of(kernel, bounds),
            optimizer=optimizer,
            max_iter=max_iter,
            name=name,
            stop=stop,
        )
        theta, noise = np.split(best.theta, [-len(noise)])
        return kernel.clone_with_theta(theta), np.exp(noise), best

    # From few hyperparameters to many: filters alike over the outputs first. From there the way up is short, and it
    # ends at optima that predict better than those found from arbitrary widths. Where regressors are noisy, the slopes
    # found on the way say what their noise carries.
    kernel = open_kernel.initialize(X, Y, random_state, singles)
    coarse = open_kernel.coarse().initialize(X, Y, random_state, singles)
    if coarse.n_dims < kernel.n_dims or input_noise is not None:
        coarse, noise, best = climb("coarse", coarse, noise, noise_bounds, -(-max_iter // 2), data, spread)
        n_evaluations, n_iter, spread = n_evaluations + best.n_evaluations, best.n_iter, 0.0
        kernel = open_kernel.initialize(X, Y, random_state, singles, coarse)
    root, bounds = input_noise, noise_bounds
    if input_noise is not None:
        root = np.diag(scale) if isinstance(input_noise, str) else input_noise
        # Learned with the rest, the drift is no part of the data.
        data = hyperparameters(coarse, noise, root).data(X, Y, clock)
        data = data._replace(drift=data.drift and data.drift._replace(variance=None, memory=None))
    if isinstance(input_noise, str):
        noise, more = _start_of_inputs(noise, P, data, len(scale))
        bounds = np.concatenate([noise_bounds, more])
    kernel, noise, best = climb("fit", kernel, noise, bounds, max_iter - n_iter, data, spread)
    if isinstance(input_noise, str):
        root = root * np.sqrt(noise[len(noise_bounds) :])
    return hyperparameters(kernel, noise, root)._replace(
        n_iter=n_iter + best.n_iter,
        n_evaluations=n_evaluations + best.n_evaluations,
        interrupted=stop.is_set(),
        rising=best.rising,
        converged=best.converged,
    )


def input_noise_loading(posterior, X, root) -> np.ndarray:
    """Return where noisy regressors carry the outputs, G = J R, (n, P, r): slopes of the mean times R."""
    return posterior.gradient(X) @ root


def _start_of_inputs(noise, P, data, d):
    """Return the noise with variances s (d,) of the regressors, over their own, to start from, and bounds of s.

    At the start half of the outputs' own noise comes from the regressors, each off by the same part of its spread.
    """
    carried = [np.mean(np.sum(G**2, axis=1)) if len(G) else np.nan for G in data.sample_noise.loading]
    part = 0.5 * float(np.nanmedian(noise[:P] / np.maximum(carried, 1e-12)))
    least, most = INPUT_BOUNDS
    start = np.full(d, np.clip(part, 10 * least, most / 10))
    return np.concatenate([0.5 * noise[:P], noise[P:], start]), np.tile(INPUT_BOUNDS, (d, 1))


def some_rows(Y, random_state):
    """Return rows with about SUBSET observed values, every output among them as often as its share allows."""
    seen = np.isfinite(Y)
    quota = SUBSET // Y.shape[1]
    chosen = spread(np.arange(len(Y)), max(2, SUBSET * len(Y) // seen.sum()), random_state)
    for output in seen.T:
        lacking = min(quota, output.sum()) - output[chosen].sum()
        rest = np.setdiff1d(np.flatnonzero(output), chosen, assume_unique=True)
        chosen = np.concatenate([chosen, spread(rest, max(lacking, 0), random_state)])
    return np.sort(chosen)


def _centres(X, n_inducing, random_state):
    """Return at most n_inducing centres of the samples, (k, d)."""
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    some = X[random_state.permutation(len(X))[: 50 * n_inducing]]
    return cluster_centres(some, column_scale(X), n_inducing, random_state)


# -- each output alone: where the joint search starts ------------------------------------------------------


SINGLE_VALUES, SINGLE_ITERATIONS = 800, 100  # of each output
WIDTH_FACTORS, TRIAL_VALUES, TRIAL_ITERATIONS = (
    (1.0, 0.3, 0.1),
    250,
    40,
)  # widths tried before, on how many values, how long


class Singles(NamedTuple):
    """Kernel and noise of each output alone, and the evaluations that they took."""

    kernels: list
    noise: np.ndarray
    n_evaluations: int


class _Output:
    """The values of one output, and the ways up its likelihood."""

    def __init__(self, i, X, Y, clock, noise, noise_bounds, seed, search):
        rows = spread(np.flatnonzero(np.isfinite(Y[:, i])), SINGLE_VALUES, np.random.RandomState(seed))
        self.x, self.y, self.seed = X[rows], Y[rows, i : i + 1], seed
        self.clock = None if clock is None else clock[rows]
        self.noise, self.noise_bounds = noise[i :: Y.shape[1]], noise_bounds[i :: Y.shape[1]]
        self.search = partial(search, stage=f"output {i + 1}")

    def climb(self, kernel, theta, step, max_iter, name=None):
        """Return the kernel without values and the Optimum from theta on, of every step-th value."""
        clock = None if self.clock is None else self.clock[::step]
        likelihood = likelihood_of(
            kernel, Data.from_table(self.x[::step], self.y[::step], None, clock), len(self.noise)
        )
        bounds = bounds_of(kernel, self.noise_bounds)
        return kernel, self.search(likelihood, theta, bounds, max_iter=max_iter, name=name)

    def attempt(self, kernel, width_factor, max_iter):
        """Return where a few of the values lead from one width."""
        start = kernel.single_output().initialize(
            self.x, self.y, np.random.RandomState(self.seed), width_factor=width_factor
        )
        theta = np.concatenate([start.theta, np.log(self.noise)])
        name = f"{self.search.keywords['stage']} from {width_factor}"
        return self.climb(start, theta, max(1, len(self.x) // TRIAL_VALUES), min(TRIAL_ITERATIONS, max_iter), name)


def fit_singles(kernel, noise, noise_bounds, X, Y, clock, optimizer, max_iter, random_state, stop: Event) -> Singles:
    """Return a fit of each output alone, in at most twice ``max_iter`` iterations each.

    A single output has a P-th of the values: its fit costs a P^3-th of the joint one. From widths that are far too
    long, "all noise" is the nearest hill: which hill it is, some of the values tell, from several widths.
    """
    search = partial(maximize, optimizer=optimizer, stop=stop)
    seeds = random_state.randint(2**31 - 1, size=Y.shape[1])
    outputs = [_Output(i, X, Y, clock, noise, noise_bounds, seed, search) for i, seed in enumerate(seeds)]
    tasks = [(output, width_factor) for output in outputs for width_factor in WIDTH_FACTORS]
    tries = thread_map(lambda task: task[0].attempt(kernel, task[1], max_iter), tasks, stop)
    n = len(WIDTH_FACTORS)
    best = [max(tries[k : k + n], key=lambda end: end[1].value) for k in range(0, len(tries), n)]

    def refine(task):
        output, (single, optimum) = task
        return output.climb(single, optimum.theta, 1, min(SINGLE_ITERATIONS, 2 * max_iter))

    ends = thread_map(refine, zip(outputs, best, strict=True), stop)
    k = len(noise) // Y.shape[1]  # of each output
    return Singles(
        [single.clone_with_theta(end.theta[:-k]) for single, end in ends],
        np.array([np.exp(end.theta[-k:]) for _, end in ends]).T.ravel(),
        sum(end.n_evaluations for _, end in (*tries, *ends)),
    )


def likelihood_of(kernel, data, n_noise):
    """Return the log likelihood, and what the kernel's prior adds to it, as a function of [theta, log noise]."""
    workspace = np.empty((data.n_values, data.n_values))

    def evaluate(theta):
        kernel_there, noise = kernel.clone_with_theta(theta[:-n_noise]), np.exp(theta[-n_noise:])
        value, gradient = log_likelihood(kernel_there, noise, data, eval_gradient=True, workspace=workspace)
        prior, slope = kernel_there.log_prior(eval_gradient=True)
        gradient[: len(slope)] += slope
        return value + prior, gradient

    return evaluate


def bounds_of(kernel, noise_bounds):
    """Return the bounds of [theta, log noise]."""
    return np.concatenate([kernel.bounds, np.log(noise_bounds)])


def spread(rows, n, random_state):
    """Return n of the rows, spread over them: in a log neighbours say the same. One by chance of each n-th part."""
    if n >= len(rows):
        return rows
    edges = np.linspace(0, len(rows), n + 1)
    return rows[(edges[:-1] + np.diff(edges) * random_state.uniform(size=n)).astype(int)]


# -- how far neighbouring samples repeat each other ---------------------------------------------------------


WINDOW = 5.0  # autocorrelation times over which the correlations are summed


def autocorrelation_time(residuals) -> float:
    r"""Return how many neighbouring values count as one, at least 1.

    The variance of a mean of n values with autocorrelation rho is that of n / tau independent ones, with the
    integrated autocorrelation time

    .. math:: \tau = 1 + 2 \sum_{k=1}^{K} \rho_k,

    summed up to the first K of at least 5 tau (Sokal 1997, section 3): beyond it the sum gathers noise.

    Parameters
    ----------
    residuals : ndarray (n,)
        In the order in which they were recorded. Shuffled ones repeat nothing: 1, but for chance.

    Returns
    -------
    float
        tau, in samples.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.inference import autocorrelation_time
    >>> white = np.random.default_rng(0).normal(size=5000)
    >>> round(autocorrelation_time(white))
    1
    >>> round(autocorrelation_time(np.repeat(white, 8)))
    8
    """
    centred = residuals - np.mean(residuals)
    n = len(centred)
    power = np.abs(rfft(centred, next_fast_len(2 * n))) ** 2
    covariance = irfft(power)[:n]
    if not covariance[0] > 0:
        return 1.0
    tau = 2 * np.cumsum(covariance / covariance[0]) - 1
    enough = np.arange(n) >= WINDOW * tau
    return float(max(1.0, tau[np.argmax(enough)] if enough.any() else tau[-1]))

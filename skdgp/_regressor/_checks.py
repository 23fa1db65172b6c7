"""Checks of the data and parameters of DependentGPRegressor, and its warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_array

from skdgp._compute.files import column_names
from skdgp._compute.findings import Finding, Kind
from skdgp._compute.linalg import constant_columns
from skdgp._compute.messages import FindingWarning, report
from skdgp._compute.statistics import autocorrelation_time, check_deviations
from skdgp.inference import KnownNoise
from skdgp.kernels import MultiOutputKernel

# Magnitudes of regressors whose fourth powers neither overflow nor vanish
X_RANGE = (1e-60, 1e60)
# Magnitudes of targets whose squares neither overflow nor vanish
Y_RANGE = (1e-100, 1e100)


@dataclass(frozen=True)
class WarningSettings:
    """When a fit is warned of."""

    #: Independent rows for each regressor: with fewer bands hold under 85 %, see docs/sharp_bits.md
    least_rows: int = 10
    #: Relative distance from a bound at which a value has reached it (guess)
    bound_tolerance: float = 1e-3
    #: Smallest standard deviation of a process that explains some of an output, over the one of the output
    least_process: float = 1e-3
    #: Autocorrelation time below which errors count as independent [rows] (guess)
    white: float = 2.0


SETTINGS = WarningSettings()


class FitCode(Kind):
    """Findings of a fit."""

    APPROXIMATION_POOR = (
        "{inducing} inducing inputs leave {neglected:.2g} of the noise variance unexplained"
        "[: the model is learned from {exact} of the values instead]",
        "Raise n_inducing to learn from all.",
    )
    BOUNDS_REACHED = (
        "got hyperparameters that end at a bound of the kernel: {reached:short}",
        "Widen the bounds, unless they are known to hold.",
    )
    CONSTANT_INPUTS = (
        "the regressors {names!r} are constant over the samples: their effect cannot be learned, and "
        "predictions at other values are not reliable",
        "Leave them out, or add samples in which they vary.",
    )
    CONSTANT_OUTPUTS = (
        "the outputs {names!r} are constant over the samples: nothing can be learned about them, and their "
        "stated uncertainty is not reliable",
        "Leave them out, or check the data.",
    )
    EXPLAINED_AS_NOISE = (
        "the kernel explains nothing of the outputs {names!r}: all of their variance is noise",
        "Give shorter length scales to start from, or raise n_restarts_optimizer.",
    )
    FEW_ROWS = (
        "got {rows} rows[, worth {independent:.0f} independent ones as errors last {lasting:.0f} rows,] for "
        "{regressors} regressors, {each:.2g} for each, but expected at least {least} for each: with fewer, "
        "the model leans on the linear trend, and standard deviations may be too small",
        "Give more rows, or name fewer regressors.",
    )
    INDICES_DIFFER = (
        "the indices of X and y differ; rows are matched by position",
        "If rows of one were dropped or sorted, do the same to the other (y.loc[X.index]).",
    )
    SAMPLES_REPEATED = (
        "{repeated} of {samples} samples repeat another sample with the same regressors and targets",
        "They count as independent, so the uncertainty is too small: drop repeated rows.",
    )
    OUTLIERS_FOUND = (
        "{count} values lie far from the others, and count as outliers: {outliers:short}",
        "Check them. If the function jumps or has a narrow peak there, give noise_variance: then none is an outlier.",
    )
    SEARCH_ROUNDED = (
        "the fit stopped before it converged, where rounding errors hide whether the likelihood rises",
        "Give a larger noise_variance, or bounds that keep it above 1e-10 of the variance of the outputs.",
    )
    SEARCH_STOPPED = (
        "the fit stopped at max_iter={max_iter} before it converged",
        "Raise max_iter.",
    )


class SearchWarning(FindingWarning, ConvergenceWarning):
    """The search for hyperparameters ended early, or at a bound."""


class FewRowsWarning(FindingWarning):
    """There are too few independent rows for the number of regressors: bands are too narrow."""


def check_targets(y: Any, n_samples: int, estimator: str) -> tuple[np.ndarray, list[str], bool]:
    """Return the targets as (n, P) with NaN where not observed, their names, and whether y is one-dimensional."""
    if y is None:
        raise ValueError(
            f"This {estimator} estimator requires y to be passed, but the target y is None."
        )
    names = column_names(y)
    if np.ma.isMaskedArray(y):
        y = np.ma.filled(y.astype(float), np.nan)
    Y = check_array(
        y, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan", input_name="y"
    )
    if Y.ndim > 2:
        raise ValueError(f"Got y of shape {Y.shape}, but expected (n,) or (n, P).")
    if len(Y) != n_samples:
        raise ValueError(
            f"Found input variables with inconsistent numbers of samples: {[n_samples, len(Y)]}. "
            "Give y one row for each row of X, with NaN where an output was not observed."
        )
    table = Y.reshape(len(Y), -1)
    return table, names or [f"y{i}" for i in range(table.shape[1])], Y.ndim == 1


def check_unmasked(X: Any) -> None:
    """Raise a ValueError if regressors are masked."""
    if np.ma.isMaskedArray(X) and np.ma.getmaskarray(X).any():
        raise ValueError(
            f"Got X with {int(np.ma.getmaskarray(X).sum())} masked values, but expected all "
            "regressors of every sample: leave these rows out, or fill them."
        )


def standardize(
    Y: np.ndarray, centered: bool, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centred and scaled targets, and the center and scale of each output, (P,).

    The center is the mean with the ``weights`` (n, P) of the values, by default equal ones.

    The center of a constant output is its value, and its scale is the magnitude of that value, so
    it becomes 0 or 1 without rounding.
    """
    constant = constant_columns(Y)
    observed = np.isfinite(Y)
    first = Y[observed.argmax(axis=0), range(Y.shape[1])]
    Y = np.where(constant & observed, first, Y)
    center = np.zeros(Y.shape[1])
    if centered:
        weighted = observed * (1.0 if weights is None else weights)
        mean = np.nansum(weighted * Y, axis=0) / weighted.sum(axis=0)
        center = np.where(constant, first, mean)
    deviation = np.sqrt(np.nanmean((Y - center) ** 2, axis=0))
    magnitude = np.where(first == 0.0, 1.0, np.abs(first))
    scale = np.where(constant, magnitude, deviation)
    return (Y - center) / scale, center, scale


def check_clock(time: Any, flight: Any, n_samples: int) -> np.ndarray | None:
    """Return time and flight number of each sample, (n, 2), or None if no time is given."""
    if time is None:
        if flight is not None:
            raise ValueError(
                "Got flight without time, but expected both: the drift depends on time. Give time too."
            )
        return None
    kind = np.asarray(time).dtype
    if kind.kind in "mM":
        raise ValueError(
            f"Got time of type {kind}, but expected seconds: (time - time[0]) / np.timedelta64(1, 's')."
        )
    time = check_array(time, dtype=np.float64, ensure_2d=False, input_name="time")
    codes = np.zeros(n_samples)
    if flight is not None:
        codes = pd.factorize(np.asarray(flight), sort=True)[0].astype(float)
    for name, values in (("time", time), ("flight", codes)):
        if values.shape != (n_samples,):
            raise ValueError(
                f"Got {name} of shape {values.shape}, but expected ({n_samples},): one value for each row of X."
            )
    n_unlabelled = int((codes < 0).sum())
    if n_unlabelled:
        raise ValueError(
            f"Got {n_unlabelled} rows without a flight, but expected a label for every row."
        )
    return np.column_stack([time, codes])


def check_input_noise(input_noise: Any, n_regressors: int) -> np.ndarray | None:
    """Return known standard deviations of the regressors (d,), None where they are learned or zero."""
    if input_noise is None or isinstance(input_noise, str):
        return None
    expected = (
        "'auto', 'learned', None, or a standard deviation of at least zero for each of the "
        f"{n_regressors} regressors"
    )
    return check_deviations("input_noise", input_noise, n_regressors, expected)


def check_noise(variance: Any, bounds: Any, Y: np.ndarray, is_single: bool) -> KnownNoise:
    """Return the known noise of Y (n, P), in squared units of the outputs.

    ``variance`` has one number, one for each output (P,), or one for each value, in the shape of
    Y; ``bounds`` are a pair or (P, 2).
    """
    limits = _check_noise_bounds(bounds, Y.shape[1])
    if variance is None:
        return KnownNoise(None, limits)
    P = Y.shape[1]
    values = np.asarray(variance, dtype=float)
    of_single = is_single and values.shape == (len(Y),) != (1,)
    for_values = values.shape == Y.shape or of_single
    if values.shape not in ((), (P,)) and not for_values:
        shape = (len(Y),) if is_single else Y.shape
        raise ValueError(
            f"Got noise_variance of shape {values.shape}, but expected one number, ({P},) for the outputs, "
            f"or one for each value of y, {shape}."
        )
    used = values.reshape(Y.shape)[np.isfinite(Y)] if for_values else values
    if not (np.isfinite(used) & (used > 0)).all():
        raise ValueError(
            "Got noise_variance with values that are not positive and finite, but expected variances above zero: "
            "leave out samples without a known one, or use a small number."
        )
    if for_values and limits is not None:
        raise ValueError(
            "Got noise_variance_bounds and a noise_variance for each value, but expected one of them: "
            "variances of values are known, and not learned."
        )
    if for_values:
        table = np.where(np.isfinite(Y), values.reshape(Y.shape), np.nan)
        smallest = np.nanmin(table, axis=0)
        return KnownNoise.of_values(np.where(np.isnan(table), smallest, table))
    white = np.broadcast_to(values, P).astype(float)
    if limits is None:
        return KnownNoise(white, np.column_stack([white, white]))
    _check_inside("noise_variance", white, limits)
    return KnownNoise(white, limits)


def _check_noise_bounds(bounds, P):
    """Return bounds of the noise variance, (P, 2), or None if none are given."""
    if bounds is None:
        return None
    limits = np.asarray(bounds, dtype=float)
    is_ordered = (limits > 0).all() and (np.diff(limits) >= 0).all()
    if limits.shape not in ((2,), (P, 2)) or not is_ordered:
        raise ValueError(
            f"Got noise_variance_bounds={bounds!r}, but expected 0 < lower <= upper: a pair, "
            f"or one for each of the {P} outputs."
        )
    return np.broadcast_to(limits, (P, 2)).copy()


def check_magnitudes(Z: np.ndarray, names: list[str], what: str, least: float, most: float) -> None:
    """Raise a ValueError if powers of columns of Z (n, k) overflow or vanish in double precision; NaN is ignored."""
    size = np.nanmax(np.abs(Z), axis=0, initial=0.0)
    extreme = (size > most) | ((size < least) & (size > 0))
    if extreme.any():
        magnitudes = {names[k]: f"{size[k]:.1g}" for k in np.flatnonzero(extreme)}
        raise ValueError(
            f"Got {what} of magnitudes {magnitudes}, but expected {least:g} to {most:g}, whose powers neither vanish "
            "nor overflow. Use another unit, or scale them (StandardScaler)."
        )


def check_observed(Y: np.ndarray, names: list[str]) -> None:
    """Raise a ValueError if an output has fewer than two observed values."""
    n_observed = np.isfinite(Y).sum(axis=0)
    few = {names[k]: int(n_observed[k]) for k in np.flatnonzero(n_observed < 2)}
    if few:
        raise ValueError(
            f"Got outputs observed at fewer than two samples: {few} (NaN means not observed). "
            "Leave these columns out, or give more of their values."
        )


def warn_of_approximation(neglected: float, n_inducing: int, n_exact: int | None) -> None:
    """Warn that inducing inputs leave a variance unexplained, ``neglected`` over the noise variance.

    ``n_exact``: the number of values that the model is learned from instead, if any.
    """
    report(
        Finding(FitCode.APPROXIMATION_POOR, inducing=n_inducing, neglected=neglected, exact=n_exact)
    )


def warn_of_indices(index: Any, y: Any) -> None:
    """Warn if X and y have different indices."""
    if not isinstance(index, pd.Index) or not isinstance(y, (pd.DataFrame, pd.Series)):
        return
    if not index.equals(y.index):
        report(Finding(FitCode.INDICES_DIFFER))


def warn_of_samples(
    X: np.ndarray, Y: np.ndarray, regressors: list[str], outputs: list[str]
) -> None:
    """Warn of constant regressors and outputs, and of repeated samples."""
    constant = _marked(regressors, constant_columns(X))
    if constant:
        report(Finding(FitCode.CONSTANT_INPUTS, names=constant))
    constant = _marked(outputs, constant_columns(Y))
    if constant:
        report(Finding(FitCode.CONSTANT_OUTPUTS, names=constant))
    repeated = int(pd.DataFrame(np.column_stack([X, Y])).duplicated().sum())
    if repeated:
        report(Finding(FitCode.SAMPLES_REPEATED, repeated=repeated, samples=len(X)))


def _marked(names, mask):
    """Return the names of the columns that are marked."""
    return [names[k] for k in np.flatnonzero(mask)]


def warn_of_few_rows(
    errors: np.ndarray,
    n_regressors: int,
    members: list[str],
) -> None:
    """Warn if there are fewer than ``SETTINGS.least_rows`` independent rows for each regressor.

    ``errors`` (n, P) are residuals of the targets, in recording order, NaN where not observed. They
    count as rows over their autocorrelation time, median over the outputs. An average leans on its
    trend then. A trend alone states its uncertainty well with few rows, if there are more than
    regressors and their errors are not correlated.
    """
    times, counts = [], []
    for column in errors.T:
        observed = column[np.isfinite(column)]
        times.append(autocorrelation_time(observed))
        counts.append(len(observed))
    lasting = float(np.median(times))
    lasting = lasting if lasting >= SETTINGS.white else 1.0
    rows = float(np.median(counts)) / lasting
    is_trend = members == ["trend"] and lasting == 1.0 and rows > n_regressors
    if rows >= SETTINGS.least_rows * n_regressors or is_trend:
        return
    report(
        Finding(
            FitCode.FEW_ROWS,
            rows=len(errors),
            independent=rows,
            lasting=lasting if lasting > 1 else None,
            regressors=n_regressors,
            each=rows / n_regressors,
            least=SETTINGS.least_rows,
        ),
        FewRowsWarning,
    )


def search_ended(regressor: Any) -> Finding | None:
    """Return why the search of a fitted regressor ended before it converged, None if it converged."""
    if regressor.converged_:
        return None
    if regressor.n_iter_ < regressor.max_iter:
        return Finding(FitCode.SEARCH_ROUNDED)
    return Finding(FitCode.SEARCH_STOPPED, max_iter=regressor.max_iter)


def warn_of_outliers(
    added: np.ndarray, noise: np.ndarray, names: Sequence[str], rows: np.ndarray
) -> None:
    """Warn of values whose own noise variance, ``added`` (n, P), is larger than the ``noise`` (P,) of all.

    ``rows`` (n,) are their numbers in the table.
    """
    outliers = []
    for name, of_output, white in zip(names, added.T, noise, strict=True):
        outliers += [f"{name} of row {row}" for row in np.sort(rows[of_output > white])]
    if outliers:
        report(Finding(FitCode.OUTLIERS_FOUND, count=len(outliers), outliers=outliers))


def warn_of_bounds(given: MultiOutputKernel, kernel: MultiOutputKernel) -> None:
    """Warn of hyperparameters that end at a bound which the user gave.

    ``kernel`` is the fitted one, in the units of ``given``, whose terms are its last ones. A value
    that was given at its bound and stayed there is no news.
    """
    terms = given.summands()
    reached = []
    for term, fitted in zip(terms, kernel.summands()[-len(terms) :], strict=True):
        before = _at_bounds(term, term) if term.has_values() else []
        reached += [text for text in _at_bounds(term, fitted) if text not in before]
    if reached:
        finding = Finding(FitCode.BOUNDS_REACHED, reached=reached)
        report(finding, SearchWarning)


def warn_of_noise(
    kernel: MultiOutputKernel, X: np.ndarray, names: list[str], scale: np.ndarray
) -> None:
    """Warn of outputs that the processes of a fitted kernel leave to the noise; ``scale`` (P,) are their deviations."""
    processes = [term for term in kernel.summands() if term.n_processes]
    variance = sum(term.diag(X[:1]) for term in processes)
    is_noise = variance < (SETTINGS.least_process * scale) ** 2
    if processes and np.any(is_noise):
        outputs = np.array(names)[is_noise].tolist()
        report(Finding(FitCode.EXPLAINED_AS_NOISE, names=outputs), SearchWarning)


def check_start(kernel: MultiOutputKernel, X: np.ndarray, Z: np.ndarray) -> None:
    """Raise a ValueError if values that were given to a kernel lie outside of bounds that were given.

    X (n, d) and Z (n, P) are the samples, which a kernel needs to know its shape.
    """
    start = kernel.initialize(X, Z, np.random.RandomState(0))
    for given, term in zip(kernel.summands(), start.summands(), strict=True):
        parameters = given.get_params()
        for f in term.free_parameters():
            is_given = parameters[f.name] is not None and not given.bounds_from_data(f.name)
            if f.n_elements and is_given:
                _check_inside(f.name, f.elements(term.values()[f.name]), f.pairs())


def _check_inside(name, values, pairs):
    """Raise a ValueError unless values (n,) lie inside their bounds ``pairs`` (n, 2)."""
    low, high = pairs.T
    outside = (values < (1 - 1e-9) * low - 1e-12) | (values > (1 + 1e-9) * high + 1e-12)
    if outside.any():
        k = int(np.flatnonzero(outside)[0])
        raise ValueError(
            f"Got {name}={values[k]:.4g} with the bounds ({low[k]:.4g}, {high[k]:.4g}), but expected a "
            "starting value inside its bounds: give wider bounds, or another value."
        )


def _at_bounds(given, kernel):
    """Return texts of the elements of a kernel that are at a bound, unless data gave the bound of the given one."""
    texts = []
    for f in kernel.free_parameters():
        if not f.n_elements or given.bounds_from_data(f.name):
            continue
        values = f.elements(kernel.value(f.name))
        pairs = f.pairs()
        ends = np.isclose(values[:, None], pairs, rtol=SETTINGS.bound_tolerance, atol=0.0)
        for k, side in np.argwhere(ends & (pairs[:, :1] < pairs[:, 1:])):
            entry = np.argwhere(f.index == k)[0].tolist()
            bound = f"{('lower', 'upper')[side]} bound {pairs[k, side]:.3g}"
            texts.append(f"{f.name}{entry} = {values[k]:.3g} ({bound})")
    return texts

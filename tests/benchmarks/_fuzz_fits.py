"""Fuzz of the regressor: ill-conditioned fits are refused, with what to do, or come out sound.

A case draws regressors and targets, spoils both in some ways, draws the regressor's parameters, fits, and asks
everything of the fit that a user may. Sound means, with deviations in units of what they are compared with:

- means and deviations are finite, deviations not negative nor, but for 1e-6, above the prior's;
- means at the samples are within 1000 ranges of the targets, or a hundredth of their size;
- joint covariances are positive semidefinite but for 1e-6 of the prior's variance (1e-4 where inference is sparse),
  their diagonals squared deviations;
- a sparse bound is not above the likelihood of the same values at the same hyperparameters;
- ``partial_fit`` knows what conditioning on all values at once does;
- where nothing is optimised, columns and targets times powers of two, targets moved, constant columns at zero, and
  rows in another order change predictions by at most 1e-4 of the prior's deviation.
"""

import copy
import pickle
import traceback
import warnings
from functools import partial

import numpy as np
from _fuzzing import Campaign, Difference, only
from sklearn.base import clone

from skdgp import DependentGPRegressor
from skdgp._compute.linalg import JitterWarning
from skdgp.inference import ExactPosterior
from skdgp.inference._sparse import data_from_shares

DOCUMENTED = (
    "The outputs .* are constant",
    "The regressors .* are constant",
    "Compacting to .* changes mean or standard deviation",
    ".* samples repeat another sample",
    "Got n_inducing=",
    "The fit was interrupted",
    "The fit stopped at max_iter",
    "The covariance matrix of .* was not positive definite",
)
FAR = 1e3  # ranges of the targets
SAME = 1e-4  # prior deviations
ROUNDING = {"exact": 1e-6, "sparse": 1e-4, "compact": 1e-4}  # of the prior's variance or deviation
STILL = 1e-14  # of its size is the spread of a target that the regressor calls constant


# -- regressors and targets ------------------------------------------------------------------------------


def constant(X, rng):
    X[:, _one(X, rng)] = rng.choice([0.0, 0.6, 1 / 3, -7.0, 1e9, 1e-9, 0.1])


def nearly_constant(X, rng):
    k = _one(X, rng)
    X[:, k] = 0.6 * (1 + rng.integers(0, 3, len(X)) * 2.0**-52)


def repeated_column(X, rng):
    X[:, _one(X, rng)] = X[:, _one(X, rng)] * rng.choice([1.0, -1.0, 1e6])


def collinear(X, rng):
    X[:, _one(X, rng)] = X @ rng.normal(size=X.shape[1])


def scales(X, rng):
    X *= 10.0 ** rng.uniform(-12, 12, X.shape[1])


def offset(X, rng):
    X[:, _one(X, rng)] += 10.0 ** rng.uniform(2, 17)


def integers(X, rng):
    X[:, _one(X, rng)] = np.round(3 * X[:, _one(X, rng)])


def steps(X, rng):
    k = _one(X, rng)
    X[:, k] = X[:, k] > np.median(X[:, k])


def outlier(X, rng):
    X[rng.integers(len(X)), _one(X, rng)] *= 10.0 ** rng.uniform(2, 12)


def time(X, rng):
    X[:, _one(X, rng)] = 1.7e9 + 0.02 * np.arange(len(X))


def heavy_tails(X, rng):
    k = _one(X, rng)
    X[:, k] = np.sinh(np.clip(8 * X[:, k], -30, 30))


def the_other(X, rng):
    k = _one(X, rng)
    X[:, k] = -X[:, _one(X, rng)] + 1e-9 * rng.normal(size=len(X))


REGRESSORS = (constant, nearly_constant, repeated_column, collinear, scales, offset, integers, steps, outlier)
REGRESSORS += (time, heavy_tails)
TARGETS = (constant, nearly_constant, repeated_column, the_other, offset, integers, steps, outlier, heavy_tails)


def tiny_or_huge(Y, rng):
    Y /= max(1.0, np.abs(Y).max())
    Y *= 10.0 ** (rng.uniform(-300, 300) if rng.random() < 0.5 else rng.uniform(-30, 30, Y.shape[1]))


def _one(A, rng):
    return rng.integers(A.shape[1])


def table(rng):
    """Return regressors, targets, and the names of what was done to them."""
    n, d, P = (int(rng.integers(*ends)) for ends in ((2, 26), (1, 15 if rng.random() < 0.3 else 5), (1, 4)))
    X = rng.normal(size=(n, d)) if rng.random() < 0.7 else np.cumsum(rng.normal(size=(n, d)), axis=0)
    Y = np.sin(X @ rng.normal(size=(d, P))) + 0.1 * rng.normal(size=(n, P))
    story = []
    for A, ways, most in ((X, REGRESSORS, 4), (Y, TARGETS, 3)):
        for change in rng.choice(np.array(ways, dtype=object), rng.integers(0, most)):
            change(A, rng)
            np.clip(A, -1e150, 1e150, out=A)
            story.append(change.__name__)
    if rng.random() < 0.3:
        tiny_or_huge(Y, rng)
        story.append("tiny_or_huge")
    if rng.random() < 0.2:
        again = rng.integers(0, n, rng.integers(1, n + 1))
        X, Y = np.concatenate([X, X[again]]), np.concatenate([Y, Y[again]])
        story.append("repeated_rows")
    if rng.random() < 0.4:
        Y[rng.random(Y.shape) < rng.uniform(0, 0.8)] = np.nan
        story.append("missing")
    return X, Y[:, 0] if P == 1 and rng.random() < 0.5 else Y, story


def parameters(rng, d):
    """Return parameters of the regressor."""
    chosen = {
        "n_latent": [0, 1, 1, 2, 2, 3],
        "structure": ["average", "average", "joint", "additive"],
        "covariance_type": ["diag", "diag", "spherical", "full", "tied"],
        "trend": ["linear", "linear", "constant", None],
        "inference": ["exact", "exact", "sparse", "sparse", "auto"],
        "optimizer": ["fmin_l_bfgs_b", None],
        "input_noise": [None, None, None, "learned", 0.1],
    }
    options = {name: values[rng.integers(len(values))] for name, values in chosen.items()}
    return options | {"n_inducing": int(rng.integers(1, 13)), "max_iter": int(rng.integers(2, 11)), "random_state": 0}


# -- one case --------------------------------------------------------------------------------------------


def case(_, rng):
    """Return "fitted" or "refused"."""
    X, Y, story = table(rng)
    options = parameters(rng, X.shape[1])
    later = copy.deepcopy(rng)
    try:
        with only(*DOCUMENTED):
            model = DependentGPRegressor(**options)
            _fit(model, X, Y)
            _check(model, X, Y, rng)
    except RuntimeWarning as error:
        raise _told(type(error)(f"{error}; {_consequence(X, Y, options, later)}"), X, Y, story, options).with_traceback(
            error.__traceback__
        ) from None
    except (ValueError, np.linalg.LinAlgError) as error:
        if _says_what_to_do(error):
            return "refused"
        raise _told(error, X, Y, story, options) from None
    except (Exception, Warning) as error:
        raise _told(error, X, Y, story, options) from None
    return "fitted"


def _consequence(X, Y, options, rng):
    """Return what comes of a case whose numbers overflowed, where nobody listens to the warning."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            model = DependentGPRegressor(**options)
            _fit(model, X, Y)
            _check(model, X, Y, rng)
    except Exception as error:
        return f"and then {type(error).__name__}: {error}"
    return "but sound"


def _told(error, X, Y, story, options):
    error.add_note(f"X {X.shape}, Y {Y.shape}, {', '.join(story)}\n{options}")
    return error


def _fit(model, X, Y):
    model.fit(X, Y)


def _says_what_to_do(error):
    """Return whether the package itself refused, or scikit-learn's checks at its door, in more than a few words."""
    frame = traceback.extract_tb(error.__traceback__)[-1].filename
    return ("/skdgp/" in frame or "/sklearn/utils/" in frame) and len(str(error)) > 60


def _check(model, X, Y, rng):
    table = Y.reshape(len(Y), -1)
    used = np.isfinite(table).any(axis=1)
    X, Y, table = X[used], Y[used], table[used]
    spread = np.where(np.ptp(X, axis=0) > 0, X.std(axis=0), 0.0)
    around = X + 0.3 * spread * rng.normal(size=X.shape)
    points = np.concatenate([X, around])
    mean, std = _predictions(model, points)
    near = partial(_near, Y=table, centred=model.trend is not None)
    near(mean[: len(X)])
    prior = _prior(model, points)
    rounding = ROUNDING[model.inference_]
    if not (std <= (1 + rounding) * prior).all():
        raise Difference(f"deviation above the prior's by a factor of {np.nanmax(std / prior):.6g}")
    some = slice(None, None, max(1, len(points) // 5))
    _joint(model, points[some], prior[some], rounding)
    for with_noise in ("include_noise", "include_input_noise"):
        _, more = _predictions(model, points, **{with_noise: True})
        if (more < (1 - rounding) * std).any():
            raise Difference(f"{with_noise} makes a deviation smaller")
    slopes, uncertain = model.predict_gradient(points, return_std=True)
    _finite("slope", slopes)
    _finite("deviation of a slope", uncertain, least=0.0)
    paths = model.sample_paths(3, random_state=0)
    _finite("path", paths(points))
    _finite("slope of a path", paths.gradient(points))
    _finite("sample_y", model.sample_y(points[:4], 2))
    again = pickle.loads(pickle.dumps(model)).predict(points).reshape(mean.shape)
    _same("pickling", model, again, mean, prior)
    if model.inference_ == "sparse":
        _bound(model)
    if rng.random() < 0.3:
        small = model.compact(int(rng.integers(1, 40)), max_iter=2)
        near(_predictions(small, points)[0][: len(X)], what="compact mean")
        if np.isnan(small.compaction_.change):
            raise Difference("compaction's change is not a number")
        _predictions(small.partial_fit(X[:2], Y[:2]), points)
    if model.optimizer is None:
        _unmoved(model, X, Y, points, mean, std, prior, rng)
    if rng.random() < 0.4:
        _online(model, X, Y, points, rng)


def _predictions(model, points, **options):
    """Return mean and deviation, (n, P) each, which are finite."""
    mean, std = (A.reshape(len(points), -1) for A in model.predict(points, return_std=True, **options))
    _finite("mean", mean)
    _finite("deviation", std, least=0.0)
    return mean, std


def _finite(what, values, least=-np.inf):
    if not np.isfinite(values).all():
        raise Difference(f"{what} that is not finite: {np.mean(~np.isfinite(values)):.0%} of them")
    if values.min(initial=np.inf) < least:
        raise Difference(f"{what} below {least:g}: {values.min():g}")


def _near(mean, Y, centred, what="mean"):
    size = np.nanmax(np.abs(Y), axis=0)
    size = np.where(size > 0, size, 1.0)
    scaled = Y / size
    least, most = np.nanmin(scaled, axis=0), np.nanmax(scaled, axis=0)
    if not centred and (most - least < 1e-3).any():
        return  # a process around zero, as wide as the targets vary, cannot know of an offset
    # What is known of a constant target is its size, and that only where each target has a scale of its own.
    own = np.maximum(most - least, np.where(most - least > STILL, 1e-5, 10 / FAR))
    off = np.abs(mean / size - (least + most) / 2) / own
    off = np.where(np.isfinite(Y), off, 0.0).max(axis=0)
    if off.max() > FAR:
        still = " (of a constant one)" if most[off.argmax()] - least[off.argmax()] <= STILL else ""
        raise Difference(f"{what} at a sample is {off.max():.3g} ranges of the targets away{still}")


def _prior(model, points):
    variance = np.stack([model.kernel_.block_diag(i, points) for i in range(len(model.scale_))], axis=1)
    return np.sqrt(variance) * model.scale_


def _joint(model, points, prior, rounding):
    _, cov = model.predict(points, return_cov=True)
    _finite("covariance", cov)
    if prior.min() < 1e-145:
        return  # squares of such deviations are no normal numbers
    unit = prior.T.ravel()
    cov = (cov / unit[:, None]) / unit  # one after the other: squares may underflow
    if np.abs(cov - cov.T).max() > rounding:
        raise Difference(f"covariance is not symmetric, by {np.abs(cov - cov.T).max():.3g} of the prior's variance")
    least = np.linalg.eigvalsh(cov).min()
    if least < -rounding:
        raise Difference(f"covariance has an eigenvalue of {least:.3g} of the prior's variance")
    deviation = model.predict(points, return_std=True)[1].reshape(len(points), -1).T.ravel() / unit
    gap = np.abs(np.diag(cov) - deviation**2).max()
    if gap > rounding:
        raise Difference(f"covariance and deviation differ by {gap:.3g} of the prior's variance")


def _bound(model):
    posterior = model.posterior_
    data = data_from_shares(posterior.shares, len(model.scale_))
    exact = ExactPosterior(posterior.kernel, posterior.noise, data).log_marginal_likelihood
    excess = posterior.log_marginal_likelihood - exact
    if not excess <= 1e-4 * data.n_values + 1e-7 * abs(exact):
        raise Difference(f"bound is above the likelihood by {excess:.3g} nats of {exact:.4g}")


def _same(what, model, got, expected, unit, rounding=0.0):
    """Compare predictions in prior deviations, or in the scale of the targets where that is larger."""
    off = np.abs(got / model.scale_ - expected / model.scale_) / np.maximum(unit / model.scale_, 1.0)
    if not off.max() <= SAME + rounding:
        raise Difference(f"{what} changes predictions by {off.max():.3g} deviations of the prior")


def _unmoved(model, X, Y, points, mean, std, prior, rng):
    """The same data in other units and in another order, the same predictions."""
    times = 2.0 ** rng.integers(-20, 21, X.shape[1] if model.covariance_type != "spherical" else 1)
    varies = np.ptp(X, axis=0) > STILL * np.abs(X).max(axis=0)
    times = np.where(varies, times, 1.0)  # what is constant is measured in its own unit
    up = 2.0 ** int(rng.integers(-20, 21))
    if not 1e-290 < np.nanmax(np.abs(Y)) < 1e290:
        up = 1.0
    noise = model.input_noise
    noise = noise * times * np.ones(X.shape[1]) if isinstance(noise, float) else noise
    size, spread = np.nanmax(np.abs(Y), axis=0), np.nanmax(Y, axis=0) - np.nanmin(Y, axis=0)
    # What is far from zero is rounded to so much of what it varies by.
    far = np.abs(X).max(axis=0) / np.where(varies, X.std(axis=0), np.inf)
    far_targets = size / np.where(spread > STILL * size, spread, np.inf)
    rounding = 1e4 * np.finfo(float).eps * max(far.max(), np.max(far_targets))
    moving = np.atleast_1d(spread > STILL * size)  # the deviation of a constant target has no unit

    def refitted(what, X, Y, points, rows, factor=1.0, shift=0.0, **changed):
        with warnings.catch_warnings():
            warnings.simplefilter("error", JitterWarning)
            try:
                other = DependentGPRegressor(**(model.get_params() | changed)).fit(X[rows], Y[rows])
            except JitterWarning:
                return
        again, uncertain = _predictions(other, points)
        _same(what, model, np.where(moving, (again - shift) / factor, mean), mean, prior, rounding)
        _same(f"{what}, of deviations,", model, np.where(moving, uncertain / factor, std), std, prior, rounding)

    every = slice(None)
    if model.covariance_type != "spherical" or varies.all():  # what is constant shares its scale with no other
        refitted("columns in other units", X * times, Y, points * times, every, input_noise=noise)
    refitted("targets in other units", X, Y * up, points, every, factor=up)
    if model.trend is not None and (spread > 1e-3 * np.max(size)).all():
        shift = float(2 * np.max(size))
        refitted("targets moved", X, Y + shift, points, every, shift=shift)
    still = np.ptp(X, axis=0) == 0
    if still.any():  # the rounded mean of equal numbers may differ from them: at which number a column stood is nothing
        _unmoved_at_zero(model, X, Y, points, still)
    if model.inference_ == "exact" and not hasattr(model.posterior_, "members"):  # weights are by blocks of rows
        refitted("another order of rows", X, Y, points, rng.permutation(len(X)))


def _unmoved_at_zero(model, X, Y, points, still):
    """Columns that stood still may as well have stood at zero."""
    origin = np.where(still, X[0], 0.0)
    other = clone(model).fit(X - origin, Y)
    mean, std = _predictions(model, points)
    again, uncertain = _predictions(other, points - origin)
    prior = _prior(other, points - origin)
    _same("a constant column moved to zero", model, mean, again, prior)
    _same("a constant column moved to zero, of deviations,", model, std, uncertain, prior)


def _online(model, X, Y, points, rng):
    """More samples one after another are as good as all at once."""
    rows = rng.integers(0, len(X), rng.integers(1, 4))
    more, unit = X[rows] + X.std(axis=0) * rng.normal(size=(len(rows), X.shape[1])), model.scale_
    before = model.posterior_
    model.partial_fit(more, Y[rows])
    mean, _ = _predictions(model, points)
    posterior = model.posterior_
    if model.inference_ != "exact" or posterior is before:
        return
    expected = posterior.scaled_noise(np.ones(len(unit))).predict(points) * unit + model.center_
    _same("partial_fit", model, mean, expected, _prior(model, points))


def prepare(folder, seed):
    return None


FITS = Campaign("fits", 2000, 0.5, "fitted", prepare, case)

"""How one likelihood and gradient grows with samples, latent processes and regressors, and what variants cost.

    python tests/benchmarks/growth.py [--out FOLDER]

One thing at a time is varied from 755 samples of six outputs, six shared latents, 15 regressors, diagonal filters.
"""

from functools import partial

from _common import finish, interleaved, parser_of
from likelihood import FLOOR, OURS, Case, lapack_calls, ours, ready

SAMPLES, LATENTS, REGRESSORS = (83, 167, 250, 400, 755, 1000), (1, 2, 6), (4, 8, 15)
VARIANTS = {
    "diagonal filters": {},
    "tied filters": {"covariance_type": "tied"},
    "spherical filters": {"covariance_type": "spherical"},
    "full filters": {"covariance_type": "full"},
    "private latents besides": {"private_latents": True},
    "half of the values missing": {"missing": 0.5},
}
PEERS = ("scikit-learn, each output alone", "GPyTorch LCM, Cholesky", "GPy LCM", "mogptk convolved")


def with_samples(case, samples, names, repeats):
    """Return rows of seconds, a column for each contender; None where it does not fit the memory."""
    rows = []
    for n in samples:
        one = case._replace(n=n)
        found = interleaved(ready(one, names), repeats)
        rows.append(
            {"N": one.N, "over LAPACK": found[OURS] / found[FLOOR], **{name: found.get(name) for name in names}}
        )
    return rows


def ratios(cases, repeats):
    """Return rows of seconds over LAPACK for cases, a dict of name -> (case, keywords of ours)."""
    rows = []
    for name, (case, keywords) in cases.items():
        found = interleaved({FLOOR: lapack_calls(case), OURS: ours(case, **keywords)}, repeats)
        rows.append(
            {"": name, "N": case.N, FLOOR: found[FLOOR], OURS: found[OURS], "ratio": found[OURS] / found[FLOOR]}
        )
    return rows


def main(words=None):
    options = parser_of(__doc__).parse_args(words)
    case = Case(20, 3, 2, 3) if options.smoke else Case()
    measure = partial(ratios, repeats=options.repeats)
    peers = () if options.no_peers else PEERS
    finish(
        options,
        "growth",
        samples=with_samples(case, (10, 20) if options.smoke else SAMPLES, (FLOOR, OURS, *peers), options.repeats),
        latents=measure({f"shared latents: {M}": (case._replace(M=M), {}) for M in LATENTS}),
        regressors=measure({f"regressors: {d}": (case._replace(d=d), {}) for d in REGRESSORS}),
        variants=measure({name: (case, keywords) for name, keywords in VARIANTS.items()}),
    )


if __name__ == "__main__":
    main()

"""Fuzz: damaged logs, ill-conditioned fits and flipped bits of model files, each refused or right.

    python tests/benchmarks/fuzz.py [--seconds 600] [--seed 0] [--jobs 2] [--logs 100000] [--fits 2000] [--flips 5000]
                                    [--data FOLDER] [--out FOLDER]
    python tests/benchmarks/fuzz.py --case fits:123      # one case again, with its traceback

Each campaign runs to its count, or until its part of the time is over; what one leaves is given to those after it.
Cases depend on the seed and their number alone (and on whether --data adds logs of the shared data). The exit code is 1
if any exception was foreign or any difference silent:

- logs: bytes of small logs of each format are changed; ``read_flight`` returns a sound table or raises FlightReadError;
- fits: regressors and targets are ill-conditioned; a fit is refused with what to do, or sound;
- flips: one bit of a model file is flipped; the file is refused, or the model predicts the same bits.
"""

import shutil
import sys
import tempfile
import time
from pathlib import Path

from _common import finish, parser_of
from _fuzz_fits import FITS
from _fuzz_flips import FLIPS
from _fuzz_logs import LOGS
from _fuzzing import rng_of, run
from threadpoolctl import threadpool_limits

CAMPAIGNS = {campaign.name: campaign for campaign in (LOGS, FITS, FLIPS)}
IN_MEMORY = Path("/dev/shm")  # on a disk, to open files takes as long as to read them
SMOKE = {"logs": 60, "fits": 3, "flips": 6}


def main(words=None):
    options = parsed(words)
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
        if options.data:
            shutil.copytree(options.data / "logs", Path(folder) / "real", copy_function=shutil.copyfile)
        if options.case:
            return one(options.case, options.seed, Path(folder))
        rows, failures = all_of(options, Path(folder))
    finish(options, "fuzz", cases=rows, failures=failures)
    return int(bool(failures))


def all_of(options, folder):
    """Return the rows of counts and of failures of all campaigns; each has its part of the time that is left."""
    rows, failures = [], []
    counts = SMOKE if options.smoke else {name: getattr(options, name) for name in CAMPAIGNS}
    left = [campaign for campaign in CAMPAIGNS.values() if counts[campaign.name]]
    ends = time.monotonic() + options.seconds
    for k, campaign in enumerate(left):
        seconds = (ends - time.monotonic()) * campaign.share / sum(each.share for each in left[k:])
        print(f"{campaign.name}: {counts[campaign.name]} cases, at most {seconds:.0f} s", flush=True)
        row, found = run(campaign, options.seed, folder, options.jobs, seconds, counts[campaign.name])
        rows.append(row)
        failures += found
    return rows, failures


def parsed(words):
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="for all campaigns together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes; 0: this one, where nothing stops what hangs")
    parser.add_argument("--data", type=Path, help="folder of the shared data: logs/ are spoiled too")
    parser.add_argument("--case", metavar="CAMPAIGN:NUMBER", help="run this case alone")
    for campaign in CAMPAIGNS.values():
        parser.add_argument(f"--{campaign.name}", type=int, default=campaign.count, help="cases; 0 leaves them out")
    options = parser.parse_args(words)
    if options.smoke:
        options.jobs = 0
    return options


def one(name, seed, folder):
    """Run one case and let its exception through."""
    name, number = name.split(":")
    campaign = CAMPAIGNS[name]
    with threadpool_limits(1):
        print(campaign.case(campaign.prepare(folder, seed), rng_of(campaign, seed, int(number))))
    return 0


if __name__ == "__main__":
    sys.exit(main())

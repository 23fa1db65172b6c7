"""
Identify an aircraft
====================

Learn a model from flight logs, and draw the predicted coefficients of another flight with bands::

    python examples/identify_example_flights.py

Needs matplotlib: pip install "skdgp[plot]". With your own flights:
``identify(["monday.csv", "tuesday.csv"], "uav.json", test="wednesday.csv")``.
"""

import argparse

from matplotlib.figure import Figure

from skdgp.datasets import load_example_flights
from skdgp.identification import identify
from skdgp.plotting import TimeHistoryDisplay


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--samples", type=int, default=250, help="rows to learn from (default: %(default)s)"
    )
    parser.add_argument(
        "--output", default="coefficients.png", help="the picture (default: %(default)s)"
    )
    options = parser.parse_args(arguments)

    flights = load_example_flights()
    result = identify(flights.train, flights.aircraft, test=flights.test, samples=options.samples)
    print(result.summary())

    (flight,) = result.evaluations
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    rows = (flight.time >= 24) & (flight.time <= 34)
    TimeHistoryDisplay.from_predictions(
        flight.time[rows],
        flight.measured[rows],
        flight.mean[rows],
        flight.measured_std[rows],
        ax=figure,
    )
    figure.suptitle("Example flights: coefficients of a flight that the model has not seen")
    figure.savefig(options.output, dpi=150)
    print(options.output)


if __name__ == "__main__":
    main()

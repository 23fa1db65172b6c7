"""
Identify an aircraft
====================

From flight logs to predicted coefficients with honest bands, and a picture of them::

    python examples/identify_example_flights.py

Needs matplotlib: pip install "skdgp[plot]". For your own flights replace ``load_example_flights`` by
``skdgp.io.read_flights(["monday.csv", "tuesday.csv"])`` and ``Aircraft.from_json("uav.json")``.
"""

import argparse

from matplotlib.figure import Figure

from skdgp.datasets import load_example_flights
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import calibrate_noise, make_identification_pipeline, predict_flight
from skdgp.metrics import interval_coverage, normalized_rmse
from skdgp.model_selection import thin_targets
from skdgp.plotting import CoefficientDisplay


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=250, help="rows to learn from (default: %(default)s)")
    parser.add_argument("--output", default="coefficients.png", help="the picture (default: %(default)s)")
    options = parser.parse_args(arguments)

    flights = load_example_flights()
    train, test, aircraft = flights.train, flights.test, flights.aircraft

    measured = aerodynamic_coefficients(train, aircraft)
    learned = thin_targets(measured, options.samples)

    model = make_identification_pipeline(aircraft)
    model.set_params(dependentgpregressor__random_state=0)
    model.fit(train, learned)
    calibrate_noise(model, train, measured.mask(learned.notna()))

    mean, std = predict_flight(model, test, include_noise=True)

    measured = aerodynamic_coefficients(test, aircraft)
    errors = normalized_rmse(measured, mean, multioutput="raw_values")
    inside = interval_coverage(measured, mean, std, multioutput="raw_values")
    for name, error, share in zip(measured, errors, inside, strict=True):
        print(f"{name}: RMSE {error:.3f} of the standard deviation, {100 * share:.0f} % inside the 95 % band")

    figure = Figure(figsize=(10, 6.5), layout="constrained")
    CoefficientDisplay.from_predictions(test["time"], measured, mean, std, ax=figure, time_span=(24, 34))
    figure.suptitle("Example flights: coefficients of a flight that the model has not seen")
    figure.savefig(options.output, dpi=150)
    print(options.output)


if __name__ == "__main__":
    main()

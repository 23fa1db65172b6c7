"""
Fly the model
=============

Simulate a learned aircraft from a state of another flight, with bands of its uncertainty::

    python examples/fly_the_model.py

It learns the example aircraft from two flights and simulates a third from one moment on, with the
surfaces, the throttle and the wind of its log. Then it prints a trim, its modes and derivatives.
Needs matplotlib: pip install "skdgp[plot]".
"""

import argparse

from matplotlib.figure import Figure

from skdgp import make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    aerodynamic_coefficients,
    linearize,
    simulate,
    stability_derivatives,
    trim,
)
from skdgp.plotting import TimeHistoryDisplay

START, SECONDS = 24.0, 10.0


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--samples", type=int, default=None, help="rows to learn from (default: all)"
    )
    parser.add_argument(
        "--paths", type=int, default=60, help="posterior functions to fly (default: %(default)s)"
    )
    parser.add_argument("--output", default="flown.png", help="the picture (default: %(default)s)")
    options = parser.parse_args(arguments)

    flights = load_example_flights()
    train, test, aircraft = flights.train, flights.test, flights.aircraft
    Y = aerodynamic_coefficients(train, aircraft)
    model = make_identification_pipeline(aircraft, samples=options.samples or "all")
    model.set_params(dependentgpregressor__random_state=0)
    model.fit(train, Y)

    # The true flight from START on; of a real flight, what FlightPathReconstruction returns.
    part = test[(test["time"] >= START) & (test["time"] <= START + SECONDS)]
    names = [name.removesuffix("_true") for name in test if name.endswith("_true")]
    flown = part.assign(**{name: part[f"{name}_true"] for name in names})
    wind = flown[["time", "wind_north", "wind_east", "wind_down"]]

    paths = simulate(model, aircraft, flown.iloc[0], flown, air=wind, n_paths=options.paths)
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    columns = ["airspeed", "altitude", "phi", "theta", "p", "q"]
    TimeHistoryDisplay.from_trajectories(paths, flown, columns=columns, ax=figure)
    figure.suptitle(
        "Example aircraft: free flight through gusts from one moment of a flight that the model "
        "has not seen"
    )
    figure.savefig(options.output, dpi=150)
    print(options.output)

    steady = trim(model, aircraft, airspeed=35.0, altitude=200.0)
    print(steady)
    modes = linearize(model, aircraft, steady).modes()
    print(modes[["eigenvalue", "frequency", "damping", "time_constant"]].round(3))
    table = stability_derivatives(model, aircraft, steady)
    rows = ["CL_alpha", "CD_alpha", "CY_beta", "Cl_p", "Cl_aileron", "Cm_alpha", "Cm_q", "Cn_beta"]
    print(table.loc[rows, ["value", "std", "lower", "upper"]].round(3))


if __name__ == "__main__":
    main()

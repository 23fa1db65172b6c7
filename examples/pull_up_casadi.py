"""
Plan a pull-up with CasADi
==========================

Plan a pull-up that keeps its limits for 95 % of the aircraft of the posterior::

    python examples/pull_up_casadi.py

IPOPT chooses the elevator that gains most altitude in 3 s, with angle of attack and load factor
below limits, for the mean of the coefficients. Aircraft drawn from the posterior fly each plan in
six degrees of freedom. Their deviations from it give the margin to the limits of the next plan.

Needs CasADi and matplotlib: pip install "skdgp[export,plot]".
"""

import argparse

import casadi
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Air, aerodynamic_coefficients, simulate, standard_density, trim
from skdgp.export import casadi_function, portable_model
from skdgp.model_selection import thin_targets

GRAVITY = 9.80665
TIME = np.linspace(0.0, 3.0, 31)
STEP = TIME[1]
EFFORT = 1.0  # weight of the squared rate of the elevator [m s/rad^2]
SHARE = 0.97  # of the aircraft that a margin holds: 95 %, and scatter of the draws


def motion_of(model, aircraft, steady, density):
    """Return CasADi's function of state (V, alpha, q, theta, h) and elevator: rates; alpha and load factor."""
    mean = casadi_function(model, mean_only=True)
    x = casadi.MX.sym("x", 5)
    elevator = casadi.MX.sym("elevator")
    V, alpha, q, theta, _ = casadi.vertsplit(x)
    known = {"beta": 0.0, "p_hat": 0.0, "r_hat": 0.0, "airspeed": V, "alpha": alpha}
    known |= steady.controls | {"q_hat": q * aircraft.chord / (2 * V), "elevator": elevator}
    C = mean(casadi.vertcat(*(known[name] for name in model.regressor_names)))
    pressure = 0.5 * density * V**2 * aircraft.wing_area
    # Specific forces and pitching acceleration; the thrust balances them at the trim
    loads = pressure * casadi.vertcat(C[0], C[2], C[4] * aircraft.chord)
    loads /= casadi.vertcat(aircraft.mass, aircraft.mass, aircraft.inertia[1, 1])
    at_trim = casadi.Function("loads", [x, elevator], [loads])
    weight = GRAVITY * casadi.vertcat(-np.sin(steady.theta), np.cos(steady.theta), 0.0)
    start = [steady.airspeed, steady.alpha, 0.0, steady.theta, steady.altitude]
    loads -= at_trim(start, steady.controls["elevator"]) + weight
    ax = loads[0] - GRAVITY * casadi.sin(theta)
    az = loads[1] + GRAVITY * casadi.cos(theta)
    climb = V * casadi.sin(theta - alpha)
    speed = ax * casadi.cos(alpha) + az * casadi.sin(alpha)
    turn = (az * casadi.cos(alpha) - ax * casadi.sin(alpha)) / V + q
    rates = casadi.vertcat(speed, turn, loads[2], q, climb)
    limited = casadi.vertcat(alpha, -loads[1] / GRAVITY)
    return casadi.Function("motion", [x, elevator], [rates, limited]), start


def planned(motion, start, steady, highest, elevator_range):
    """Return the controls of the best plan, and its alpha and load factor (n, 2), below ``highest`` (n, 2)."""
    n = len(TIME)
    problem = casadi.Opti()
    X = problem.variable(5, n)
    U = problem.variable(1, n)
    rates, limited = motion.map(n)(X, U)
    problem.subject_to(X[:, 0] == start)
    problem.subject_to(U[0] == steady.controls["elevator"])
    problem.subject_to(X[:, 1:] - X[:, :-1] == 0.5 * STEP * (rates[:, 1:] + rates[:, :-1]))
    problem.subject_to(casadi.vec(limited) <= highest.ravel())
    problem.subject_to(problem.bounded(elevator_range[0], U, elevator_range[1]))
    effort = EFFORT * casadi.sumsqr(U[1:] - U[:-1]) / STEP
    problem.minimize(effort - (X[4, -1] - start[4]))
    problem.set_initial(X, np.tile(np.array(start)[:, None], n))
    problem.set_initial(U, steady.controls["elevator"])
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    solution = problem.solve()
    controls = pd.DataFrame({"time": TIME} | steady.controls)
    return controls.assign(elevator=solution.value(U)), solution.value(limited).T


def flown(pipeline, aircraft, steady, controls, density, paths, seed):
    """Return alpha and load factor of aircraft drawn from the posterior, (paths, n, 2)."""
    air = Air(gusts=None, drift=False, density=density)
    table = simulate(
        pipeline, aircraft, steady, controls, 0.02, n_paths=paths, air=air, random_state=seed
    )
    values = np.column_stack([table["alpha"], -table["az"] / GRAVITY]).reshape(paths, -1, 2)
    return values[:, :: round(STEP / 0.02)]


def margin(values, mean):
    """Return the margin (n, 2) that holds the deviations of a share of the aircraft at all times."""
    spread = values.std(axis=0)
    spread = np.maximum(spread, 0.1 * spread.max(axis=0))
    worst = ((values - mean) / spread).max(axis=(1, 2))
    return np.quantile(worst, SHARE) * spread


def draw(values, mean, limits, title, axes):
    for k, (ax, unit) in enumerate(zip(axes, (180 / np.pi, 1.0), strict=True)):
        ax.plot(TIME, unit * values[..., k].T, color="0.6", lw=0.4)
        ax.plot(TIME, unit * mean[:, k], color="#0072B2")
        ax.axhline(unit * limits[k], color="#D55E00", ls="--")
    axes[0].set_title(title)
    axes[1].set_xlabel("time [s]")


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Plan a pull-up for 95 % of the aircraft.")
    parser.add_argument("--paths", type=int, default=200, help="aircraft (default: %(default)s)")
    parser.add_argument("--output", default="pull_up.png", help="picture (default: %(default)s)")
    options = parser.parse_args(arguments)

    flights = load_example_flights()
    Y = thin_targets(aerodynamic_coefficients(flights.train, flights.aircraft), 150)
    regressor = DependentGPRegressor(inference="sparse", n_inducing=30, n_latent=1, max_iter=20)
    pipeline = make_identification_pipeline(flights.aircraft, regressor=regressor)
    pipeline.fit(flights.train, Y)
    density = float(standard_density(300.0))
    steady = trim(pipeline, flights.aircraft, 35.0, altitude=300.0, air=Air(density=density))
    model = portable_model(pipeline, flights.aircraft)
    flown_range = dict(zip(model.regressor_names, model.limits.T.tolist(), strict=True))
    limits = np.array([flown_range["alpha"][1], 1.8])
    motion, start = motion_of(model, flights.aircraft, steady, density)

    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey="row")
    kept = np.zeros((len(TIME), 2))
    for number in range(3):
        elevator_range = flown_range["elevator"]
        controls, mean = planned(motion, start, steady, limits - kept, elevator_range)
        fly = pipeline, flights.aircraft, steady, controls, density, options.paths
        # Other aircraft than those of the margin
        values = flown(*fly, seed=1000 + number)
        share = 100 * np.mean((values > limits).any(axis=(1, 2)))
        title = f"plan {number + 1}: {share:.0f} % of aircraft exceed a limit"
        print(title)
        draw(values, mean, limits, title, axes[:, number])
        kept = margin(flown(*fly, seed=number), mean)
    axes[0, 0].set_ylabel("angle of attack [deg]")
    axes[1, 0].set_ylabel("load factor")
    figure.savefig(options.output, dpi=150)
    print(options.output)


if __name__ == "__main__":
    main()

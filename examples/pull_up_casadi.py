"""
Plan a pull-up with CasADi
==========================

Plan a pull-up that keeps its limits for 95 % of the aircraft of the posterior::

    python examples/pull_up_casadi.py

IPOPT chooses the elevator that gains most altitude in 3 s, with angle of attack and load factor
below limits, for the mean of the coefficients. Aircraft drawn from the posterior fly each plan in
six degrees of freedom. Their deviations from it give the margin to the limits of the next plan.

Needs CasADi: pip install "skdgp[export]".
"""

import casadi
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Air, aerodynamic_coefficients, simulate, standard_density, trim
from skdgp.export import casadi_function, portable_model

GRAVITY = 9.80665
TIME = np.linspace(0.0, 3.0, 31)
STEP = TIME[1]


def motion_of(model, aircraft, steady, density):
    """Return CasADi's function of state (V, alpha, q, theta, h) and elevator: rates; alpha and load factor."""
    x = casadi.MX.sym("x", 5)
    elevator = casadi.MX.sym("elevator")
    V, alpha, q, theta, _ = casadi.vertsplit(x)
    known = {"beta": 0.0, "p_hat": 0.0, "r_hat": 0.0, "airspeed": V, "alpha": alpha}
    known |= steady.controls
    known |= {"q_hat": q * aircraft.chord / (2 * V), "elevator": elevator}
    regressors = casadi.vertcat(*[known[name] for name in model.regressor_names])
    CX, _, CZ, _, Cm, _ = casadi.vertsplit(casadi_function(model, mean_only=True)(regressors))
    # Specific forces and pitching acceleration; the thrust balances them at the trim
    force = 0.5 * density * V**2 * aircraft.wing_area
    pitch = force * aircraft.chord / aircraft.inertia[1, 1] * Cm
    loads = casadi.vertcat(force / aircraft.mass * CX, force / aircraft.mass * CZ, pitch)
    start = [steady.airspeed, steady.alpha, 0.0, steady.theta, steady.altitude]
    at_trim = casadi.Function("loads", [x, elevator], [loads])(start, steady.controls["elevator"])
    weight = GRAVITY * casadi.vertcat(-np.sin(steady.theta), np.cos(steady.theta), 0.0)
    fx, fz, q_dot = casadi.vertsplit(loads - at_trim - weight)
    ax = fx - GRAVITY * casadi.sin(theta)
    az = fz + GRAVITY * casadi.cos(theta)
    V_dot = ax * casadi.cos(alpha) + az * casadi.sin(alpha)
    alpha_dot = (az * casadi.cos(alpha) - ax * casadi.sin(alpha)) / V + q
    climb = V * casadi.sin(theta - alpha)
    rates = casadi.vertcat(V_dot, alpha_dot, q_dot, q, climb)
    limited = casadi.vertcat(alpha, -fz / GRAVITY)
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
    effort = casadi.sumsqr(U[1:] - U[:-1]) / STEP  # 1 m of altitude for 1 rad^2/s
    problem.minimize(effort - X[4, -1])
    problem.set_initial(X, np.tile(np.array(start)[:, None], n))
    problem.set_initial(U, steady.controls["elevator"])
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    solution = problem.solve()
    controls = pd.DataFrame({"time": TIME, **steady.controls, "elevator": solution.value(U)})
    return controls, solution.value(limited).T


def flown(pipeline, aircraft, steady, controls, density, paths, seed):
    """Return alpha and load factor of aircraft drawn from the posterior, (paths, n, 2)."""
    air = Air(gusts=None, drift=False, density=density)
    options = {"n_paths": paths, "air": air, "random_state": seed}
    table = simulate(pipeline, aircraft, steady, controls, 0.02, **options)
    values = np.column_stack([table["alpha"], -table["az"] / GRAVITY])
    return values.reshape(paths, -1, 2)[:, :: round(STEP / 0.02)]


def margin(values, mean):
    """Return the margin (n, 2) that holds 97 % of the deviations: 95 %, and the scatter of the draws."""
    spread = values.std(axis=0)
    spread = np.maximum(spread, 0.1 * spread.max(axis=0))
    worst = ((values - mean) / spread).max(axis=(1, 2))
    return np.quantile(worst, 0.97) * spread


def drawn(plans, limits, output):
    """Write a picture of alpha and load factor of each plan, with those of the aircraft that fly it."""
    fig, axes = plt.subplots(2, len(plans), sharex=True, sharey="row", figsize=(10, 5))
    for column, (mean, others, share) in zip(axes.T, plans, strict=True):
        column[0].set_title(f"{share:.0%} exceed a limit")
        for k, (axis, unit) in enumerate(zip(column, (180 / np.pi, 1.0), strict=True)):
            axis.plot(TIME, unit * others[:, :, k].T, color="C0", lw=0.3, alpha=0.4)
            axis.plot(TIME, unit * mean[:, k], color="black")
            axis.axhline(unit * limits[k], color="C3", ls="--")
    axes[0, 0].set_ylabel("angle of attack [deg]")
    axes[1, 0].set_ylabel("load factor")
    axes[1, 1].set_xlabel("time [s]")
    fig.tight_layout()
    fig.savefig(output)


def main(paths=200, samples=150, output="pull_up.png"):
    flights = load_example_flights()
    aircraft = flights.aircraft
    regressor = DependentGPRegressor(inference="sparse", n_inducing=30, n_latent=1, max_iter=20)
    pipeline = make_identification_pipeline(aircraft, regressor=regressor, samples=samples)
    Y = aerodynamic_coefficients(flights.train, aircraft)
    pipeline.fit(flights.train, Y)
    density = float(standard_density(300.0))
    steady = trim(pipeline, aircraft, 35.0, altitude=300.0, air=Air(density=density))
    model = portable_model(pipeline, aircraft)
    ranges = pd.DataFrame(model.limits, columns=model.regressor_names)
    limits = np.array([ranges["alpha"].max(), 1.8])
    motion, start = motion_of(model, aircraft, steady, density)
    kept = np.zeros((len(TIME), 2))
    plans = []
    for number in range(3):
        controls, mean = planned(motion, start, steady, limits - kept, ranges["elevator"].tolist())
        fly = pipeline, aircraft, steady, controls, density, paths
        others = flown(*fly, seed=1000 + number)  # not the aircraft of the margin
        share = np.mean((others > limits).any(axis=(1, 2)))
        print(f"plan {number + 1}: {share:.0%} of aircraft exceed a limit")
        plans.append((mean, others, share))
        kept = margin(flown(*fly, seed=number), mean)
    drawn(plans, limits, output)


if __name__ == "__main__":
    main()

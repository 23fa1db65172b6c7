r"""
Plan a pull-up with CasADi
==========================

Plan a pull-up that keeps its limits for 95 % of the aircraft of the posterior::

    python examples/pull_up_casadi.py
    python examples/pull_up_casadi.py --model results/model.joblib --airspeed 40

IPOPT chooses the elevator that gains most altitude, with angle of attack and load factor below
limits. The first plan uses the mean of the coefficients alone, the second one a margin to the
limits. Both are flown by aircraft drawn from the posterior, in all six degrees of freedom.

**The margin.** Let :math:`e` be the errors of CX, CZ and Cm along a plan. To first order they
change states and limited values by x and y,

.. math:: \dot x = A x + B e, \quad x(0) = 0, \quad y = D x + E e.

A and D are slopes by the states and contain the Jacobian of the model; B and E are slopes by e. The
covariance of e contains errors of the function and noise that lasts, as in the paths of
``simulate``. So e is normal, and :math:`y = G e`. The margin is :math:`c\,|G|`, with c so large that
99 % of all e keep :math:`G e \leq c\,|G|` for both limits at all times. The other 4 % allow for
higher orders, errors of the other coefficients, the reduced model and the time between points. IPOPT
plans with the margin of the last plan until it stays the same.

Needs CasADi and matplotlib: pip install "skdgp[export,plot]".
"""

import argparse
import tempfile
from itertools import pairwise
from time import process_time
from typing import NamedTuple

import casadi
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    Air,
    ThrustLine,
    aerodynamic_coefficients,
    as_aerodynamics,
    propeller_loads,
    simulate,
    standard_density,
    trim,
)
from skdgp.export import export_model, portable_model
from skdgp.identification import load_model
from skdgp.model_selection import thin_targets

GRAVITY = 9.80665
COEFFICIENTS, CHOSEN = ("CX", "CZ", "Cm"), [0, 2, 4]
STEPS = 20
MOST_ROUNDS, SETTLED = (
    10,
    2e-3,
)  # of planning with the last margin; its change over the limit that ends them
SHARE, DRAWS = 0.99, 4000  # of the errors that keep the limits to first order; drawn errors
EFFORT = 1.0  # [m s/rad^2], of the integral of the squared rate of the elevator
BLUE, RED, GREY = "#0072B2", "#D55E00", "0.6"


class Plan(NamedTuple):
    """A planned flight, at the ends and middles of its steps."""

    controls: pd.DataFrame
    values: np.ndarray  # alpha [rad] and load factor, (n, 2)
    margins: np.ndarray  # of the same, (n, 2)
    states: np.ndarray  # airspeed, alpha, q, theta, altitude, (n, 5)
    seconds: list  # of CPU, by IPOPT, of each round

    @property
    def altitude(self):
        return self.states[:, 4]


def joint_covariance(pipeline, n_paths=2000):
    """Return the function of regressors (n, d) that gives the covariance (6 n, 6 n) of paths of the model.

    They are those of `simulate`; all n of the first coefficient come first.
    """
    drawn = as_aerodynamics(pipeline).sample(n_paths, 0)

    def covariance(X):
        values = drawn(np.broadcast_to(X, (n_paths, *X.shape)))
        return np.cov(values.swapaxes(1, 2).reshape(n_paths, -1), rowvar=False)

    return covariance


class PullUp:
    """The longitudinal motion of an aircraft from a trim on, as CasADi functions."""

    def __init__(
        self, model, covariance, aircraft, steady, density, limits, duration=3.0, max_kb=256
    ):
        with tempfile.TemporaryDirectory() as folder:
            export_model(folder, model, "casadi", max_kb=max_kb)
            aero = casadi.Function.load(f"{folder}/aero.casadi")
        self.steady, self.covariance, self.limits = (
            steady,
            covariance,
            np.asarray(limits, dtype=float),
        )
        self.time = np.linspace(0.0, duration, 2 * STEPS + 1)
        self.start = np.array([steady.airspeed, steady.alpha, 0.0, steady.theta, steady.altitude])
        ends = np.arange(0.0, duration + 1e-9, duration / STEPS)
        self.between = np.stack([np.interp(self.time, ends, row) for row in np.eye(STEPS + 1)])
        self.motion, self.slopes = motion_of(aero, model, aircraft, steady, density)
        self.solver = self._solver()

    def _solver(self):
        """Return IPOPT for states at all points and the elevator at the ends of steps (Hermite and Simpson)."""
        n, step = len(self.time), self.time[2]
        X, U = casadi.MX.sym("X", 5, n), casadi.MX.sym("U", 1, STEPS + 1)
        F, Y = self.motion.map(n)(X, U @ casadi.DM(self.between))
        a, m, b = slice(0, n - 2, 2), slice(1, n - 1, 2), slice(2, n, 2)
        middle = X[:, m] - 0.5 * (X[:, a] + X[:, b]) - step / 8 * (F[:, a] - F[:, b])
        end = X[:, b] - X[:, a] - step / 6 * (F[:, a] + 4 * F[:, m] + F[:, b])
        effort = EFFORT * casadi.sumsqr(U[1:] - U[:-1]) / step
        problem = {
            "x": casadi.veccat(X, U),
            "f": effort - (X[4, n - 1] - self.start[4]),
            "g": casadi.veccat(middle, end, Y),
        }
        pushes = (
            "warm_start_bound_push",
            "warm_start_slack_bound_push",
            "warm_start_mult_bound_push",
        )
        options = {"mu_strategy": "adaptive", "warm_start_init_point": "yes", "tol": 1e-6}
        options |= {"print_level": 0, "sb": "yes"}
        options |= dict.fromkeys(pushes, 1e-4)  # a round begins at the plan of the last one
        quiet = {f"ipopt.{name}": value for name, value in options.items()} | {"print_time": False}
        return casadi.nlpsol("pull_up", "ipopt", problem, quiet)

    def plan(self, share, elevator_range):
        """Return the plan whose limits a ``share`` of the aircraft keeps; 0: without a margin."""
        n, at_trim = len(self.time), self.steady.controls["elevator"]
        guess = {"x0": np.concatenate([np.tile(self.start, n), np.full(STEPS + 1, at_trim)])}
        low, high = np.full(guess["x0"].shape, -np.inf), np.full(guess["x0"].shape, np.inf)
        low[5 * n :], high[5 * n :] = elevator_range
        low[[0, 1, 2, 3, 4, 5 * n]] = high[[0, 1, 2, 3, 4, 5 * n]] = [*self.start, at_trim]
        defects, margins, seconds = np.zeros(10 * STEPS), np.zeros((n, 2)), []
        lower = np.concatenate([defects, np.full(2 * n, -np.inf)])
        for _ in range(MOST_ROUNDS):
            upper = np.concatenate([defects, (self.limits - margins).ravel()])
            began = process_time()
            found = self.solver(lbx=low, ubx=high, lbg=lower, ubg=upper, **guess)
            seconds.append(process_time() - began)
            if not self.solver.stats()["success"]:
                raise RuntimeError(
                    f"IPOPT found no plan ({self.solver.stats()['return_status']}): raise the "
                    f"limits."
                )
            guess = {"x0": found["x"], "lam_x0": found["lam_x"], "lam_g0": found["lam_g"]}
            x = np.array(found["x"]).ravel()
            states, elevator = x[: 5 * n].reshape(n, 5), x[5 * n :] @ self.between
            last, margins = margins, self.margins(states, elevator, share) if share else margins
            if np.all(np.abs(margins - last) < SETTLED * self.limits):
                break
        else:
            raise RuntimeError(
                f"The margin still changes after {MOST_ROUNDS} rounds: raise the limits."
            )
        controls = pd.DataFrame({"time": self.time} | self.steady.controls | {"elevator": elevator})
        values = np.array(self.motion.map(n)(states.T, elevator[None])[1]).T
        return Plan(controls, values, margins, states, seconds)

    def margins(self, states, elevator, share):
        """Return c |G| of alpha and load factor at all points, (n, 2)."""
        G = self.effects(states, elevator)
        size = np.linalg.norm(G, axis=2)
        unit = G / np.maximum(size, 1e-12)[..., None]
        drawn = np.random.default_rng(0).standard_normal((G.shape[2], DRAWS))
        return size * np.quantile((unit.reshape(-1, len(drawn)) @ drawn).max(axis=0), share)

    def effects(self, states, elevator):
        """Return G at all points, (n, 2, m), by independent errors of which those of the coefficients consist."""
        n, half, one = len(states), 0.5 * self.time[1], np.eye(5)
        at = [
            [np.array(part) for part in self.slopes(*point)]
            for point in zip(states, elevator, strict=True)
        ]
        covariance = self.covariance(np.hstack([point[0] for point in at]).T).reshape(6, n, 6, n)
        covariance = covariance[CHOSEN][:, :, CHOSEN].reshape(3 * n, 3 * n)
        size, vectors = np.linalg.eigh(covariance)
        errors = (vectors * np.sqrt(np.maximum(size, 0.0))).reshape(3, n, 3 * n).swapaxes(0, 1)
        x = np.zeros((5, 3 * n))
        found = [at[0][4] @ errors[0]]
        for k, ((_, A, B, _, _), (_, A1, B1, D1, E1)) in enumerate(
            pairwise(at)
        ):  # the trapezoidal rule
            x = np.linalg.solve(
                one - half * A1, x + half * (A @ x + B @ errors[k] + B1 @ errors[k + 1])
            )
            found.append(D1 @ x + E1 @ errors[k + 1])
        return np.array(found)


def motion_of(aero, model, aircraft, steady, density):
    """Return functions of states and elevator: rates and limited values; and regressors, A, B, D, E."""
    x, elevator, C = casadi.SX.sym("x", 5), casadi.SX.sym("elevator"), casadi.SX.sym("C", 3)
    V, alpha, q, theta, _ = casadi.vertsplit(x)
    known = {"beta": 0.0, "p_hat": 0.0, "r_hat": 0.0} | steady.controls | {"elevator": elevator}
    known |= {"alpha": alpha, "q_hat": q * aircraft.chord / (2 * V), "airspeed": V}
    regressors = casadi.vertcat(*[known[name] for name in model.regressor_names])
    chosen = [model.outputs.index(name) for name in COEFFICIENTS]
    mean, _, jacobian = (found[chosen, :] for found in aero(regressors))

    scale = 0.5 * density * V**2 * aircraft.wing_area
    thrust = [
        casadi.polyval(casadi.DM(p), V - steady.airspeed)
        for p in thrust_fit(aircraft, steady, density)
    ]
    fx, fz, moment = (
        scale * C[0] + thrust[0],
        scale * C[1] + thrust[1],
        scale * aircraft.chord * C[2] + thrust[2],
    )
    ax = fx / aircraft.mass - GRAVITY * casadi.sin(theta)
    az = fz / aircraft.mass + GRAVITY * casadi.cos(theta)
    rates = casadi.vertcat(
        ax * casadi.cos(alpha) + az * casadi.sin(alpha),
        (az * casadi.cos(alpha) - ax * casadi.sin(alpha)) / V + q,
        moment / aircraft.inertia[1, 1],
        q,
        V * casadi.sin(theta - alpha),
    )
    limited = casadi.vertcat(alpha, -fz / (aircraft.mass * GRAVITY))

    def by_states(f):
        return casadi.jacobian(f, x) + casadi.jacobian(f, C) @ jacobian @ casadi.jacobian(
            regressors, x
        )

    found = [rates, limited]
    for f in (rates, limited):
        found += [by_states(f), casadi.jacobian(f, C)]
    found = casadi.substitute(found, [C], [mean])
    at = [x, elevator]
    return casadi.Function("motion", at, found[:2]), casadi.Function(
        "slopes", at, [regressors, *found[2:]]
    )


def thrust_fit(aircraft, steady, density):
    """Return polynomials of the airspeed beyond that of the trim: forces x and z [N], pitching moment [N m]."""
    speeds = steady.airspeed * np.array([0.7, 1.0, 1.3])
    if aircraft.propeller is None:
        line = aircraft.thrust_line or ThrustLine()
        loads = [line.loads(steady.controls["thrust"])] * 3
    else:
        turning = aircraft.propeller.speed_at(steady.controls["throttle"])
        loads = [propeller_loads(aircraft, turning, V, density) for V in speeds]
    values = np.array([[force[0], force[2], moment[1]] for force, moment in loads])
    return np.polyfit(speeds - steady.airspeed, values, 2).T


def flown(pipeline, aircraft, steady, plan, density, paths, random_state=0):
    """Return alpha and load factor of aircraft drawn from the posterior, (paths, n, 2), and their altitudes."""
    table = simulate(
        pipeline, aircraft, steady, plan.controls, n_paths=paths, air=Air(gusts=None, drift=False, density=density),
        random_state=random_state,
    )  # fmt: skip
    columns = table["alpha"], -table["az"] / GRAVITY, table["altitude"], table["time"]
    alpha, load_factor, altitude, time = (
        column.to_numpy().reshape(paths, -1) for column in columns
    )
    return np.stack([alpha, load_factor], axis=-1), altitude, time[0]


def violated(values, limits):
    """Return the share of the aircraft that exceed a limit at any time, or end early."""
    return float(np.mean(~(values <= limits).all(axis=(1, 2))))


def learned(samples):
    """Return a small model of the example aircraft, learned from the flights of the package."""
    flights = load_example_flights()
    Y = thin_targets(aerodynamic_coefficients(flights.train, flights.aircraft), samples)
    regressor = DependentGPRegressor(
        n_latent=1, inference="sparse", n_inducing=30, max_iter=20, random_state=0
    )
    return make_identification_pipeline(flights.aircraft, regressor=regressor).fit(
        flights.train, Y
    ), flights.aircraft


def draw(figure, plans, flights, limits):
    """Draw the limited values and the altitude of each plan, with the aircraft that fly it."""
    panels = figure.subplots(3, len(plans), sharex=True, sharey="row")
    for (title, plan), (values, altitude, time), column in zip(
        plans.items(), flights, panels.T, strict=True
    ):
        column[0].set_title(
            f"{title}:\n{100 * violated(values, limits):.1f} % of {len(values)} aircraft exceed a "
            f"limit"
        )
        planned = plan.controls["time"]
        for k, (ax, unit) in enumerate(zip(column, (180 / np.pi, 1.0), strict=False)):
            middle, half = unit * plan.values[:, k], unit * plan.margins[:, k]
            ax.plot(time, unit * values[..., k].T, color=GREY, lw=0.4, alpha=0.3)
            ax.plot(planned, middle, color=BLUE, label="plan")
            if half.any():
                ax.plot(
                    planned, np.stack([middle - half, middle + half]).T, color=BLUE, lw=1, ls=":"
                )
            ax.axhline(unit * limits[k], color=RED, ls="--", label="limit")
        column[2].plot(time, altitude.T - plan.altitude[0], color=GREY, lw=0.4, alpha=0.3)
        column[2].plot(planned, plan.altitude - plan.altitude[0], color=BLUE)
        column[2].set_xlabel("time [s]")
    panels[0, 0].plot([], [], color=BLUE, lw=1, ls=":", label="plan and margin")
    panels[0, 0].plot([], [], color=GREY, label="drawn aircraft")
    panels[0, 0].legend(loc="lower right")
    for ax, label in zip(
        panels[:, 0], ("angle of attack [deg]", "load factor", "altitude gained [m]"), strict=True
    ):
        ax.set_ylabel(label)


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--model", help="model.joblib of identify (default: a small model of the example flights)"
    )
    parser.add_argument(
        "--samples", type=int, default=150, help="rows to learn from (default: %(default)s)"
    )
    parser.add_argument(
        "--airspeed", type=float, default=35.0, help="of the trim [m/s] (default: %(default)s)"
    )
    parser.add_argument(
        "--altitude", type=float, default=300.0, help="of the trim [m] (default: %(default)s)"
    )
    parser.add_argument(
        "--load-factor", type=float, default=1.8, help="its limit (default: %(default)s)"
    )
    parser.add_argument(
        "--paths", type=int, default=200, help="posterior aircraft to fly (default: %(default)s)"
    )
    parser.add_argument(
        "--max-kb", type=float, default=256, help="size of the model (default: %(default)s)"
    )
    parser.add_argument(
        "--output", default="pull_up.png", help="the picture (default: %(default)s)"
    )
    options = parser.parse_args(arguments)

    if options.model is None:
        pipeline, aircraft = learned(options.samples)
    else:
        saved = load_model(options.model)
        pipeline, aircraft = saved.pipeline, saved.aircraft
    density = float(standard_density(options.altitude))
    steady = trim(
        pipeline, aircraft, options.airspeed, altitude=options.altitude, air=Air(density=density)
    )
    model = portable_model(pipeline, aircraft)
    flown_range = dict(zip(model.regressor_names, model.limits.T.tolist(), strict=True))
    limits = [
        flown_range["alpha"][1],
        options.load_factor,
    ]  # the largest angle of attack that was flown
    covariance = joint_covariance(pipeline)
    pull_up = PullUp(model, covariance, aircraft, steady, density, limits, max_kb=options.max_kb)

    plans, flights = {}, []
    for title, share in (("the mean alone", 0.0), ("with the margin", SHARE)):
        plan = plans[title] = pull_up.plan(share, flown_range["elevator"])
        flights.append(flown(pipeline, aircraft, steady, plan, density, options.paths))
        exceeding = 100 * violated(flights[-1][0], limits)
        print(
            f"{title}: {plan.altitude[-1] - plan.altitude[0]:.1f} m gained in "
            f"{pull_up.time[-1]:g} s"
        )
        print(f"  IPOPT: {sum(plan.seconds):.2f} s of CPU in {len(plan.seconds)} rounds")
        print(f"  {exceeding:.1f} % of {options.paths} aircraft exceed a limit")
    figure = Figure(figsize=(10, 8), layout="constrained")
    draw(figure, plans, flights, limits)
    figure.suptitle(f"Pull-up of {aircraft.name}: aircraft drawn from the posterior fly two plans")
    figure.savefig(options.output, dpi=150)
    print(options.output)


if __name__ == "__main__":
    main()

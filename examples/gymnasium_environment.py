"""
Train a controller
==================

An environment of Gymnasium (pip install gymnasium): episodes fly aircraft of the posterior.
"""

import argparse

import gymnasium
import matplotlib.pyplot as plt
import numpy as np

from skdgp import make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Simulator, aerodynamic_coefficients, trim

SEEN = ["airspeed", "alpha", "beta", "phi", "theta", "p", "q", "r"]  # m/s, rad, rad/s
SEEN += ["ax", "ay", "az"]  # m/s^2


class AircraftEnv(gymnasium.Env):
    """10 s from a trim, with elevator, aileron and rudder; reward: wings level at its airspeed."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (len(SEEN),), np.float64)
    action_space = gymnasium.spaces.Box(-0.2, 0.2, (3,), np.float64)  # added to the trim [rad]

    def __init__(self, model, aircraft, steady):
        self.simulator = Simulator(model, aircraft)
        self.steady = steady

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        seen = self.simulator.reset(self.steady, random_state=int(self.np_random.integers(2**31)))
        return np.array([seen[name] for name in SEEN]), {}

    def step(self, action):
        held = self.steady.controls
        moved = zip(["elevator", "aileron", "rudder"], map(float, action), strict=True)
        seen = self.simulator.step(held | {name: held[name] + by for name, by in moved})
        off = (seen["airspeed"] - self.steady.airspeed) / 2.0, seen["phi"] / 0.1
        reward = 0.0 if self.simulator.ended else 1.0 / (1.0 + np.dot(off, off))
        values = np.nan_to_num([seen[name] for name in SEEN])
        return values, float(reward), bool(self.simulator.ended), self.simulator.time >= 10.0, {}


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", default="episode.png", help="the picture")
    output = parser.parse_args(arguments).output
    data = load_example_flights()
    model = make_identification_pipeline(data.aircraft)
    model.set_params(dependentgpregressor__structure="trend")
    model.fit(data.train, aerodynamic_coefficients(data.train, data.aircraft))
    env = AircraftEnv(model, data.aircraft, trim(model, data.aircraft, 35.0, altitude=300.0))
    (seen, _), rewards, ends = env.reset(seed=0), [], []
    angles = []
    while not any(ends):  # a proportional controller takes the place of a learning one
        seen, reward, *ends, _ = env.step([0.1 * seen[6], -0.1 * seen[3] - 0.02 * seen[5], 0.0])
        rewards.append(reward)
        angles.append(np.rad2deg(seen[[1, 3, 4]]))
    print(f"{len(rewards)} steps, mean reward {np.mean(rewards):.2f}")
    fig, (above, below) = plt.subplots(2, sharex=True, figsize=(7, 5), layout="constrained")
    time = np.linspace(0.0, env.simulator.time, len(rewards))
    above.plot(time, angles, label=["angle of attack", "roll angle", "pitch angle"])
    above.set_ylabel("[deg]")
    above.legend()
    below.plot(time, rewards)
    below.set(xlabel="time [s]", ylabel="reward", ylim=(0, None))
    fig.savefig(output)


if __name__ == "__main__":
    main()

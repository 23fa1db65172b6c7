"""The environment of the examples: one that Gymnasium accepts, and flies as `simulate` does."""

import numpy as np
import pytest
from flight_columns import FORCES
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.dynamics import Air, simulate, trim

checker = pytest.importorskip(
    "gymnasium.utils.env_checker", reason="runs the example: pip install gymnasium"
)


@pytest.mark.filterwarnings("ignore:.*infinity")  # observations have no limits
def test_an_episode_is_a_flight_of_a_drawn_aircraft(example, fitted):
    environment = example("gymnasium_environment")
    model, uav = fitted("trend").pipeline, fitted("trend").aircraft
    steady = trim(model, uav, 25.0, altitude=200.0)
    env = environment.AircraftEnv(model, uav, steady)
    checker.check_env(env, skip_render_check=True)
    first, _ = env.reset(seed=3)
    seen = np.array([first, *(env.step([0.01, 0.0, 0.0])[0] for _ in range(9))])
    env.reset(seed=3)
    path = int(default_rng(np.random.SeedSequence(3)).integers(2**31))
    held = steady.controls | {"elevator": steady.controls["elevator"] + 0.01}
    calm = Air(gusts=None, drift=False)
    flown = simulate(
        model, uav, steady, lambda time, state: held, 0.02,
        duration=0.18, n_paths=1, air=calm, random_state=path,
    )[environment.SEEN].to_numpy()  # fmt: skip
    states = [name not in FORCES for name in environment.SEEN]
    assert_allclose(seen[:, states], flown[:, states], atol=1e-9)
    # accelerometers show the last stage of a step
    assert_allclose(seen[1:], flown[1:], atol=0.01)

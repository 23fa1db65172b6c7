"""The environment is one of Gymnasium, and flies what `simulate` flies."""

import sys

import numpy as np
import pytest

from skdgp.dynamics import Aerodynamics, Air, FlightComputer, simulate, trim
from skdgp.export import gymnasium_env

gymnasium = pytest.importorskip(
    "gymnasium", reason='makes environments: pip install "skdgp[export]"'
)
env_checker = pytest.importorskip("gymnasium.utils.env_checker", reason="checks environments")
REMARKS = "ignore:.*(we recommend using a symmetric and normalized space|not wrapped|render_modes)"


@pytest.fixture
def start(fitted, uav):
    """Return a trim of a model with a posterior."""
    return trim(fitted("trend"), uav, 25.0, altitude=120.0)


@pytest.fixture
def make(fitted, uav, start):
    """Return a function to an environment."""
    return lambda **options: gymnasium_env(
        fitted("trend"), uav, start, **{"duration": 1.0} | options
    )


def hold(env, start):
    """Return the action that holds the trim."""
    action = np.array([start.controls[name] for name in start.solved if name in start.controls])
    assert env.action_space.contains(action)
    return action


@pytest.mark.filterwarnings(REMARKS)
@pytest.mark.parametrize(
    "options", [{}, {"posterior": False, "wind_at_6m": 7.0, "initial_std": {"phi": 0.1}}]
)
def test_the_checker_of_gymnasium_passes(make, options):
    spec = gymnasium.envs.registration.EnvSpec("Aircraft-v0", entry_point=lambda: make(**options))
    env_checker.check_env(gymnasium.make(spec, disable_env_checker=True).unwrapped)


def test_an_episode_is_a_flight_of_simulate(make, fitted, uav, start):
    env = make()
    _, begun = env.reset(seed=5)
    low, high = env.action_space.low, env.action_space.high
    names = [name for name in start.solved if name in start.controls]
    rng = np.random.default_rng(0)
    actions = hold(env, start) + 0.02 * (high - low) * rng.uniform(-1, 1, (20, len(low)))
    seen = [env.step(action)[0] for action in actions]

    def law(t, state):
        return start.controls | dict(zip(names, actions[min(round(t / 0.02), 19)], strict=True))

    flown = simulate(
        fitted("trend"), uav, start, FlightComputer(law), duration=0.4, n_paths=1, air=Air(gusts=None, drift=False),
        random_state=begun["random_state"],
    )  # fmt: skip
    channels = ["airspeed", "alpha", "beta", "phi", "theta", "psi", "p", "q", "r", "altitude"]
    np.testing.assert_allclose(seen, flown[channels].to_numpy()[1:], atol=1e-9)


def test_equal_seeds_give_equal_episodes_and_others_do_not(make, start):
    env = make(wind_at_6m=5.0, initial_std={"alpha": 0.01})
    action = hold(env, start)

    def episode(seed):
        return np.array([env.reset(seed=seed)[0], *(env.step(action)[0] for _ in range(5))])

    one, other, again = (episode(seed) for seed in (0, 1, 0))
    np.testing.assert_allclose(one, again, rtol=1e-9, atol=1e-10)
    assert (one[-1] != other[-1]).all()
    following = env.reset()[1]["random_state"]
    assert following != env.reset(seed=0)[1]["random_state"]


def test_the_trim_of_the_mean_is_kept_and_rewarded_until_time_is_up(make, start):
    env = make(posterior=False, duration=0.2)
    first, info = env.reset()
    assert info["random_state"] is None
    for step in range(10):
        observation, reward, terminated, truncated, _ = env.step(hold(env, start))
        np.testing.assert_allclose(observation, first, atol=1e-6)
        assert reward == pytest.approx(1.0)
        assert not terminated
        assert truncated == (step == 9)


@pytest.mark.parametrize(
    ("what", "low", "high"), [("altitude", 119.9, 200.0), ("alpha", -1.0, 0.2)]
)
def test_an_episode_ends_outside_of_the_observation_space(make, what, low, high):
    rewarded = []

    def reward(seen, controls):
        rewarded.append((seen["ended"], controls["elevator"]))
        return -1.0 if seen["ended"] else 0.5

    env = make(posterior=False, limits={what: (low, high)}, reward=reward, duration=5.0)
    env.reset(seed=0)
    action = (env.action_space.high if what == "altitude" else env.action_space.low).copy()
    action[1:3] = 0.0
    for _ in range(250):
        observation, value, terminated, _, info = env.step(action)
        if terminated:
            break
    assert info["ended"] == what
    assert not low <= info[what] <= high
    assert env.observation_space.contains(observation)
    assert value == -1.0
    assert rewarded[0] == ("", action[0])


def test_a_flight_that_diverges_ends_with_what_was_last_seen(uav, start):
    lost = Aerodynamics(lambda X: np.where(X[:, :1] > 0, np.inf, 0.0) * np.ones(6), ["elevator"])
    env = gymnasium_env(lost, uav, start, posterior=False)
    first, _ = env.reset()
    action = env.action_space.high
    observation, _, terminated, _, info = env.step(action)
    assert terminated
    assert info["ended"] == "diverged"
    np.testing.assert_array_equal(observation, first)


def test_spaces_have_the_range_that_the_model_was_learned_from(uav, start):
    limits = np.array([[-0.1, -0.4, -0.3, 20.0], [0.2, 0.4, 0.1, 30.0]])
    model = Aerodynamics(
        lambda X: np.zeros((len(X), 6)), ["alpha", "elevator", "rudder", "airspeed"], limits=limits
    )
    env = gymnasium_env(model, uav, start, limits={"rudder": (-0.2, 0.2)})
    names = [name for name in start.solved if name in start.controls]
    space = dict(
        zip(names, zip(env.action_space.low, env.action_space.high, strict=True), strict=True)
    )
    assert (env.observation_space.low[1], env.observation_space.high[1]) == (-0.1, 0.2)
    assert env.observation_space.low[0] == pytest.approx(25 / 2**0.5)
    assert space["elevator"] == (-0.4, 0.4)
    assert space["rudder"] == (-0.2, 0.2)
    assert space["thrust"] == (0.0, pytest.approx(2 * start.controls["thrust"]))


def test_an_action_is_a_number_for_each_control(make, start):
    env = make(posterior=False)
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        env.step(hold(env, start))
    env.reset(seed=0)
    for action in (hold(env, start) * np.nan, hold(env, start)[1:], 0.0):
        with pytest.raises(
            ValueError, match=r"Got the action .* a number for each of elevator, aileron, rudder"
        ):
            env.step(action)
    assert env.step(np.full(len(hold(env, start)), np.inf))[1] < 1.0, "clipped to the space"


def test_what_cannot_be_flown_is_refused(make, fitted, uav):
    with pytest.raises(
        ValueError,
        match=r"not within its limits, .*'altitude': \(120.0, 120, 300\).*choose another",
    ):
        make(limits={"altitude": (120, 300)})
    with pytest.raises(ValueError, match="speed"):
        make(limits={"speed": (10, 30)})
    with pytest.raises(ValueError, match="duration=0, but expected at least one step"):
        make(duration=0)
    with pytest.raises(ValueError, match="height"):
        make(initial_std={"height": 1.0})


def test_gymnasium_is_named_where_it_is_not_installed(make, monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ImportError, match=r'pip install "skdgp\[export\]"'):
        make()

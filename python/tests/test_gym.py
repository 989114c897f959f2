"""Gymnasium environments."""

import functools
import os
import subprocess
import sys
import time
import warnings

import numpy as np
import physgrad as pg
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402

slow = pytest.mark.skipif(
    os.environ.get("PHYSGRAD_PYTHON_ALL") != "1", reason="measures times; set PHYSGRAD_PYTHON_ALL=1"
)


@pytest.fixture(autouse=True)
def warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Observations of tasks have no bounds.
        warnings.filterwarnings("ignore", ".*Box observation space m.*imum value is -?infinity")
        yield


@pytest.mark.parametrize("name", sorted({*pg._core.task_names(), *pg.presets()}))
def test_all_tasks_and_presets_pass_the_checks(name):
    assert pg.gym, "the import registers the environments"
    check_env(gymnasium.make(f"physgrad/{name}-v0").unwrapped)


def test_the_checks_of_stable_baselines3_pass():
    checks = pytest.importorskip("stable_baselines3.common.env_checker", reason="stable-baselines3 is not installed")
    checks.check_env(pg.gym.make("cart_pole", poles=1))


def rewards(env, seed, controls):
    env.reset(seed=seed)
    starts = env.unwrapped.state, env.unwrapped.params
    steps = [env.step(action) for action in controls]
    return starts, np.array([step[1] for step in steps]), steps


@pytest.mark.parametrize("settings", [{"poles": 1}, {"poles": 2, "loss": {"mode": "running"}, "effects": {"gusty_wind": {}}}])
def test_the_return_is_minus_the_loss(settings):
    env = pg.gym.make("cart_pole", bound=5.0, settings={"precision": "f64"}, **settings)
    task = env.task
    actions = np.random.default_rng(0).uniform(-1, 1, (task.horizon, 1))
    (x, p), found, steps = rewards(env, 3, actions)
    x, p, loss = x[None], p[None], 0.0
    for t, action in enumerate(actions):
        next = task.step(x, 5.0 * action[None], p=p, t=t)
        loss += task.running_cost(x, 5.0 * action[None], next, p=p, t=t)[0]
        x = next
    loss += task.terminal_cost(x, p=p)[0]
    assert found.sum() == pytest.approx(-loss, rel=1e-12)
    assert [step[2] for step in steps] == [False] * task.horizon
    assert [step[3] for step in steps] == [False] * (task.horizon - 1) + [True]
    assert np.array_equal(env.state, x[0])
    with pytest.raises(RuntimeError, match="Call `reset`"):
        env.step(actions[0])


def test_actions_are_clipped_and_scaled():
    results = []
    for bound, action in [(10.0, 0.5), (5.0, 1.0), (5.0, 7.0)]:
        env = pg.gym.make("cart_pole", poles=1, bound=bound)
        env.reset(seed=0)
        results.append(env.step(np.array([action], np.float32))[0])
    assert np.array_equal(results[0], results[1]) and np.array_equal(results[1], results[2])


def test_bounds_come_from_the_argument_the_actuator_or_the_task():
    assert pg.task("guidance").control_bounds == [(-5.0, 5.0)] * pg.task("guidance").control_dim
    assert pg.gym.make("cart_pole").low == -60.0
    assert pg.gym.make("cart_pole").high == 60.0
    limited = {"settings": {"actuator.limit.bound": 7.0}}
    assert pg.gym.make("cart_pole", **limited).high == 7.0
    assert pg.gym.make("cart_pole", bound=3.0, **limited).high == 3.0
    assert gymnasium.make("physgrad/cart_pole-v0", bound=3.0, poles=3).unwrapped.high == 3.0
    for bound in [-1.0, 0.0, [1.0, 2.0], np.inf]:
        with pytest.raises(ValueError, match="`bound`"):
            pg.gym.make("cart_pole", bound=bound)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_environments_equal_rollouts_of_the_task(mode):
    task = pg.task("cart_pole", poles=1, horizon=4, loss={"mode": "running"})
    envs = pg.gym.TaskVectorEnv(task, 3, 5.0, mode)
    y, _ = envs.reset(seed=1)
    assert y in envs.observation_space and envs.metadata["autoreset_mode"] == mode
    rng = np.random.default_rng(0)
    for count in range(1, 10):
        before, actions = envs.state, rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        ends = count % 5 == 4 if mode == AutoresetMode.NEXT_STEP else count % 4 == 0
        resets = count % 5 == 0 if mode == AutoresetMode.NEXT_STEP else ends
        y, reward, terminated, truncated, info = envs.step(actions)
        assert y in envs.observation_space and not terminated.any()
        assert truncated.all() == truncated.any() == ends
        expected = task.step(before, 5.0 * actions)
        if mode == AutoresetMode.NEXT_STEP and resets:
            assert not reward.any()
        else:
            final = np.stack(info["final_obs"]) if mode == AutoresetMode.SAME_STEP and resets else y
            assert np.array_equal(final, task.observe(expected))
        if resets and mode == AutoresetMode.DISABLED:
            with pytest.raises(RuntimeError, match="Call `reset`"):
                envs.step(actions)
            envs.reset(options={"reset_mask": np.ones(3, bool)})


def test_partial_resets_keep_other_environments():
    task = pg.task("cart_pole", poles=1, horizon=4, effects={"gusty_wind": {}})
    envs = pg.gym.TaskVectorEnv(task, 3, 5.0, AutoresetMode.DISABLED)
    envs.reset(seed=1)
    actions = np.zeros((3, 1), np.float32)
    envs.step(actions)
    before = envs.state
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert np.array_equal(envs.state[[0, 2]], before[[0, 2]]) and not np.array_equal(envs.state[1], before[1])
    # Environments are now at different steps.
    ends = [envs.step(actions)[3] for _ in range(3)][-1]
    assert ends.tolist() == [True, False, True]


@pytest.mark.parametrize(
    "mask, error, message",
    [
        (np.array([0, 1, 0]), TypeError, "`reset_mask` is an array of int64; expected an array of bool"),
        (np.array([0.0, 1.0, 0.0]), TypeError, "an array of float64"),
        ([False, True, False], TypeError, "of type list"),
        (1, TypeError, "of type int"),
        (None, TypeError, "of type NoneType"),
        (np.array([True, False]), ValueError, r"the shape \(2,\); expected \(3,\)"),
        (np.ones((3, 1), bool), ValueError, r"the shape \(3, 1\)"),
        (np.zeros(3, bool), ValueError, "selects no environment"),
        (np.ma.masked_array([False, True, False], [True, False, False]), ValueError, "`reset_mask` is a masked array"),
    ],
)
def test_masks_of_another_type_or_shape_are_refused(mask, error, message):
    envs = pg.gym.make_vec("cart_pole", 3, poles=1)
    envs.reset(seed=1)
    before = envs.state
    with pytest.raises(error, match=message):
        envs.reset(options={"reset_mask": mask})
    assert np.array_equal(envs.state, before)


def test_episodes_begin_at_given_states_and_other_options_are_refused():
    settings = {"poles": 1, "effects": {"gusty_wind": {}}}
    env, envs = pg.gym.make("cart_pole", **settings), pg.gym.make_vec("cart_pole", 3, **settings)
    x, p = np.array([0.1, -0.2, 3.0, 0.4], np.float32), np.full(env.task.param_dim, 0.5, np.float32)
    y, _ = env.reset(seed=0, options={"state": x, "params": p})
    assert np.array_equal(env.state, x) and np.array_equal(env.params, p)
    assert np.array_equal(y, env.task.observe(x[None], p=p[None])[0])
    env.reset(seed=0, options={"state": x.tolist()})
    drawn = env.params
    env.reset(seed=0)
    assert np.array_equal(env.params, drawn) and not np.array_equal(env.state, x)
    envs.reset(seed=0)
    before, mask = envs.state, np.array([False, True, True])
    envs.reset(options={"reset_mask": mask, "state": np.stack([x, 2 * x, 3 * x])})
    assert np.array_equal(envs.state, np.stack([before[0], 2 * x, 3 * x]))
    for options, error, message in [
        ({"sate": x}, ValueError, "`options` has 'sate'; allowed: "),
        ({"state": x[:3]}, ValueError, "`state` has the shape"),
        ({"state": x * np.nan}, ValueError, "`state` is not finite"),
        ({"state": np.array(["a"] * 4)}, TypeError, "`state` is an array of"),
    ]:
        with pytest.raises(error, match=message):
            env.reset(options=options)
        with pytest.raises(error, match=message):
            envs.reset(options={name: np.stack([value] * 3) for name, value in options.items()})
    for count in (0, -1):
        with pytest.raises(ValueError, match="`num_envs` is"):
            pg.gym.make_vec("cart_pole", count)


def test_states_of_an_environment_refuse_assignments():
    env, envs = pg.gym.make("cart_pole", poles=1), pg.gym.make_vec("cart_pole", 2, poles=1)
    env.reset(seed=0), envs.reset(seed=0)
    for array in (env.state, env.params, envs.state, envs.params):
        with pytest.raises(ValueError, match="read-only"):
            array[..., 0:1] = 5.0
    for environment in (env, envs):
        with pytest.raises(ValueError, match="read-only"):
            environment.high[0] = 1.0
        for name in ("task", "low", "high", "state", "params"):
            with pytest.raises(AttributeError):
                setattr(environment, name, getattr(environment, name))


def test_equal_seeds_give_equal_episodes():
    made = [gymnasium.make_vec("physgrad/guidance-v0", 5) for _ in range(2)]
    first = [envs.reset(seed=4)[0] for envs in made]
    assert np.array_equal(*first)
    assert not np.array_equal(first[0], made[0].reset()[0])
    assert np.array_equal(made[0].reset(seed=4)[0], first[0])


def test_states_that_are_not_finite_are_named():
    env = pg.gym.make("cart_pole", poles=1, bound=1e308, settings={"precision": "f64"})
    env.reset(seed=0)
    with pytest.raises(FloatingPointError, match="environment 0, step .*: `.*` is not finite. Use a smaller `bound`"):
        for _ in range(100):
            env.step(np.ones(1, np.float32))


def test_masked_arrays_are_refused():
    env, envs = pg.gym.make("cart_pole", poles=1), pg.gym.make_vec("cart_pole", 2, poles=1)
    env.reset(seed=0)
    envs.reset(seed=0)
    before = env.state, envs.state
    state, action = np.ma.masked_array(np.zeros(4), [True] + [False] * 3), np.ma.masked_array([0.5], [True])
    for call, name in [
        (lambda: env.reset(options={"state": state}), "state"),
        (lambda: envs.reset(options={"state": [state, state]}), "state"),
        (lambda: env.step(action), "action"),
        (lambda: envs.step([action, action]), "actions"),
        (lambda: pg.gym.make("cart_pole", poles=1, bound=action), "bound"),
    ]:
        with pytest.raises(ValueError, match=f"`{name}` is a masked array"):
            call()
    assert np.array_equal(env.state, before[0]) and np.array_equal(envs.state, before[1])


def test_parameters_out_of_their_range_are_refused_at_the_reset():
    settings = {"poles": 1, "pole_mass": {"uniform": [0.1, 0.2]}}
    env, envs = pg.gym.make("cart_pole", **settings), pg.gym.make_vec("cart_pole", 2, **settings)
    env.reset(seed=0)
    envs.reset(seed=0)
    before = env.state, env.params, envs.params
    for value in (0.0, -0.2):
        with pytest.raises(ValueError, match="`system.pole_mass` is .*; allowed: a positive number"):
            env.reset(options={"params": [value]})
        with pytest.raises(ValueError, match="`system.pole_mass` is .*; allowed: a positive number"):
            envs.reset(options={"params": [[0.1], [value]]})
    assert all(map(np.array_equal, (env.state, env.params, envs.params), before))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_step_before_the_first_reset_is_refused(mode):
    envs = pg.gym.TaskVectorEnv(pg.task("cart_pole", poles=1), 2, 5.0, mode)
    with pytest.raises(RuntimeError, match=r"environments \[0 1\]: the episode has not begun. Call `reset` first"):
        envs.step(np.zeros((2, 1), np.float32))
    envs.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(RuntimeError, match=r"environments \[1\]: the episode has not begun"):
        envs.step(np.zeros((2, 1), np.float32))


def test_actions_that_are_not_finite_are_refused():
    env = pg.gym.make("cart_pole", poles=1)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="environment 0: the action is not finite"):
        env.step(np.full(1, np.nan, np.float32))


def test_an_error_in_one_environment_leaves_all_at_their_steps():
    env = pg.gym.make_vec("cart_pole", 2, poles=1, bound=1e308, settings={"precision": "f64"})
    env.reset(seed=0)
    env.step(np.zeros((2, 1), np.float32))
    env.reset(options={"reset_mask": np.array([True, False])})
    before = env._rows.x.copy(), env._rows.t.copy()
    assert before[1].tolist() == [0, 1]
    with pytest.raises(FloatingPointError, match="environment 1"):
        for _ in range(100):
            before = env._rows.x.copy(), env._rows.t.copy()
            env.step(np.array([[0.0], [1.0]], np.float32))
    assert np.array_equal(env._rows.x, before[0]) and np.array_equal(env._rows.t, before[1])


def test_ids_need_no_import_with_the_name_of_the_module():
    program = (
        "import gymnasium; env = gymnasium.make('physgrad.gym:physgrad/cart_pole-v0', poles=1); "
        "env.reset(seed=0); "
        "print(env.unwrapped.task.name, gymnasium.make_vec('physgrad.gym:physgrad/guidance-v0', 2).num_envs)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert ran.stdout == "cart_pole 2\n", ran.stderr


def test_environments_in_processes_of_gymnasium_are_those_of_one_process():
    # A process of the tests may have threads of JAX, beside which a fork may wait forever.
    task = pg.task("cart_pole", poles=1, horizon=4, effects={"gusty_wind": {}})
    makers = [functools.partial(pg.gym.make, task, bound=bound) for bound in (5.0, 20.0)]
    envs = gymnasium.vector.AsyncVectorEnv(makers, context="spawn")
    own = gymnasium.vector.SyncVectorEnv(makers)
    try:
        np.testing.assert_array_equal(envs.reset(seed=7)[0], own.reset(seed=7)[0])
        rng = np.random.default_rng(0)
        for _ in range(10):
            actions = rng.uniform(-1, 1, (2, 1)).astype(np.float32)
            found, expected = envs.step(actions), own.step(actions)
            for a, b in zip(found[:4], expected[:4], strict=True):
                np.testing.assert_array_equal(a, b)
        assert envs.get_attr("task") == (task, task)
    finally:
        envs.close()


def length(env):
    """Number of steps of an episode, and the last reward."""
    env.reset(seed=0)
    zero = np.zeros(env.action_space.shape, np.float32)
    for count in range(1, 1000):
        _, reward, _, truncated, _ = env.step(zero)
        if np.all(truncated):
            return count, np.ravel(reward)[0]


def test_the_number_of_steps_is_a_setting_with_two_names():
    id, made = "physgrad/cart_pole-v0", pg.gym.make("cart_pole", horizon=7)
    # The last reward contains the terminal cost.
    assert length(made) == length(pg.gym.make("cart_pole", max_episode_steps=7)) and length(made)[0] == 7
    assert length(made)[1] < 0
    assert length(pg.gym.make_vec("cart_pole", 2, max_episode_steps=7))[0] == 7
    assert length(gymnasium.make_vec(id, 2, max_episode_steps=7))[0] == 7
    assert length(gymnasium.make(id, horizon=7)) == length(made)
    # Longer than the preset too.
    assert length(gymnasium.make(id, horizon=150))[0] == 150
    # The wrapper of Gymnasium only ends the episode.
    assert length(gymnasium.make(id, max_episode_steps=7)) == (7, 0.0)
    with pytest.raises(ValueError, match="`max_episode_steps` is 7, but `horizon` is 8; use one of them"):
        pg.gym.make("cart_pole", max_episode_steps=7, horizon=8)
    for spec in (gymnasium.make(id, horizon=7).spec, gymnasium.make_vec(id, 2, horizon=7).unwrapped.spec):
        assert spec.max_episode_steps == 7
    again = gymnasium.make(gymnasium.make(id, horizon=7).spec)
    assert length(again) == length(made)


def test_environments_with_a_list_of_seeds_are_single_environments_with_these_seeds():
    settings = {"poles": 1, "horizon": 3, "effects": {"gusty_wind": {}}}
    envs = pg.gym.make_vec("cart_pole", 3, **settings)
    y, _ = envs.reset(seed=[4, 5, 6])
    singles = [pg.gym.make("cart_pole", **settings) for _ in range(3)]
    np.testing.assert_array_equal(y, [env.reset(seed=seed)[0] for env, seed in zip(singles, [4, 5, 6])])
    rng = np.random.default_rng(0)
    for count in range(1, 10):
        actions = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        y, reward, _, truncated, _ = envs.step(actions)
        if count % 4 == 0:
            expected = [env.reset()[0] for env in singles]
        else:
            steps = [env.step(action) for env, action in zip(singles, actions)]
            expected = [step[0] for step in steps]
            np.testing.assert_array_equal(reward, [step[1] for step in steps])
            assert truncated.tolist() == [step[3] for step in steps]
        np.testing.assert_array_equal(y, expected)
    # None, and seeds outside of the mask, leave the generators; one number seeds all.
    envs.reset(seed=[4, 5, 6])
    y, _ = envs.reset(seed=[4, 4, None], options={"reset_mask": np.array([True, False, True])})
    second = pg.gym.make("cart_pole", **settings)
    second.reset(seed=6)
    np.testing.assert_array_equal(y, [*envs.reset(seed=[4, 5, 0])[0][:2], second.reset()[0]])
    first = envs.reset(seed=3)[0]
    np.testing.assert_array_equal(pg.gym.make_vec("cart_pole", 3, **settings).reset(seed=3)[0], first)
    with pytest.raises(ValueError, match="`seed` has 2 numbers; expected one, or one for each of 3 env"):
        envs.reset(seed=[1, 2])


def test_observations_have_the_time_of_their_step():
    task = pg.system(
        lambda x, u: [u.force], states=["speed"], controls={"force": (-1, 1)}, dt=0.1, horizon=4,
        observe=lambda x, t: [x.speed, t], running_cost=lambda x, u, next: next.speed**2,
    )  # fmt: skip
    env, envs = pg.gym.make(task), pg.gym.make_vec(task, 2)
    ys = [env.reset(seed=0)[0]] + [env.step(np.ones(1, np.float32))[0] for _ in range(task.horizon)]
    np.testing.assert_allclose([y[1] for y in ys], 0.1 * np.arange(5), rtol=1e-6)
    envs.reset(seed=0)
    envs.step(np.ones((2, 1), np.float32))
    # At different steps.
    envs.reset(options={"reset_mask": np.array([True, False])})
    y = envs.step(np.ones((2, 1), np.float32))[0]
    np.testing.assert_allclose(y[:, 1], [0.1, 0.2], rtol=1e-6)


def noisy():
    """A cart that is pushed at random, and a sensor with noise."""
    return pg.system(
        lambda x, u, p: [x.speed, u.force + p.gust],
        states=["position", "speed"],
        controls={"force": (-5, 5)},
        params={"gust": pg.noise(0.5), "encoder": pg.noise(0.05)},
        observe=lambda x, p: [x.position + p.encoder, x.speed],
        running_cost=lambda x, u, next: next.position**2,
        dt=0.1,
        horizon=6,
    )


def test_the_key_of_the_noise_is_an_option():
    task = noisy()
    env, envs = pg.gym.make(task), pg.gym.make_vec(task, 2)

    def episode(key):
        y, _ = env.reset(seed=1, options={} if key is None else {"key": key})
        return env.key, [y] + [env.step(np.zeros(1, np.float32))[0] for _ in range(task.horizon)]

    drawn, first = episode(None)
    assert episode(drawn)[0] == drawn
    np.testing.assert_array_equal(episode(drawn)[1], first)
    assert episode(np.int64(5))[0] == 5 and not np.array_equal(episode(5)[1], first)
    # The noise of a rollout with this key.
    starts = np.array([[0.0, 0.0, 0.0, 0.0, drawn]], np.float32)
    x = np.zeros((1, 2), np.float32)
    for t, y in enumerate(first[:-1]):
        p = task.params_at(starts, t)
        np.testing.assert_array_equal(task.observe(x, p=p, t=t)[0], y)
        x = task.step(x, np.zeros((1, 1), np.float32), p=p, t=t)
    envs.reset(seed=0, options={"key": [drawn, 5]})
    assert envs.key.tolist() == [drawn, 5]
    ys = [envs.step(np.zeros((2, 1), np.float32))[0] for _ in range(task.horizon)]
    np.testing.assert_array_equal([y[0] for y in ys], first[1:])
    for key in (-1, 2**24, 0.5, np.nan):
        with pytest.raises(ValueError, match="`key` is .*; allowed: a whole number from 0 to 16777215"):
            env.reset(options={"key": key})
        with pytest.raises(ValueError, match="`key` is .*; allowed: a whole number"):
            envs.reset(options={"key": [1, key]})
    with pytest.raises(ValueError, match="`key` has the shape"):
        env.reset(options={"key": [1]})
    assert pg.gym.make("cart_pole").key is None
    with pytest.raises(ValueError, match="the task cart_pole has no noise"):
        pg.gym.make("cart_pole").reset(options={"key": 1})


@pytest.mark.parametrize("name", sorted(pg._core.task_names()))
def test_pictures_of_all_tasks(name):
    env = pg.gym.make(name, render_mode="rgb_array")
    shapes = set()
    for seed in range(2):
        env.reset(seed=seed)
        before = env.render()
        for count in range(1, env.task.horizon + 1):
            env.step(env.action_space.sample())
            if count in (7, env.task.horizon):
                picture = env.render()
                shapes |= {before.shape, picture.shape}
                assert picture.dtype == np.uint8 and not np.array_equal(picture, before)
                assert np.array_equal(env.render(), picture)
                # Between a hundredth and half of the pixels are not white, but in dark maps more.
                assert 0.002 < (picture < 255).any(axis=2).mean() < (0.5 if name != "quantum" else 0.8)
                before = picture
    [(height, width, colours)] = shapes
    assert height % 2 == width % 2 == 0 and colours == 3


@pytest.mark.parametrize("name", ["cart_pole", "guidance", "pole_chain"])
def test_a_picture_depends_on_the_episode_alone(name):
    env = pg.gym.make(name, render_mode="rgb_array")
    size = env.action_space.shape

    def pictures(each):
        env.reset(seed=5)
        found = [env.render()]
        for action in np.linspace(-1, 1, 20):
            env.step(np.full(size, action, np.float32))
            found += [env.render()] if each else []
        return found[-1] if each else env.render()

    first = pictures(each=True)
    assert np.array_equal(pictures(each=False), first), "skipped pictures change nothing"
    env.reset(seed=6)
    for _ in range(env.task.horizon):
        env.step(np.ones(size, np.float32))
        env.render()
    assert np.array_equal(pictures(each=True), first), "nor do episodes before"


@pytest.mark.parametrize("action", [1.0, -1.0])
def test_the_cart_does_not_jump_between_pictures(action):
    """The cart moves at most as many pixels as its distance, also when it leaves the first view."""
    env = pg.gym.make("cart_pole", poles=1, bound=30.0, render_mode="rgb_array")
    env.reset(options={"state": [0.0, 0.0, 0.0, 0.0]})

    def place():
        rows, columns = np.nonzero((env.render() == [0xC9, 0xCE, 0xD6]).all(axis=2))
        return np.array([columns.mean(), rows.mean()])

    before, x, places = place(), env.state[0], []
    assert np.abs(before[0] - 360) < 2, "the cart begins in the middle"
    for count in range(env.task.horizon):
        env.step(np.array([action if count < 60 else -action], np.float32))
        at, position = place(), env.state[0]
        # 720 pixels show 6 pole lengths of 1 m. Arrow and pole cover parts of the cart.
        assert np.abs(at[0] - before[0]) <= 120 * np.abs(position - x) + 25, count
        assert np.abs(at[1] - before[1]) <= 8 and 100 < at[0] < 620
        places.append(at[0])
        before, x = at, position
    assert np.abs(x) > 6 and np.ptp(places) > 150, "the cart has left the first view"


def test_render_modes():
    env = pg.gym.make("cart_pole", poles=1)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="has no render mode; create it with"):
        assert env.render() is None
    settings = {"poles": 1, "render_mode": "rgb_array"}
    env, envs = pg.gym.make("cart_pole", **settings), pg.gym.make_vec("cart_pole", **settings)
    assert env.metadata["render_fps"] == round(1 / env.task.dt)
    for environment in (env, envs):
        with pytest.raises(RuntimeError, match="the episode has not begun. Call `reset` first"):
            environment.render()
    with pytest.raises(ValueError, match="`render_mode` is 'ansi'; allowed: 'rgb_array', 'human', None"):
        pg.gym.make("cart_pole", render_mode="ansi")
    with pytest.raises(ValueError, match="`render_mode` is 'human'; allowed: 'rgb_array', None"):
        pg.gym.make_vec("cart_pole", render_mode="human")
    y, _ = env.reset(seed=0)
    envs = pg.gym.make_vec("cart_pole", 2, poles=1, render_mode="rgb_array")
    envs.reset(seed=0, options={"state": np.stack([env.state, env.state + 1])})
    pictures = envs.render()
    assert len(pictures) == 2 and np.array_equal(pictures[0], env.render())
    assert not np.array_equal(*pictures)
    # Gymnasium collects the pictures of an episode.
    env = gymnasium.make("physgrad/cart_pole-v0", poles=1, render_mode="rgb_array_list")
    env.reset(seed=0)
    env.step(np.zeros(1, np.float32))
    assert [picture.shape for picture in env.render()] == [pictures[0].shape] * 2


def test_a_system_of_functions_is_shown_as_curves():
    env = pg.gym.make(noisy(), render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (216, 540, 3)
    for _ in range(6):
        env.step(np.ones(1, np.float32))
    # The colours of states and controls.
    for colour in ([0x00, 0x72, 0xB2], [0xD5, 0x5E, 0x00]):
        columns = np.nonzero((env.render() == colour).all(axis=2))[1]
        assert columns.min() < 170 and columns.max() > 500


WINDOW = """
import numpy as np, physgrad as pg, pygame
env = pg.gym.make("cart_pole", poles=1, render_mode="human")
same = pg.gym.make("cart_pole", poles=1, render_mode="rgb_array")
env.reset(seed=0), same.reset(seed=0)
for _ in range(3):
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert np.array_equal(shown, same.render())
    env.step(np.ones(1, np.float32)), same.step(np.ones(1, np.float32))
assert env.render() is None
env.close()
assert pygame.display.get_surface() is None
env.close()
env.reset(seed=0)
assert pygame.display.get_surface() is not None
env.close()
"""


def test_a_window_shows_the_picture():
    pytest.importorskip("pygame", reason="pygame is not installed")
    # In a process of its own: drivers of graphics may load a version of LLVM beside that of PyTorch.
    environment = {**os.environ, "SDL_VIDEODRIVER": "dummy"}
    subprocess.run([sys.executable, "-c", WINDOW], env=environment, check=True, timeout=120)


def test_a_window_without_pygame_is_refused_with_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match="run `pip install pygame`"):
        pg.gym.make("cart_pole", render_mode="human")


def test_record_video_makes_a_film(tmp_path):
    warnings.simplefilter("ignore")  # those of MoviePy
    moviepy = pytest.importorskip("moviepy", reason="moviepy is not installed")
    env = gymnasium.make("physgrad/cart_pole-v0", poles=1, horizon=10, render_mode="rgb_array")
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "films"), episode_trigger=lambda episode: True)
    env.reset(seed=0)
    for _ in range(10):
        env.step(env.action_space.sample())
    env.close()
    [film] = tmp_path.glob("films/*.mp4")
    with moviepy.VideoFileClip(str(film)) as clip:
        assert clip.size == [720, 502] and clip.fps == env.metadata["render_fps"]
        # MoviePy may drop the last picture.
        assert round(clip.duration * clip.fps) in (10, 11)


@slow
def test_a_step_takes_at_most_one_and_a_half_times_that_of_the_pendulum_of_gymnasium():
    pendulum, env = gymnasium.make("Pendulum-v1").unwrapped, pg.gym.make("cart_pole", poles=1)
    action, least = np.array([0.3], np.float32), {}
    for _ in range(100):
        for each in (pendulum, env):
            each.reset(seed=0)
            begin = time.perf_counter()
            for _ in range(50):
                each.step(action)
            least[each] = min(time.perf_counter() - begin, least.get(each, np.inf))
    print(f"a step: {1e6 * least[env] / 50:.1f} µs, Pendulum-v1: {1e6 * least[pendulum] / 50:.1f} µs")
    assert least[env] < 1.5 * least[pendulum]

"""Gymnasium environments."""

import warnings

import numpy as np
import physgrad as pg
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402


@pytest.fixture(autouse=True)
def warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Observations of tasks have no bounds.
        warnings.filterwarnings("ignore", ".*Box observation space m.*imum value is -?infinity")
        yield


@pytest.mark.parametrize("name", sorted(pg._core.task_names()))
def test_all_tasks_pass_the_checks(name):
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


def test_a_render_mode_is_a_type_error_after_which_stable_baselines3_omits_it():
    with pytest.raises(TypeError, match="environments are not rendered"):
        gymnasium.make("physgrad/cart_pole-v0", poles=1, render_mode="rgb_array")
    assert gymnasium.make("physgrad/cart_pole-v0", poles=1, render_mode=None).unwrapped.render_mode is None

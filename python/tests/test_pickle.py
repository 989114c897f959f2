"""Copies and pickles of tasks, policies and environments."""

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import physgrad as pg
import pytest


def copies(value):
    return [copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value))]


def own():
    """A cart of equations, with noise and a sensor."""
    return pg.system(
        lambda x, u, p: [x.speed, u.force / p.mass + p.gust],
        states=["position", "speed"],
        controls={"force": (-5, 5)},
        params={"mass": pg.uniform(0.8, 1.2), "gust": pg.noise(0.2)},
        start={"position": 1.0},
        running_cost=lambda x, u, next: next.position**2 + 0.01 * u.force**2,
        sensor={"delay": {"steps": 1}},
        dt=0.1,
        horizon=10,
    )


TASKS = {
    "preset": lambda: pg.task("cart_pole_windy", poles=1, horizon=10),
    "list": lambda: pg.task("pendulum", horizon=5, settings={"system.arms[0].mass": 2.0}),
    "own": own,
}


@pytest.mark.parametrize("name", TASKS)
def test_copies_of_tasks_and_policies_compute_the_same(name):
    task = TASKS[name]()
    policy = pg.Policy(task, seed=3, kind="gru", units=4)
    starts = task.starts(4)
    losses = pg.losses(task, policy, starts)
    for other in copies(task):
        assert other == task and hash(other) == hash(task)
        assert other.settings == task.settings
        np.testing.assert_array_equal(other.starts(4), starts)
        np.testing.assert_array_equal(pg.losses(other, policy, starts), losses)
    for other in copies(policy):
        np.testing.assert_array_equal(other.theta, policy.theta)
        np.testing.assert_array_equal(pg.losses(task, other, starts), losses)
        other.theta = other.theta + 1.0
        assert (other.theta != policy.theta).all(), "a copy shares its parameters"
    longer = task.replace(horizon=20)
    assert longer != task and len({task, copy.copy(task), longer}) == 2
    assert task != "a task"


def test_a_task_keeps_its_initial_policy(tmp_path):
    task = pg.task("cart_pole", poles=1, horizon=5)
    policy = pg.Policy(task, seed=9)
    path = tmp_path / "policy.safetensors"
    policy.save(path)
    given = task.replace(settings={"initial_policy": str(path)})
    path.unlink()
    for other in copies(given):
        assert other == given
        np.testing.assert_array_equal(pg.train(other, epochs=0).policy.theta, pg.train(given, epochs=0).policy.theta)
    assert given != task


def test_environments_are_copied_with_their_state():
    pytest.importorskip("gymnasium", reason="Gymnasium is not installed")
    env = pg.gym.make(own())
    env.reset(seed=4)
    env.step(np.zeros(1, np.float32))
    for other in copies(env)[1:]:
        a, b = env.unwrapped.state, other.unwrapped.state
        np.testing.assert_array_equal(a, b)
        step = np.full(1, 0.3, np.float32)
        first, second = copy.deepcopy(env).step(step), other.step(step)
        np.testing.assert_array_equal(first[0], second[0])
        assert first[1] == second[1]


def test_other_processes_compute_the_same():
    task = own()
    policies = [pg.Policy(task, seed=seed) for seed in range(3)]
    starts = task.starts(5)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        found = [pool.submit(pg.gradients, task, policy, starts, ["R", "C"]) for policy in policies]
        for future, policy in zip(found, policies, strict=True):
            for field, vector in pg.gradients(task, policy, starts, ["R", "C"]).items():
                assert future.result()[field].tobytes() == vector.tobytes()


def test_copies_of_a_run_continue_with_its_bits():
    task = own()
    run = pg.train(task, pg.Mlp(task, [8], seed=1), epochs=2, train_samples=8, test_samples=8, seed=3)
    for other in copies(run):
        assert other == run and hash(other) == hash(run) and other.folder is None
        assert other.policy == run.policy and other.best_policy == run.best_policy
        np.testing.assert_array_equal(other.history["test_loss"], run.history["test_loss"])
        other.train(epochs=4)
        assert other != run and other.policy != run.policy
    run.train(epochs=4)
    np.testing.assert_array_equal(other.policy.theta, run.policy.theta)


def test_policies_are_compared_by_settings_and_parameters():
    task = own()
    policy = pg.Mlp(task, [4], seed=1)
    assert policy == pg.Mlp(task, [4], seed=1) and policy != pg.Mlp(task, [4], seed=2) and policy != pg.Mlp(task, [5], seed=1)
    changed, before = policy.copy(), hash(policy)
    changed.theta = changed.theta + 1.0
    assert changed != policy and hash(changed) == before

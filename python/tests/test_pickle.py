"""Copies and pickles of tasks, policies, runs and environments, and trainings in other processes."""

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


@pytest.mark.parametrize("make", [lambda: pg.gym.make(own()), lambda: pg.gym.make_vec(own(), 3)])
def test_environments_are_equal_to_themselves_only_and_their_tasks_by_settings(make):
    pytest.importorskip("gymnasium", reason="Gymnasium is not installed")
    env, other = make(), make()
    env.reset(seed=4)
    for second in (other, copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert env != second and len({env, second}) == 2 and [env, second].index(second) == 1
        assert env.task == second.task and hash(env.task) == hash(second.task)
    assert env == env and env.task != own().replace(horizon=11)


def step_once(env):
    """The task and the results of a step of an environment that comes from another process."""
    return env.task, env.reset(seed=4)[0], env.step(np.full(env.action_space.shape, 0.3, np.float32))[:2]


def test_environments_are_pickled_to_other_processes():
    pytest.importorskip("gymnasium", reason="Gymnasium is not installed")
    env = pg.gym.make(own())
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        task, y, (following, reward) = pool.submit(step_once, env).result()
    expected = step_once(env)
    assert task == expected[0] and reward == expected[2][1]
    np.testing.assert_array_equal(y, expected[1])
    np.testing.assert_array_equal(following, expected[2][0])


def test_other_processes_compute_the_same():
    task = own()
    policies = [pg.Policy(task, seed=seed) for seed in range(3)]
    starts = task.starts(5)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        found = [pool.submit(pg.gradients, task, policy, starts, ["R", "C"]) for policy in policies]
        for future, policy in zip(found, policies, strict=True):
            for field, vector in pg.gradients(task, policy, starts, ["R", "C"]).items():
                assert future.result()[field].tobytes() == vector.tobytes()


FAST = {"train_samples": 16, "test_samples": 16, "epochs": 2}


def test_copies_of_runs_continue_with_the_same_bits(tmp_path):
    task = own()
    run = pg.Run(task, pg.Mlp(task, [4], seed=3), seed=3, **{**FAST, "epochs": 4})
    run.train(lambda record: record["epoch"] < 2)
    run.save(tmp_path / "run")
    others = copies(run)
    run.train()
    for other in others:
        assert len(other.history["epoch"]) == 2 and other.folder is None and other.task == run.task
        other.train()
        assert other.policy.theta.tobytes() == run.policy.theta.tobytes()
        assert other.best_policy.theta.tobytes() == run.best_policy.theta.tobytes()
        np.testing.assert_array_equal(other.history["test_loss"], run.history["test_loss"])


def check_equal(runs, others):
    assert len(runs) == len(others)
    for run, other in zip(runs, others, strict=True):
        assert run.policy.theta.tobytes() == other.policy.theta.tobytes()
        assert run.history["test_loss"].tobytes() == other.history["test_loss"].tobytes()


@pytest.mark.parametrize("backend", ["loky", "threading", "multiprocessing"])
def test_joblib_trains_many_seeds_with_the_bytes_of_a_loop(backend):
    joblib = pytest.importorskip("joblib", reason="joblib is not installed")
    task = own()
    call = joblib.delayed(pg.train)
    found = joblib.Parallel(2, backend=backend)(call(task, seed=seed, **FAST) for seed in range(6))
    check_equal([pg.train(task, seed=seed, **FAST) for seed in range(6)], found)


def test_dask_runs_trainings_in_a_local_cluster():
    distributed = pytest.importorskip("distributed", reason="dask[distributed] is not installed")
    task, policy = own(), pg.Mlp(own(), [4], seed=2)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            futures = [client.submit(pg.train, task, policy, seed=seed, pure=False, **FAST) for seed in range(3)]
            check_equal([pg.train(task, policy, seed=seed, **FAST) for seed in range(3)], client.gather(futures))
            x = task.starts(5)
            np.testing.assert_array_equal(client.submit(pg.losses, task, policy, x).result(), pg.losses(task, policy, x))


def test_ray_runs_trainings_in_a_local_cluster():
    ray = pytest.importorskip("ray", reason="Ray is not installed")
    task, policy = own(), pg.Mlp(own(), [4], seed=2)
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        remote = ray.remote(pg.train)
        futures = [remote.remote(task, policy, seed=seed, **FAST) for seed in range(3)]
        check_equal([pg.train(task, policy, seed=seed, **FAST) for seed in range(3)], ray.get(futures))
    finally:
        ray.shutdown()


def test_a_divergence_in_another_process_has_its_place_and_its_run():
    task = pg.task("cart_pole", poles=1, dt=5.0, horizon=60, effects={"bumpers": {}})
    policy = pg.Policy(task, seed=1, zero_init_output=False)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        error = pool.submit(pg.train, task, policy, max_skipped=0, **FAST).exception()
    assert type(error) is pg.Divergence and error.variable == "state" and error.run.task.horizon == 60


def test_policies_are_compared_by_settings_and_parameters():
    task = own()
    policy = pg.Mlp(task, [4], seed=1)
    assert policy == pg.Mlp(task, [4], seed=1) and policy != pg.Mlp(task, [4], seed=2) and policy != pg.Mlp(task, [5], seed=1)
    assert policy == policy and policy in [policy]
    changed, before = policy.copy(), hash(policy)
    changed.theta = changed.theta + 1.0
    assert changed != policy and hash(changed) == before

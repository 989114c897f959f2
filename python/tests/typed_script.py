"""A script of a user with the whole interface, for checkers of types. `test_types.py` also runs it."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import physgrad as pg


def tanks(x: Any, u: Any, p: Any) -> list[Any]:
    return [u.pump * p.gain - x.h1, x.h1 - x.h2 + p.leak]


def costs(x: Any, u: Any, next: Any) -> Any:
    return (next.h2 - 0.3) ** 2 + 1e-4 * u.pump**2


def own() -> pg.Task:
    return pg.system(
        tanks,
        states=["h1", "h2"],
        controls={"pump": (0, 5)},
        params={"gain": pg.uniform(0.8, 1.2), "leak": pg.noise(0.01)},
        start={"h1": pg.normal(0.1, 0.01), "h2": pg.log_uniform(0.1, 0.2)},
        running_cost=costs,
        dt=0.1,
        horizon=8,
        sensor={"delay": {"steps": 1}},
    )


def tasks() -> list[pg.Task]:
    task = pg.task("cart_pole", poles=1, horizon=8, precision="f64", effects={"pole_damping": {}}, tags=["a"])
    drawn = task.replace(vary={"cart_mass": pg.uniform(0.8, 1.2), "pole_mass": pg.choice([0.1, 0.2])}, seed=2)
    fitted = task.replace(fit={"cart_mass": pg.trained(1.0, min=0.5, max=2.0)}, training={"batch": 4})
    return [
        task,
        drawn,
        fitted,
        own(),
        task.replace(settings={"system.cart_mass": 1.5}, effects={"pole_damping": None}),
    ]


def shapes(task: pg.Task) -> tuple[int, int, int, int, int]:
    names: list[str] = task.state_names + task.control_names + task.param_names + task.observation_names
    if task.model is not None:
        names += task.model.bodies + list(task.model.numbers)
    print(task.name, names, task.dt, task.dtype, task.control_bounds, task.settings["horizon"])
    return task.state_dim, task.control_dim, task.param_dim, task.observation_dim, task.start_dim


def single_steps(task: pg.Task) -> float:
    n, m, _, observed, _ = shapes(task)
    starts = task.starts(4, seed=1, split="test", dtype=np.float64)
    x, p, u = starts[:, :n], task.params_at(starts, t=0), np.zeros((4, m))
    next = task.step(x, u, p=p, t=0)
    x_bar, u_bar, p_bar = task.step_vjp(x, u, np.ones_like(next), p=p)
    tangent = task.step_jvp(x, u, x_tan=x_bar, u_tan=u_bar, p=p, p_tan=p_bar)
    y_x, y_p = task.observe_vjp(x, np.ones((4, observed)), p=p)
    cost = task.running_cost(x, u, next, p=p) + task.terminal_cost(next, p=p)
    bars = task.running_cost_vjp(x, u, next, np.ones(4), p=p)
    last = task.terminal_cost_vjp(next, np.ones(4), p=p)
    return float(sum(a.sum() for a in (tangent, y_x, y_p, cost, *bars, *last, task.observe(x, p=p))))


def policies(task: pg.Task, folder: Path) -> pg.Policy:
    policy = pg.Mlp(task, [8, 8], seed=1, activation="relu")
    policy.theta = policy.theta + 0.01
    policy.save(folder / "policy.safetensors")
    other = pg.Policy(task, 2, kind="mlp", widths=[8, 8], activation="relu")
    other.load(str(folder / "policy.safetensors"))
    print(len(other), other.copy().theta.shape, other.task.name, other(np.zeros((1, task.observation_dim))))
    return other


def evaluate(task: pg.Task, policy: pg.Policy) -> None:
    starts = task.starts(4)
    x, u = pg.rollout(task, policy, starts)
    fields = pg.gradients(task, policy, starts, fields=["R", "M", "combined"])
    print(x.shape, u.shape, pg.losses(task, policy, starts).mean(), fields["R"] @ fields["M"])
    print(pg.check(task, policy))


def stop(record: dict[str, float]) -> bool:
    return record["epoch"] < 2


def train(task: pg.Task, policy: pg.Policy, folder: Path) -> pg.Run:
    run = pg.train(
        task,
        policy,
        callback=stop,
        out=folder / "run",
        threads=1,
        progress=False,
        field="C",
        epochs=3,
        seed=1,
        train_samples=4,
        test_samples=4,
        learning_rate=1e-3,
        optimizer="adam",
        clip="norm",
    )
    print(run.history["test_loss"].min(), run.is_done, run.best_policy.theta[0], run.task.horizon, run.folder)
    run.report(folder / "report.html")
    run.train(lambda record: print(record["epoch"]), epochs=3)
    try:
        pg.Run(task, policy, epochs=1, batch=2, train_samples=4, test_samples=4).train()
    except pg.Divergence as error:
        print(error.step, error.sample, error.component, error.variable, error.run)
    return pg.load(folder / "run")


def numbers(task: pg.Task, policy: pg.Policy) -> None:
    x, u = pg.rollout(task, policy, task.starts(2))
    data = [(x[i, :-1], u[i]) for i in range(2)]
    print(pg.identify(task, data, params={"system.cart_mass": 1.1}))
    print(pg.optimize(task, task.starts(1)[0], bounds=[[-20, 20]], iterations=2))


def frameworks(task: pg.Task) -> list[Any]:
    """Only checked: the frameworks need not be installed."""
    step, cost = pg.torch.step(task), pg.jax.running_cost(task)
    return [step, cost, pg.gym.make("cart_pole", poles=1)]


def main() -> None:
    with TemporaryDirectory() as name:
        for task in tasks():
            print(single_steps(task))
            policy = policies(task, Path(name))
            evaluate(task, policy)
            print(train(task, policy, Path(name)).history["epoch"])
        numbers(tasks()[0], pg.Mlp(tasks()[0]))
        print(pg.__version__)


if __name__ == "__main__":
    main()

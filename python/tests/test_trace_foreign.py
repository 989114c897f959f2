"""Code of other packages, unmodified, through the tracer."""

import numpy as np
import pytest
from equations import Case, close, trace
from test_import import agree, needs_module


def agrees(case, tolerance, scale=2.0, params=None, count=50):
    rng = np.random.default_rng(5)
    n, m = len(case.states), len(case.controls)
    for _ in range(count):
        expected, found = case.both(
            rng.normal(0, scale, n), rng.normal(0, scale, m), rng.normal(0, scale, n), 0.3, params
        )
        assert len(found) == len(expected)
        for a, b in zip(expected, found, strict=True):
            assert close(a, b, tolerance) or abs(a - b) < tolerance, (a, b, case.texts())


@pytest.mark.parametrize("variant", ["book", "nips"])
def test_acrobot(variant):
    acrobot = pytest.importorskip(
        "gymnasium.envs.classic_control.acrobot", reason="Gymnasium is not installed"
    )
    env = acrobot.AcrobotEnv()
    env.book_or_nips = variant

    def rate(x, u):
        return env._dsdt(np.append(x, u))[:4]

    case = Case("rate", rate, ["theta1", "theta2", "rate1", "rate2"], ["torque"], angles=["theta1", "theta2"])
    agrees(case, 1e-13)


def test_acrobot_advanced_by_its_own_integrator():
    acrobot = pytest.importorskip(
        "gymnasium.envs.classic_control.acrobot", reason="Gymnasium is not installed"
    )
    env = acrobot.AcrobotEnv()
    try:
        acrobot.rk4(env._dsdt, np.zeros(5), [0, env.dt])
    except AttributeError as error:
        pytest.skip(f"this release of Gymnasium does not run with this release of NumPy: {error}")
    agrees(Case("step", lambda x, u: acrobot.rk4(env._dsdt, np.append(x, u), [0, env.dt]), 4, 1), 1e-11)


def test_pendulum():
    pendulum = pytest.importorskip(
        "gymnasium.envs.classic_control.pendulum", reason="Gymnasium is not installed"
    )

    class Env(pendulum.PendulumEnv):
        def _get_obs(self):
            """The observation is in float32, which traced numbers refuse."""

    env = Env()

    def step(x, u):
        env.state = x
        env.step(u)
        return env.state

    def cost(x, u):
        env.state = x
        return -env.step(u)[1]

    case = Case("step", step, ["angle", "speed"], ["torque"])
    agrees(case, 0.0)
    assert "clip(torque, -2, 2)" in "".join(case.texts()) + str(case.system.get("define"))
    agrees(Case("running_cost", cost, ["angle", "speed"], ["torque"]), 1e-13)


def test_the_angle_of_a_remainder_is_wrapped():
    def wrapped(x):
        return [
            (x[0] + np.pi) % (2 * np.pi) - np.pi,
            np.mod(np.pi + x[1], 2 * np.pi) - np.pi,
            np.mod(x[2] - np.pi, 2 * np.pi) - np.pi,
        ]

    case = Case("rate", wrapped, 3)
    agrees(case, 1e-14, scale=5.0)
    assert case.texts()[0] == "atan2(sin(x1), cos(x1))"
    for other in (
        lambda x: [(x[0] + 3) % (2 * np.pi) - np.pi],
        lambda x: [(x[0] + np.pi) % 6 - np.pi],
        lambda x: [(np.pi - x[0]) % (2 * np.pi) - np.pi],
    ):
        with pytest.raises(ValueError, match="only as the angle"):
            trace.trace_settings(other, states=1, dt=0.1)


# All linear plants of controlgym: those of files, and three equations of waves and heat.
FILES = (
    "toy ac1 ac2 ac3 ac4 ac5 ac6 ac7 ac8 ac9 ac10 bdt1 bdt2 cbm cdp cm1 cm2 cm3 cm4 cm5 dis1 dis2 dlr "
    "he1 he2 he3 he4 he5 he6 iss je1 je2 lah pas psm rea umv".split()
)
WAVES = ["wave", "schrodinger", "convection_diffusion_reaction"]
# Dense matrices of 240 states and more have too many operations.
TOO_LARGE = {
    "cm4": "at most 500000 bytes",
    "cbm": "more than 200000 operations",
    "cm5": "more than 200000 operations",
}
PLANTS = [name for name in FILES if name not in TOO_LARGE]


def plant(name):
    """An environment without noise, whose own `step` computes the next state."""
    controlgym = pytest.importorskip("controlgym", reason="controlgym is not installed")
    size = {"n_state": 16, "n_observation": 4, "n_action": 2} if name in WAVES else {}
    env = controlgym.make(name, **size)
    # A documented hook. That of controlgym makes a `float`, and compares it with limits.
    env.get_reward = lambda *_: 0.0
    quiet = {} if name in WAVES else {"disturbance": np.zeros(env.n_disturbance)}

    def step(x, u):
        env.state = x
        env.step(u, **quiet)
        return env.state

    return env, step


@pytest.mark.parametrize("name", PLANTS + WAVES)
def test_plants_of_controlgym_by_their_own_step(name):
    env, step = plant(name)
    agrees(Case("step", step, env.n_state, env.n_action), 1e-9, count=50 if env.n_state < 50 else 2)


@needs_module
@pytest.mark.parametrize("name", PLANTS)
def test_derivatives_of_linear_plants_of_controlgym(name):
    import physgrad as pg

    env, step = plant(name)
    task = pg.system(step=step, states=env.n_state, controls=env.n_action, dt=0.1)
    rng = np.random.default_rng(5)
    x, u, bar = (rng.normal(size=(20, n)) for n in (env.n_state, env.n_action, env.n_state))
    expected = [step(*row) for row in zip(x, u, strict=True)], bar @ env.A, bar @ env.B2
    for a, b in zip(expected, (task.step(x, u), *task.step_vjp(x, u, bar)[:2]), strict=True):
        agree(a, b, 1e-12, scale=np.abs(a).max())


@needs_module
@pytest.mark.parametrize("name", TOO_LARGE)
def test_plants_of_controlgym_with_too_many_operations_are_refused(name):
    import physgrad as pg

    env, step = plant(name)
    with pytest.raises(ValueError, match=TOO_LARGE[name]):
        pg.system(step=step, states=env.n_state, controls=env.n_action, dt=0.1)


@pytest.mark.parametrize("name", PLANTS)
def test_costs_of_linear_plants_of_controlgym(name):
    env, _ = plant(name)

    def cost(x, u):
        return x.T @ env.Q @ x + u.T @ env.R @ u + 2 * x.T @ env.S @ u

    case = Case("running_cost", cost, env.n_state, env.n_action)
    agrees(case, 1e-9, count=50 if env.n_state < 50 else 2)


def test_plants_of_controlgym_by_fourier_transforms_are_refused():
    """Their steps are transforms of complex numbers, which equations do not have."""
    controlgym = pytest.importorskip("controlgym", reason="controlgym is not installed")
    env = controlgym.make("burgers", n_state=8, n_observation=2, n_action=2)

    def step(x, u):
        env.state = x
        env.step(u)
        return env.state

    with pytest.raises(TypeError, match="np.rfft is not supported.*matrices of cosines"):
        trace.trace_settings(step=step, states=8, controls=2, dt=0.1)

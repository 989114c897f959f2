"""Robots from model files."""

import pickle
import textwrap

import numpy as np
import pytest

import physgrad as pg

SWING = textwrap.dedent("""
    <mujoco model="swing">
      <option timestep="0.01"/>
      <worldbody>
        <body name="arm" pos="0 0 1">
          <joint name="hinge" axis="0 1 0" damping="0.1"/>
          <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/>
          <site name="end" pos="0 0 -0.5"/>
        </body>
      </worldbody>
      <actuator><motor name="torque" joint="hinge" ctrlrange="-2 2"/></actuator>
    </mujoco>
""")


@pytest.fixture
def swing(tmp_path):
    (tmp_path / "swing.xml").write_text(SWING)
    cost = {"running": "(next.site.end.z - 1.5)^2 + 1e-3 * torque^2"}
    return pg.bodies(tmp_path / "swing.xml", frames=2, loss=cost, horizon=20)


def test_a_task_has_the_names_and_ranges_of_the_file(swing):
    assert swing.state_names == ["qpos.hinge", "qvel.hinge"] and swing.control_names == ["torque"]
    assert swing.control_bounds == [(-2.0, 2.0)] and swing.dt == 0.02


def test_a_pendulum_moves_as_its_equation_says(swing):
    # Moments about the hinge of a capsule: a cylinder and two half balls.
    r, h = 0.02, 0.5
    ball, rod = 4 / 3 * np.pi * r**3, np.pi * r**2 * h
    ball, rod = ball / (ball + rod), rod / (ball + rod)
    about = rod * (3 * r**2 + h**2) / 12 + ball * (0.4 * r**2 + h * (3 / 8 * r + h / 4))
    inertia = about + 0.25**2
    q, v, u = 0.3, -0.4, 1.5
    for _ in range(2):
        v += 0.01 * (u - 0.1 * v - 9.81 * 0.25 * np.sin(q)) / (inertia + 0.01 * 0.1)
        q += 0.01 * v
    found = swing.step(np.array([[0.3, -0.4]]), np.array([[1.5]]))
    assert np.allclose(found, [[q, v]], rtol=1e-12)


def test_sites_of_the_next_state_are_known_to_costs(swing):
    x, u, after = np.array([[0.0, 0.0]]), np.array([[1.0]]), np.array([[np.pi / 2, 0.0]])
    assert np.isclose(swing.running_cost(x, u, after), 0.5**2 + 1e-3)


def test_a_task_holds_its_model_and_outlives_the_file(swing, tmp_path):
    (tmp_path / "swing.xml").unlink()
    again = pickle.loads(pickle.dumps(swing))
    assert again == swing and "<mujoco" in again.settings["system"]["model"]


def test_derivatives_pass_the_check(swing):
    pg.check(swing)
    pg.check(pg.bodies("ant", horizon=4, start={"qpos": {"root_z": 0.5}}, spread=[0.1, 0.1]))


def test_numbers_of_the_model_vary_between_samples(swing):
    varied = swing.replace(body={"arm": {"mass": pg.uniform(0.5, 2.0)}})
    starts = varied.starts(3, seed=0)
    assert varied.param_names == ["system.body.arm.mass"] and len(set(starts[:, -1])) == 3
    x, u = np.tile([[0.3, 0.0]], (2, 1)), np.full((2, 1), 1.0)
    light, heavy = varied.step(x, u, p=np.array([[1.0], [2.0]]))
    assert np.allclose(light, swing.step(x[:1], u[:1])[0], rtol=1e-13) and light[1] != heavy[1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"body": {"arn": {"mass": 1.0}}}, "`body.arm.mass`"),
        ({"joint": {"hinge": {"dampng": 1.0}}}, "did you mean `joint.hinge.damping`"),
        ({"start": {"qpos": {"hing": 0.1}}}, "did you mean `qpos.hinge`"),
        ({"hidden": ["qpos.arm"]}, "is no state; states: `qpos.hinge` or `qvel.hinge`"),
        ({"loss": {"running": "body.arm.q"}}, "did you mean `body.arm."),
        ({"pose": "home"}, "`home`"),
        ({"frames": 0}, "`system.frames` is 0"),
        ({"contacts": "hard"}, "`file`, `smooth`, `none`"),
        ({"method": "rk45"}, "`rk4`"),
        ({"spread": [0.1, -0.1]}, "0 or more"),
    ],
)
def test_errors_name_the_setting_and_what_is_allowed(swing, settings, message):
    with pytest.raises(ValueError) as error:
        swing.replace(**settings)
    assert message in str(error.value)


def test_files_that_cannot_be_simulated_are_refused_with_their_line(tmp_path):
    with pytest.raises(ValueError, match="models of the program: `ant`"):
        pg.bodies("anty")
    (tmp_path / "a.xml").write_text(SWING.replace("capsule", "mesh"))
    with pytest.raises(ValueError, match="line 6"):
        pg.bodies(tmp_path / "a.xml")


def test_every_command_of_python_accepts_bodies(swing):
    swing = swing.replace(spread=[0.5, 0.5])
    run = pg.train(swing, epochs=2, progress=False)
    starts = swing.starts(2, seed=1)
    assert np.isfinite(pg.losses(swing, run.policy, starts)).all()
    assert np.isfinite(pg.optimize(swing, starts[0]).cost)

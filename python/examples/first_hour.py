"""Trains a controller, writes its report, and computes four fields.

    python first_hour.py            # a minute
    python first_hour.py --quick    # two epochs
"""

import argparse
from pathlib import Path

import numpy as np
import physgrad as pg

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="train for two epochs")
parser.add_argument("--out", type=Path, default=Path("runs/python_first_hour"), help="folder of the results")
options = parser.parse_args()
options.out.mkdir(parents=True, exist_ok=True)

# `poles` is a setting of the section `system` of a scene.
task = pg.task("cart_pole", poles=2)
print(f"{task.name}: states {task.state_names}, controls {task.control_names}, {task.horizon} steps of {task.dt} s")

# Trains with field C: components of M whose signs agree with those of the gradient R.
policy = pg.Mlp(task, [64, 64], seed=1)
run = pg.train(task, policy, field="C", epochs=2 if options.quick else 100, seed=1, out=options.out / "run")
losses = run.history["test_loss"]
print(f"test loss {losses[0]:.3f} after one epoch, {losses[-1]:.4f} after {len(losses)}")
run.report(options.out / "report.html")
run.policy.save(options.out / "policy.safetensors")

# Rollouts from 64 new initial states.
starts = task.starts(64, seed=2)
x, u = pg.rollout(task, run.policy, starts)
print(f"states {x.shape}, controls {u.shape}; largest control {np.abs(u).max():.1f} N")

# Fields R, M, S and C at the trained policy.
gradients = pg.gradients(task, run.policy, starts, fields=["R", "M", "S", "C"])
for name, gradient in gradients.items():
    print(f"{name}: norm {np.linalg.norm(gradient):.3g}, {np.mean(gradient != 0):.0%} of the components are not 0")
print(f"open {options.out / 'report.html'}")

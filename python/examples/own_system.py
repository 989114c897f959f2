"""Trains a system that is written in NumPy, and compares it with the built-in task, if there is one.

python own_system.py                     # the cart with four poles, a minute
python own_system.py quadrotor --quick   # another file of the folder `systems`, two epochs
"""

import argparse
import importlib

import numpy as np
import physgrad as pg

NAMES = ["cart_pole", "guidance", "multi_pendulum", "pole_chain", "quadrotor"]
parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument(
    "name", nargs="?", default="cart_pole", choices=NAMES, help="file of the folder `systems`"
)
parser.add_argument("--quick", action="store_true", help="train for two epochs")
options = parser.parse_args()

system = importlib.import_module(f"systems.{options.name}")
task = system.make()
if hasattr(system, "BUILT_IN"):
    kind, settings = system.BUILT_IN
    x = task.starts(100, seed=1, dtype="float64")
    u = np.random.default_rng(1).normal(size=(100, task.control_dim))
    difference = np.abs(task.step(x, u) - pg.task(kind, **settings).step(x, u)).max()
    print(f"largest difference from the built-in task after one step: {difference:.1e}")

run = pg.train(task, pg.Mlp(task, [64, 64], seed=1), field="C", epochs=2 if options.quick else 100, seed=1)
losses = run.history["test_loss"]
print(f"test loss {losses[0]:.3f} after one epoch, {losses[-1]:.4f} after {len(losses)}")

"""Times one step from Python and in Rust, and one training from Python and by the program.

    python speed.py --program target/release/physgrad     # a minute
    python speed.py --quick                               # few repetitions, no training

The time of a step is the shortest of all repetitions. Trainings by the program and from Python
alternate, three of each.
"""

import argparse
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import physgrad as pg
from physgrad import _core

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="few repetitions, no training")
parser.add_argument("--program", default="physgrad", help="path or name of the program, to time its training")
parser.add_argument("--epochs", type=int, default=100, help="epochs of a training")
options = parser.parse_args()
repeats = 5 if options.quick else 2000

task = pg.task("cart_pole", poles=2)


def fastest(call) -> float:
    """Least seconds of a call."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return min(times)


def frameworks(x: np.ndarray, u: np.ndarray) -> dict:
    """Calls by name of the framework, for those that are installed."""
    calls = {"numpy": lambda: task.step(x, u)}
    try:
        import torch

        step, tensors = pg.torch.step(task), (torch.from_numpy(x), torch.from_numpy(u))
        calls["torch"] = lambda: step(*tensors)
    except ImportError:
        pass
    try:
        import jax

        step_jax, arrays = jax.jit(pg.jax.step(task)), (jax.numpy.asarray(x), jax.numpy.asarray(u))
        calls["jax"] = lambda: step_jax(*arrays).block_until_ready()
    except ImportError:
        pass
    return calls


print("microseconds of a step, and ratios to Rust")
for rows in (1, 8, 64, 1024, 16384):
    x = task.starts(rows, seed=0, dtype="float32")
    u = np.ones((rows, task.control_dim), np.float32)
    rust = _core.step_seconds(task, x, u, repeats)
    found = {name: fastest(call) for name, call in frameworks(x, u).items()}
    others = "".join(f"  {name} {1e6 * seconds:8.1f} ({seconds / rust:.2f})" for name, seconds in found.items())
    print(f"batch {rows:6}  Rust {1e6 * rust:8.1f}{others}")

if options.quick:
    raise SystemExit
program = shutil.which(options.program)
if program is None:
    raise SystemExit(f"no program `{options.program}`: give its path by --program to time a training")

seconds = {"program": [], "Python": []}
for _ in range(3):
    with tempfile.TemporaryDirectory() as folder:
        command = [program, "train", "cart_pole", "--seed=1", f"--epochs={options.epochs}", "-q", "-o", f"{folder}/run"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        metrics = np.genfromtxt(Path(folder) / "run" / "metrics.csv", delimiter=",", names=True)
        seconds["program"].append(metrics["seconds"].sum())
    run = pg.train(task, None, field="C", epochs=options.epochs, seed=1)
    seconds["Python"].append(np.sum(run.history["seconds"]))
for name, values in seconds.items():
    print(f"{name}: {options.epochs} epochs in {', '.join(f'{value:.2f}' for value in values)} s")
print(f"ratio of the least times, Python to program: {min(seconds['Python']) / min(seconds['program']):.3f}")

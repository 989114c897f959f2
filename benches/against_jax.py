"""Times epochs of physgrad beside those of a JAX program that trains the same tasks.

    python against_jax.py --jax PROGRAM.py --physgrad target/release/physgrad           # all 36 cells
    python against_jax.py --jax PROGRAM.py --cells 'cart_pole_4/R/8/*' 'quantum_3/*/64/1'
    python against_jax.py --list                                                       # names of all cells

A cell is task/field/batch/threads, and --cells takes patterns of such names. In each cell both programs
alternate, in float32 and on the same cores: the first THREADS of those that this process may use. Each program
trains for about --budget seconds in a cell, after its first epoch, which is not counted. An epoch of either
program includes the evaluation of its training and test states.

The table has the shortest epoch of each program over all alternations, which other work on the machine disturbs
least, and the median over alternations of their median epochs. Ratios are those of physgrad to JAX. The ratio of
medians is the median of the ratios of the alternations, with their range.

The Python that runs this file also runs the JAX program, as

    PROGRAM.py --framework jax --variant adj --dtype f32 --task TASK --mode FIELD --threads THREADS --core CORE
               --epochs EPOCHS --warmup 1 --max-s SECONDS [--shard THREADS]

with the mini-batch in the variable PEERS_BATCH, and the number of training and of test states in PEERS_NDATA.
TASK is cartpole-4, gbr or quantum-3. `--shard` splits mini-batches over as many devices of the host. The program
ends after EPOCHS epochs, or after SECONDS and at least one epoch beyond the first. The last line that it prints
is a JSON object with the seconds of its epochs after the first: `sec_per_epoch`, their median, and `min`.
"""

import argparse
import csv
import datetime
import fnmatch
import itertools
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

# The name of each preset in the JAX program.
TASKS = {"cart_pole_4": "cartpole-4", "guidance_0.1": "gbr", "quantum_3": "quantum-3"}
FIELDS = ["R", "C"]
# Training samples by mini-batch, and as many test samples.
SAMPLES = {8: 256, 64: 512, 512: 1024}
THREADS = [1, 2]
CELLS = {f"{t}/{f}/{b}/{n}": (t, f, b, n) for t, f, b, n in itertools.product(TASKS, FIELDS, SAMPLES, THREADS)}
# More epochs than any budget allows.
MANY = 100_000

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--jax", metavar="PROGRAM.py", help="the JAX program, see the head of this file")
parser.add_argument("--physgrad", default="physgrad", metavar="PROGRAM", help="path or name of the program")
parser.add_argument("--cells", nargs="+", default=["*"], metavar="PATTERN", help="cells to measure [default: all]")
parser.add_argument("--budget", type=float, default=10, metavar="SECONDS", help="of each program in a cell [default: 10]")
parser.add_argument("--rounds", type=int, default=3, metavar="N", help="alternations in a cell [default: 3]")
parser.add_argument("--list", action="store_true", help="print the names of the cells and end")
options = parser.parse_args()

cells = [cell for name, cell in CELLS.items() if any(fnmatch.fnmatch(name, pattern) for pattern in options.cells)]
if options.list:
    print("\n".join("/".join(map(str, cell)) for cell in cells))
    raise SystemExit
if not cells:
    parser.error(f"no cell matches {' '.join(options.cells)}: see --list")
if options.jax is None:
    parser.error("give the JAX program by --jax")
if options.rounds < 1 or options.budget <= 0:
    parser.error("--rounds and --budget are positive")
physgrad = shutil.which(options.physgrad)
if physgrad is None:
    parser.error(f"no program `{options.physgrad}`: give its path by --physgrad")
# Of one program in one alternation.
SPAN = options.budget / options.rounds


def cores(threads: int) -> list:
    """The cores of both programs. Empty where the system cannot bind a process to cores."""
    if not hasattr(os, "sched_setaffinity"):
        return []
    allowed = sorted(os.sched_getaffinity(0))
    if len(allowed) < threads:
        raise SystemExit(f"{threads} threads need as many cores; this process may use {len(allowed)}")
    return allowed[:threads]


def run(command: list, threads: int, **variables) -> str:
    """Standard output of a command on the cores of the cell."""
    used = cores(threads)
    bind = (lambda: os.sched_setaffinity(0, used)) if used else None
    done = subprocess.run(
        list(map(str, command)), env={**os.environ, **variables}, preexec_fn=bind, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} ended with status {done.returncode}:\n{done.stderr.strip()}")
    return done.stdout


def train(task: str, field: str, batch: int, threads: int, epochs: int) -> list:
    """Seconds of the epochs of physgrad after the first."""
    samples = SAMPLES[batch]
    sizes = {"training.batch": batch, "training.train_samples": samples, "training.test_samples": samples}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [physgrad, "train", task, "--field", field, "--precision", "f32", "--threads", threads]
        command += ["--epochs", epochs + 1, "--quiet", "--out", out]
        run(command + [word for key, value in sizes.items() for word in ("--set", f"{key}={value}")], threads)
        with open(out / "metrics.csv", newline="") as file:
            return [float(row["seconds"]) for row in csv.DictReader(file)][1:]


def train_in_jax(task: str, field: str, batch: int, threads: int) -> dict:
    """Median and shortest epoch of the JAX program, in seconds."""
    command = [sys.executable, options.jax, "--framework", "jax", "--variant", "adj", "--dtype", "f32"]
    command += ["--task", TASKS[task], "--mode", field, "--threads", threads, "--core", (cores(1) or [0])[0]]
    command += ["--epochs", MANY, "--warmup", 1, "--max-s", SPAN] + (["--shard", threads] if threads > 1 else [])
    return json.loads(run(command, threads, PEERS_BATCH=str(batch), PEERS_NDATA=str(SAMPLES[batch])).splitlines()[-1])


def measure(cell: tuple) -> tuple:
    """Shortest and median epoch of physgrad and of JAX in ms, and the ratios of the alternations."""
    epochs = max(1, round(SPAN / min(train(*cell, 1))))
    ours, theirs = [], []
    for _ in range(options.rounds):
        ours.append(train(*cell, epochs))
        theirs.append(train_in_jax(*cell))
    medians = [statistics.median(seconds) for seconds in ours], [seconds["sec_per_epoch"] for seconds in theirs]
    shortest = min(map(min, ours)), min(seconds["min"] for seconds in theirs)
    ratios = [own / other for own, other in zip(*medians)]
    return [1e3 * seconds for seconds in shortest], [1e3 * statistics.median(m) for m in medians], ratios


def processor() -> str:
    """The name of the processor, and the instructions that decide about speed, where Linux tells them."""
    try:
        lines = [line.split(":", 1) for line in Path("/proc/cpuinfo").read_text().splitlines() if ":" in line]
    except OSError:
        return platform.processor() or platform.machine()
    fields = {key.strip(): value.strip() for key, value in lines}
    flags = fields.get("flags", "").split()
    best = next((flag for flag in ("avx512f", "avx2") if flag in flags), platform.machine())
    family = f"family {fields.get('cpu family')}, model {fields.get('model')}"
    return f"{fields.get('model name', platform.machine())}, {family}, {best}"


load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
print(f"{datetime.date.today()}, {processor()}, {os.cpu_count()} cores{load}")
print(f"alternations: {options.rounds}; times in ms: physgrad, JAX\n")
print("| task | field | batch | threads | shortest | ratio | median | ratio (range) |")
print("|---|---|---|---|---|---|---|---|", flush=True)
for cell in cells:
    shortest, median, ratios = measure(cell)
    times = [f"{own:.4g}, {other:.4g}" for own, other in (shortest, median)]
    spread = f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
    columns = [*cell, times[0], f"{shortest[0] / shortest[1]:.2f}", times[1], spread]
    print(f"| {' | '.join(map(str, columns))} |", flush=True)

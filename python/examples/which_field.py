"""Compares the fields R, M, S and C on one task, with several seeds, and draws the losses.

    python which_field.py                    # four poles, three seeds: minutes
    python which_field.py --quick            # two epochs, one seed
"""

import argparse
from pathlib import Path

import matplotlib
import numpy as np
import physgrad as pg

matplotlib.use("Agg")
import matplotlib.pyplot as plt

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="two epochs, one seed")
parser.add_argument("--out", type=Path, default=Path("runs/python_which_field"), help="folder of the results")
options = parser.parse_args()
options.out.mkdir(parents=True, exist_ok=True)
epochs, seeds = (2, [0]) if options.quick else (100, [0, 1, 2])

# Colours of the fields in reports of physgrad.
COLORS = {"R": "#0072B2", "M": "#D55E00", "S": "#009E73", "C": "#CC79A7"}
task = pg.task("cart_pole", poles=4)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for field, color in COLORS.items():
    losses = []
    for seed in seeds:
        run = pg.train(task, pg.Mlp(task, [64, 64], seed=seed), field=field, epochs=epochs, seed=seed)
        losses.append(run.history["test_loss"])
    losses, epoch = np.array(losses), np.arange(1, epochs + 1)
    axes.plot(epoch, losses.T, color=color, linewidth=0.7, alpha=0.5)
    axes.plot(epoch, np.median(losses, axis=0), color=color, linewidth=2, label=field)
    last = losses[:, -1]
    print(f"{field}: test loss {np.median(last):.4f}, from {last.min():.4f} to {last.max():.4f} over {len(seeds)} seeds")
axes.set(xlabel="epoch", ylabel="test loss", yscale="log", title=f"{task.name}: medians, and single seeds (thin)")
axes.legend()
figure.savefig(options.out / "fields.png", dpi=150)
print(f"picture: {options.out / 'fields.png'}")

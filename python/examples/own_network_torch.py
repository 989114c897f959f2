"""Trains a torch network of your own by the field C, through the physics of a task.

One rollout has two reverse passes. The pass of R continues through the observations, and that of M
does not. A hook multiplies the gradient with respect to the observations by 1 for R and by 0 for M.
C is M where the signs of R and M agree, and 0 elsewhere.

    python own_network_torch.py            # two minutes
    python own_network_torch.py --quick    # two updates
"""

import argparse
import time

import numpy as np
import physgrad as pg
import torch
from torch import nn

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true", help="two updates")
parser.add_argument("--field", choices=["R", "M", "C"], default="C", help="field that the optimizer follows")
parser.add_argument("--updates", type=int, default=600, help="number of updates")
options = parser.parse_args()
updates = 2 if options.quick else options.updates

torch.manual_seed(0)
task = pg.task("cart_pole", poles=1)
step, observe = pg.torch.step(task), pg.torch.observe(task)
running_cost, terminal_cost = pg.torch.running_cost(task), pg.torch.terminal_cost(task)


class Residual(nn.Module):
    """A network that physgrad does not contain: two residual layers with layer norms."""

    def __init__(self, inputs: int, outputs: int, width: int = 64) -> None:
        super().__init__()
        self.first = nn.Linear(inputs, width)
        self.layers = nn.ModuleList(
            nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU()) for _ in range(2)
        )
        self.last = nn.Linear(width, outputs)
        nn.init.zeros_(self.last.weight)

    def forward(self, y: torch.Tensor) -> torch.Tensor:
        y = self.first(y)
        for layer in self.layers:
            y = y + layer(y)
        return self.last(y)


def rollout(network: nn.Module, starts: np.ndarray, through: list[float]) -> torch.Tensor:
    """Mean loss from ``starts``.

    Reverse passes multiply gradients with respect to observations by ``through[0]``.
    """
    starts = torch.from_numpy(starts).float()
    x, p = starts[:, : task.state_dim], starts[:, task.state_dim :]
    loss = torch.zeros(len(x))
    for t in range(task.horizon):
        y = observe(x, p, t)
        if y.requires_grad:
            y.register_hook(lambda y_bar: y_bar * through[0])
        u = network(y)
        following = step(x, u, p, t)
        loss = loss + running_cost(x, u, following, p, t)
        x = following
    return (loss + terminal_cost(x, p)).mean()


network = Residual(task.observation_dim, task.control_dim)
weights = list(network.parameters())
optimizer = torch.optim.Adam(weights, lr=1e-3)
train, test, through = task.starts(256, seed=1), task.starts(256, seed=2), [1.0]
begin = time.perf_counter()
for update in range(updates):
    loss = rollout(network, train[np.arange(8 * update, 8 * update + 8) % len(train)], through)
    through[0] = 1.0
    regular = torch.autograd.grad(loss, weights, retain_graph=True)
    through[0] = 0.0
    modified = torch.autograd.grad(loss, weights)
    for weight, r, m in zip(weights, regular, modified):
        agree = torch.where(r.sign() * m.sign() > 0, m, torch.zeros_like(m))
        weight.grad = {"R": r, "M": m, "C": agree}[options.field]
    optimizer.step()
    if update % 100 == 0 or update == updates - 1:
        with torch.no_grad():
            loss = rollout(network, test, through)
        print(f"update {update + 1}: test loss {loss:.4f}, {time.perf_counter() - begin:.1f} s")

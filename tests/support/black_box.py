"""What people do instead of a model: a network from joint positions and payload to the tip's displacement."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from support.plant import Array, Rows

torch.set_num_threads(1)  # small matrices: more threads only wait for each other

SIZES = ((16,), (32,), (32, 32))
DECAYS = (1e-3, 1e-1)
MEMBERS, STEPS, EVERY = 5, 1000, 10


def inputs(rows: Rows, slides: Sequence[bool]) -> Array:
    """Sine and cosine of angles, lengths, mass and centre of mass, of every stop."""
    q, slide = rows.q, np.array(slides)
    return np.column_stack([np.sin(q[:, ~slide]), np.cos(q[:, ~slide]), q[:, slide], rows.mass, rows.com])


@dataclass(frozen=True)
class BlackBox:
    """The mean of networks, each stopped where poses that it did not see were told best."""

    layers: list[tuple[torch.Tensor, torch.Tensor]]  # (members, in, out) weights, (members, 1, out) biases
    middle: tuple[Array, Array]  # of inputs and of outputs
    scale: tuple[Array, Array]

    def __call__(self, x: Array) -> Array:
        """(N, 3) displacements for (N, k) inputs."""
        with torch.no_grad():
            found = forward(self.layers, torch.tensor((x - self.middle[0]) / self.scale[0]))
        return found.mean(dim=0).numpy() * self.scale[1] + self.middle[1]


def forward(layers: list[tuple[torch.Tensor, torch.Tensor]], x: torch.Tensor) -> torch.Tensor:
    """(members, N, out) answers to (N, in)."""
    for weight, bias in layers[:-1]:
        x = torch.tanh(x @ weight + bias)
    return x @ layers[-1][0] + layers[-1][1]


def train_black_box(x: Array, y: Array, pose: Array) -> BlackBox:
    """Network of the size and the decay that tell left-out poses best; every pose is left out by one member.

    Args:
        x: (N, k) inputs.
        y: (N, 3) displacements [m].
        pose: (N,) number of the pose of each row.
    """
    middle = x.mean(axis=0), y.mean(axis=0)
    scale = np.maximum(x.std(axis=0), 1e-9), np.full(3, y.std())
    numbers, place = np.unique(pose, return_inverse=True)
    fold = np.random.default_rng(0).permutation(len(numbers))[place] % MEMBERS
    left = torch.tensor(fold[None] == np.arange(MEMBERS)[:, None])
    tensors = [torch.tensor((one - m) / s) for one, m, s in zip((x, y), middle, scale, strict=True)]
    tried = [_trained(*tensors, left, hidden, decay) for hidden in SIZES for decay in DECAYS]
    layers, _ = min(tried, key=lambda one: one[1])
    return BlackBox(layers, middle, scale)


def _trained(x: torch.Tensor, y: torch.Tensor, left: torch.Tensor, hidden: Sequence[int], decay: float):
    """All members at once, each at its best step by the rows that it leaves out; and the mean error there."""
    drawn = torch.Generator().manual_seed(0)
    sizes = (x.shape[1], *hidden, y.shape[1])
    layers = []
    for before, after in pairwise(sizes):
        weight = torch.randn(MEMBERS, before, after, generator=drawn, dtype=x.dtype) / before**0.5
        layers.append((weight.requires_grad_(), torch.zeros(MEMBERS, 1, after, dtype=x.dtype, requires_grad=True)))
    flat = [tensor for layer in layers for tensor in layer]
    steps = torch.optim.AdamW(flat, lr=5e-3, weight_decay=decay)
    slower = torch.optim.lr_scheduler.CosineAnnealingLR(steps, STEPS)
    best, kept = torch.full((MEMBERS,), torch.inf, dtype=x.dtype), [tensor.detach().clone() for tensor in flat]
    for step in range(STEPS):
        error = ((forward(layers, x) - y) ** 2).mean(dim=2)
        steps.zero_grad()
        (error * ~left).sum(dim=1).div((~left).sum(dim=1)).sum().backward()
        if step % EVERY == 0:
            told = ((error * left).sum(dim=1) / left.sum(dim=1)).detach()
            better = (told < best)[:, None, None]
            kept = [torch.where(better, now.detach(), old) for now, old in zip(flat, kept, strict=True)]
            best = torch.minimum(told, best)
        steps.step()
        slower.step()
    return list(zip(kept[::2], kept[1::2], strict=True)), float(best.mean())

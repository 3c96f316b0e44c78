"""A joint law of your own: any `torch.nn.Module` that turns loads into deflections, trained and put into the boom."""

from dataclasses import replace

import numpy as np
import torch

import armflex
from armflex.laws.joint.torch_law import TorchLaw

LOAD, TWIST = 1e4, 1e-3  # N and m: networks like numbers near one


def bench(rows: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return scaled loads and deflections of a bearing that stiffens: d = C F (1 - 0.3 |F|^2), with 1 % noise."""
    generator = torch.Generator().manual_seed(0)
    loads = 2.0 * torch.rand((rows, 3), generator=generator, dtype=torch.float64) - 1.0
    compliance = torch.diag(torch.tensor([0.5, 0.5, 0.3], dtype=torch.float64))
    exact = loads @ compliance * (1.0 - 0.3 * loads.square().mean(dim=1, keepdim=True))
    return loads, exact + 0.01 * exact.std() * torch.randn(exact.shape, generator=generator, dtype=torch.float64)


def trained() -> torch.nn.Module:
    """Return a small network that gives nothing without a load: odd functions only, no bias."""
    torch.manual_seed(1)
    layers = torch.nn.Linear(3, 24, bias=False), torch.nn.Tanh(), torch.nn.Linear(24, 3, bias=False)
    network = torch.nn.Sequential(*layers).double()
    loads, deflections = bench(400)
    optimiser = torch.optim.LBFGS(network.parameters(), max_iter=400, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        value = (network(loads) - deflections).square().mean() / deflections.square().mean()
        value.backward()
        return value

    optimiser.step(loss)
    return network


def main() -> float:
    arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "arm.toml")
    law = TorchLaw(trained(), load_scale=LOAD, twist_scale=TWIST)
    bearing = armflex.Flexure("A4 bearing", "A4", law)
    there = arm.position(A2=0.2, A4=-0.3)
    plain = arm.deflection(there, payload="p300")
    found = replace(arm, flexures=(*arm.flexures, bearing)).deflection(there, payload="p300")
    more = float(np.linalg.norm(found.displacement[:3] - plain.displacement[:3]))
    print(f"the bearing carries {found.wrenches[-1][:3].round()} N, gives {found.twists[-1][:3] * 1e3} mm,")
    print(f"and moves the tip by another {more * 1e3:.3f} mm ({found.method}, {len(found.residuals)} residuals)")
    return more


if __name__ == "__main__":
    main()

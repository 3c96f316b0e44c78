"""A `torch.nn.Sequential` of the user's own trained on joint data, see `laws.joint.perceptron`.

Nothing is known of the weights, so none of them has a prior. What keeps a module from following the noise is that it
ends early (Morgan and Bourlard 1990): every start is trained on three quarters of the rows by L-BFGS, the other quarter
determines how long that helps, and the best start is then trained on all rows for as many steps.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from armflex.bench.fitted import Fitted, seen_loads
from armflex.bench.network_problem import scaled_problem
from armflex.conventions import Array
from armflex.errors import LawError, UnsupportedError
from armflex.laws.joint.perceptron import PerceptronLaw, perceptron_of

if TYPE_CHECKING:
    import torch

STEPS, ROUNDS = 10, 50
"""Steps of L-BFGS between two looks at the rows left out, and most such rounds."""


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch use one thread: on matrices as small as a bench's, more of them only wait for each other."""
    try:
        import torch
    except ImportError:
        raise UnsupportedError("to train a torch model needs torch: pip install 'armflex[torch]'") from None
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@_one_thread()
def fit_torch(loads: Array, deflections: Array, make: Callable[[], Any], starts: int = 10, seed: int = 0) -> Fitted:
    """Return a module trained on loads and deflections, from the best of some starts, as layers and weights.

    The law's noise is the scatter of the rows left out; `train` puts that of held-out rows in its place.

    Args:
        loads: (N, k) [N, Nm], k = 3 or 6.
        deflections: (N, k) [m, rad].
        make: Makes a module, whose random first weights follow torch's seed; see `perceptron_of`.
        starts: Modules made.
        seed: Of their weights, and of the rows left out.

    Raises:
        InputError: The loads do not span their components; or what is made is no law.
        UnsupportedError: torch is not installed.
    """
    problem, scaling = scaled_problem(loads, deflections, neurons=1)
    x, unloaded = problem.x, -scaling.input_mean / scaling.input_scale
    y = deflections / scaling.output_scale
    left = np.random.default_rng(seed).permutation(len(x)) < max(2, round(0.25 * len(x)))
    trials = []
    for start in range(starts):
        module = _made(make, seed, start, problem.size)
        trials.append((*_trained(module, unloaded, (x[~left], y[~left]), (x[left], y[left])), start))
    loss, rounds, errors, start = min(trials, key=lambda trial: trial[0])
    if not np.isfinite(loss):
        raise LawError(f"the module gives no finite number while it is trained, from none of {starts} starts")
    module = _made(make, seed, start, problem.size)
    _trained(module, unloaded, (x, y), (x, y), rounds)
    noise = np.sqrt((errors**2).mean(axis=0)) * scaling.output_scale
    scales = scaling.input_mean, scaling.input_scale, scaling.output_scale
    law = PerceptronLaw(perceptron_of(module, problem.size), *scales, noise, seen_loads(loads))
    weights = sum(weight.numel() for weight in module.parameters())
    widths = [problem.size, *(len(layer.bias) for layer in law.layers)]
    said = {"layers": widths, "activations": [layer.activation for layer in law.layers], "weights": weights}
    return Fitted(law, said | {"start": start, "steps": rounds * STEPS})


def _made(make: Callable[[], Any], seed: int, start: int, size: int) -> torch.nn.Module:
    """Return a module with the random weights of a start, in evaluation mode and 64 bits."""
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(np.random.SeedSequence([seed, start]).generate_state(1)[0]))
        module = make()
    perceptron_of(module, size)
    module = copy.deepcopy(module).to("cpu").double().eval()
    if not any(weight.requires_grad for weight in module.parameters()):
        raise LawError("the module has no weights: there is nothing to train")
    return module


def _trained(
    module: torch.nn.Module,
    unloaded: Array,
    rows: tuple[Array, Array],
    watched: tuple[Array, Array],
    rounds: int | None = None,
) -> tuple[float, int, Array]:
    """Train a module in place; return the least loss on the watched rows, after how many rounds, and the errors then.

    Rows and watched are (n, k) scaled loads and deflections, `unloaded` (k,) is no load in that scale. Where `rounds`
    are not given there are as many as help.
    """
    import torch

    zero, x, y, seen, wanted = (torch.from_numpy(np.ascontiguousarray(a)) for a in (unloaded[None], *rows, *watched))
    weights = [weight for weight in module.parameters() if weight.requires_grad]
    search = torch.optim.LBFGS(weights, max_iter=STEPS, line_search_fn="strong_wolfe", history_size=20)

    def loss() -> torch.Tensor:
        search.zero_grad()
        value = (module(x) - module(zero) - y).square().mean()
        value.backward()
        return value

    best: tuple[float, int, Array] = (np.inf, 0, np.full(watched[1].shape, np.inf))
    for done in range(1, (rounds or ROUNDS) + 1):
        search.step(loss)
        with torch.no_grad():
            errors = (module(seen) - module(zero) - wanted).numpy()
        value = float((errors**2).mean())
        if value < best[0]:
            best = value, done, errors
        # Rounds without a better look after which a start ends
        if not np.isfinite(value) or (rounds is None and done - best[1] >= 5):
            break
    return best

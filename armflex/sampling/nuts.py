"""No-U-turn sampling of any density with a gradient, by nutpie, an optional library."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from armflex.conventions import Array
from armflex.errors import NotFiniteError, UnsupportedError

Density = Callable[[Array], tuple[float, Array]]


@dataclass(frozen=True)
class SampledChain:
    """What a chain found after its tuning.

    Attributes:
        draws: (n, d).
        divergences: Trajectories that left the density's level, or met a value that is no number.
        acceptance: Mean acceptance statistic of the trajectories.
    """

    draws: Array
    divergences: int
    acceptance: float


def no_u_turn(
    density: Density,
    start: Array,
    whiten: Array,
    draws: int,
    tune: int,
    seed: np.random.SeedSequence,
    depth: int = 10,
    accept: float = 0.8,
) -> SampledChain:
    """Return a chain of (d,) points distributed as the density says.

    Args:
        density: (d,) point -> its logarithm up to a constant, and the (d,) gradient. It must not raise; where it
            returns NaN the trajectory counts as divergent.
        start: (d,) near the bulk of the density, such as a maximum.
        whiten: (d, d) W; the chain walks in z, point = start + W z. Any regular W is right, a good one is fast.
        draws: Points to keep.
        tune: Further points before them, on which step size and the scale of each z are adapted.
        seed: The same seed gives the same chain.
        depth: Most doublings of a trajectory, of 2^depth steps; it ends before where it turns back.
        accept: Aim of the step size adaptation. The nearer to 1, the shorter the steps and the fewer divergences.

    Raises:
        NotFiniteError: The density is not finite where the chain starts.
        UnsupportedError: nutpie is not installed.
    """
    nutpie, size = _nutpie(), len(start)
    first, rest = seed.generate_state(2)
    # Standard deviation of the chain's first point about the start, in whitened units; nutpie refuses a zero gradient
    origin = 0.1 * np.random.default_rng(first).standard_normal(size)
    value, gradient = density(start + whiten @ origin)
    if not (np.isfinite(value) and np.isfinite(gradient).all()):
        raise NotFiniteError(f"a chain cannot start where its log density is {value}")

    def whitened(z: Array) -> tuple[float, Array]:
        value, gradient = density(start + whiten @ z)
        return value, whiten.T @ gradient

    model = nutpie.compiled_pyfunc.from_pyfunc(
        size,
        lambda: whitened,
        lambda *_: lambda z: {"z": z},
        [np.dtype(np.float64)],
        [(size,)],
        ["z"],
        make_initial_point_fn=lambda _: origin,
    )
    options = {"maxdepth": depth, "target_accept": accept, "cores": 1, "progress_bar": False, "save_warmup": False}
    trace = nutpie.sample(model, draws=draws, tune=tune, chains=1, seed=int(rest), **options)
    walked = start + trace.posterior["z"].values[0] @ whiten.T
    stats = trace.sample_stats
    return SampledChain(walked, int(stats["diverging"].sum()), float(stats["mean_tree_accept"].mean()))


def _nutpie() -> ModuleType:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # arviz announces its next version
            import nutpie
            import nutpie.compiled_pyfunc
    except ImportError:
        raise UnsupportedError("sampling by NUTS needs nutpie: pip install 'armflex[bayes]'") from None
    return nutpie

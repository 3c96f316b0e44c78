"""Effective predictions per second and R-hat of every sampler of a network's posterior, in one run on one core.

Usage: OPENBLAS_NUM_THREADS=1 python tests/benchmarks/samplers.py [--seeds 1]

91 rows of loads as the paper draws them, a compliance with quadratic terms (a full 3 x 3 misses it by about 60 um),
10 um of noise, 20 neurons. Times are the processor's, for which other programs do not count. `effective / s` is that
of the worst of the 273 predictions at the training loads against everything, tuning and second attempts included; where
R-hat is far from 1 it is an upper bound. `covered` is the share of 2000 x 3 exact deflections under new loads inside
the 95 % band of the posterior, `rms` the error there.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine

from armflex.bench.fit_bayesian import SAMPLERS, fit_bayesian
from armflex.bench.fitted import Fitted
from armflex.conventions import Array
from armflex.laws.law import Row

NOISE = 1e-5
COMPLIANCE = np.array([[0.5, 0.05, 0.2], [0.03, 0.8, -0.1], [0.15, -0.1, 0.9]])
CENTRE = np.array([1.9, 0.0, -1.5])
COLUMNS = "seed, sampler, s, R-hat of predictions, of noise, effective, effective / s, divergent, covered, rms [um]"


def made_joint(seed: int, rows: int) -> tuple[Array, Array]:
    """Return loads [N] and exact deflections [m]; the joint is the same for every seed."""
    rng = np.random.default_rng(seed)
    loads = np.stack([rng.uniform(*ends, rows) for ends in ((1.0, 2.8), (-1.1, 1.1), (-2.5, -0.6))], axis=1)
    bent = 0.06 * np.random.default_rng(0).normal(size=(3, 3, 3))
    off = loads - CENTRE
    return 1e3 * loads, 1e-3 * (loads @ COMPLIANCE.T + np.einsum("kij,ni,nj->nk", bent, off, off))


def covered(fitted: Fitted, loads: Array, exact: Array) -> tuple[float, float]:
    """Return the share of exact deflections in the 95 % band, without the noise, and the RMS error [m]."""
    law, wrenches = fitted.law, np.hstack([loads, np.zeros((len(loads), 3))])
    row = Row(np.zeros(0), {})
    errors = law.twist(wrenches, row)[:, :3] - exact
    widening = np.maximum(1.0, law.reach(loads)) ** 2
    variances = np.array([np.diag(law.covariance(wrench, row))[:3] for wrench in wrenches])
    known = np.sqrt(np.maximum(variances / widening[:, None] ** 2 - law.noise**2, 0.0))
    return float((np.abs(errors) < 1.96 * known).mean()), float(np.sqrt((errors**2).mean()))


def rows(seed: int) -> Iterator[str]:
    """Return a line of the table for each sampler."""
    loads, exact = made_joint(seed, 91)
    deflections = exact + NOISE * np.random.default_rng([seed, 1]).normal(size=exact.shape)
    fresh = made_joint(seed + 1000, 2000)
    for sampler in SAMPLERS:
        began = time.process_time()
        fitted = fit_bayesian(loads, deflections, sampler=sampler, seed=seed, allow_unconverged=True)
        seconds = time.process_time() - began
        share, rms = covered(fitted, *fresh)
        yield f"| {seed} | {sampler} | {seconds:.2f} | {_mixing(fitted, seconds)} | {share:.3f} | {1e6 * rms:.1f} |"


def _mixing(fitted: Fitted, seconds: float) -> str:
    judged = fitted.parameters.get("judged")
    if judged is None:
        return "- | - | - | - | -"
    effective = judged["predictions"]["ess_min"]
    rhats = " | ".join(f"{judged[part]['rhat_max']:.4f}" for part in ("predictions", "noise"))
    return f"{rhats} | {effective:.0f} | {effective / seconds:.2f} | {fitted.diagnostics.divergences}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, help="data sets, each with its own noise and starts")
    # The libraries are loaded by a fit that is too small to take time.
    fit_bayesian(*made_joint(0, 9), neurons=1, sampler="nuts", chains=2, draws=4, allow_unconverged=True)
    print(f"| {COLUMNS.replace(',', ' |')} |\n{'|---' * (COLUMNS.count(',') + 1)}|")
    for seed in range(parser.parse_args().seeds):
        for row in rows(seed):
            print(row, flush=True)
    print(f"\n({machine()})")


if __name__ == "__main__":
    main()

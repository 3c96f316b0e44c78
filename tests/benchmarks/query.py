"""One query on a boom of eight joints that sags 30 mm: `arm.deflection`, `arm.prepared`, and the slowest of many calls.

Both are answered by the engine. Beside compliances, networks and effects: a force at the tip, joints that harden, and a
law that is curved and nothing but that (a stiffening joint).

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/query.py
"""

import gc
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, medians_us, rigid_baseline
from boom import Boom, make_boom

from armflex import Arm, Wrench
from armflex.conventions import Array
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.laws.joint.hardening import HardeningLaw
from armflex.laws.joint.network import NetworkLaw

NEURONS, CALLS = 20, 100_000
GOALS = {
    ("linear", "deflection"): 12,
    ("linear, in motion", "deflection"): 60,
    ("linear, a new force", "deflection"): 20,
    ("networks", "deflection"): 30,
    ("linear", "prepared"): 2,
    ("networks", "prepared"): 3,
    ("three effects", "deflection"): 26,
    ("three effects", "prepared"): 26,
}
ENERGY = 5.0
"""Energy [J] at which a joint that hardens gives 1/sqrt(2) of what it gives at first."""
FORCE = (300.0, -200.0, 100.0)
KNOWN = {"temperature": 27.0, "approach_A3": 1.0}


def network_like(compliance: Array, wrench: Array, seed: int) -> NetworkLaw:
    """Return a 6-20-6 network that gives about as a compliance does for loads about a wrench."""
    rng, scale = np.random.default_rng(seed), 1.5 * np.maximum(np.abs(wrench), 0.05 * np.abs(wrench).max())
    hidden, bias = 0.5 * rng.normal(size=(NEURONS, 6)), 0.5 * rng.normal(size=NEURONS)
    loads = rng.uniform(-1.0, 1.0, size=(500, 6))
    twists = (loads * scale) @ compliance.T
    size = np.abs(twists).max(axis=0)
    values = np.hstack([1.0 / (1.0 + np.exp(-loads @ hidden.T - bias)), np.ones((500, 1))])
    weights = np.linalg.lstsq(values, twists / size, rcond=None)[0].T
    zero, precision, seen = np.zeros(6), np.diag(scale**-2), np.array([-2.0, 2.0])[:, None] * scale
    layers = (hidden[None], bias[None], weights[None, :, :-1], weights[None, :, -1])
    return NetworkLaw(*layers, zero, scale, zero, size, 1e-6 * np.ones(6), None, seen, zero, precision, 10.0)


def arms(boom: Boom) -> dict[str, Arm]:
    """Return the boom with compliances, with a network at every joint, and with effects that need covariates."""
    wrenches = boom.arm.deflection(boom.q).wrenches
    pairs = enumerate(zip(boom.arm.flexures, wrenches, strict=True))
    networks = tuple(replace(one, law=network_like(one.law.compliance, load, i)) for i, (one, load) in pairs)
    warm = Effect(EVERY["thermal_growth"], Location("link:A4", None, ("temperature",)), (1.2e-5, 20.0, 0.0))
    soft = Effect(EVERY["thermal_softening"], Location("A2", None, ("temperature",)), (1e-3, 20.0, 0.0))
    play = Effect(EVERY["backlash"], Location("A3", "rz", ("approach_A3",)), (3e-4,))
    harder = tuple(replace(one, law=HardeningLaw(one.law.compliance, ENERGY)) for one in boom.arm.flexures)
    curved = Effect(EVERY["stiffening"], Location("A3", "ry", terms=(0, 1)), (-1e-13, 1e-18))
    return {
        "linear": boom.arm,
        "networks": replace(boom.arm, flexures=networks),
        "an effect": replace(boom.arm, effects=(warm,)),
        "three effects": replace(boom.arm, effects=(warm, soft, play)),
        "hardening": replace(boom.arm, flexures=harder),
        "a curved law": replace(boom.arm, effects=(curved,)),
    }


def ratios(boom: Boom) -> None:
    calls: dict[tuple[str, ...], Callable[[], object]] = {("baseline",): rigid_baseline(boom.arm)}
    for name, arm in arms(boom).items():
        known = KNOWN if arm.effects else {}
        calls[name, "deflection"] = lambda arm=arm, known=known: arm.deflection(boom.q, covariates=known)
        calls[name, ".displacement"] = lambda arm=arm, k=known: arm.deflection(boom.q, covariates=k).displacement
        loop = arm.prepared()
        calls[name, "prepared"] = lambda loop=loop, known=known: loop(boom.q, **known)
    force = [Wrench("tool", FORCE)]
    pushed = boom.arm.prepared(wrenches=force)
    calls["linear, a force", "deflection"] = lambda: boom.arm.deflection(boom.q, wrenches=force).displacement
    calls["linear, a force", "prepared"] = lambda: pushed(boom.q)
    rates = {"v": 0.1 * np.ones(len(boom.q)), "a": 0.2 * np.ones(len(boom.q))}
    calls["linear, a new force", "deflection"] = lambda: boom.arm.deflection(boom.q, wrenches=[Wrench("tool", FORCE)])
    calls["linear, in motion", "deflection"] = lambda: boom.arm.deflection(boom.q, **rates)
    times = medians_us(calls, rounds=60, repeats=None, clock=time.process_time)
    print(f"{'laws':>19} {'asked by':>16} {'x baseline':>10} {'goal':>5}")
    for key, value in list(times.items())[1:]:
        goal = GOALS.get(key, "")
        print(f"{key[0]:>19} {key[1]:>16} {value / times['baseline',]:10.1f} {goal:>5}")


def slowest(boom: Boom, collected: bool) -> None:
    """Print the quantiles and the worst of many calls along a path, and what the process met meanwhile."""
    loop, clock = boom.arm.prepared(), time.perf_counter_ns
    path = boom.q + 0.2 * np.sin(np.linspace(0.0, 20.0, CALLS))[:, None]
    taken = np.empty(CALLS)
    gc.collect()
    (gc.enable if collected else gc.disable)()
    begun, before = gc.get_stats()[2]["collections"], resource.getrusage(resource.RUSAGE_SELF)
    for i, q in enumerate(path):
        start = clock()
        loop(q)
        taken[i] = clock() - start
    after = resource.getrusage(resource.RUSAGE_SELF)
    gc.enable()
    p50, p99, p999 = np.quantile(taken, [0.5, 0.99, 0.999])
    switches, faults = after.ru_nivcsw - before.ru_nivcsw, after.ru_minflt - before.ru_minflt
    over = int((taken > 10.0 * p50).sum())
    full = gc.get_stats()[2]["collections"] - begun
    print(
        f"garbage collector {'on' if collected else 'off':>3}: 99 % within {p99 / p50:.1f} medians, 99.9 %"
        f" within {p999 / p50:.1f}, all within {taken.max() / p50:.0f} ({taken.max() / 1e6:.2f} ms); {over} over 10;"
        f" other processes came between {switches} times, {faults} page faults, {full} full collections"
    )


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        boom = make_boom(Path(folder), drives_only=False, sag=0.03)
        print(repr(boom.arm.deflection(boom.q)))
        ratios(boom)
        print(f"\n{CALLS} calls of the prepared object, exact:")
        for collected in (True, False):
            slowest(boom, collected)


if __name__ == "__main__":
    main()

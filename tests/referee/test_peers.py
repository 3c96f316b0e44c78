"""armflex against the peers of tests/benchmarks on the same bent boom, in their own convention.

Slides and hinges in series, as MuJoCo and Exudyn have them, are single-axis flexures in series; a frame of beams with
springs at its joints is right to first order, so what it misses must fall with the square of the sag.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import peer_solvers as peers
from beam import frame_assembled
from boom import Boom, make_boom

from armflex.conventions import Array


@pytest.fixture(scope="module", params=[True, False], ids=["8 springs", "48 springs"])
def rest(request, tmp_path_factory) -> tuple[Boom, Array]:
    """The boom, and its tip (3,) with 280 mm of sag."""
    boom = make_boom(tmp_path_factory.mktemp("boom"), request.param, 0.28)
    assert boom.freedoms == (8 if request.param else 48)
    return boom, boom.series.deflection(boom.q).pose.translation


@pytest.mark.slow
@pytest.mark.parametrize("solver", [peers.pinocchio_newton, peers.mujoco_fixed_point, peers.exudyn_static])
def test_the_same_rest_as_the_peers(rest, solver):
    if solver is peers.exudyn_static:
        pytest.importorskip("exudyn", reason="pip install 'armflex[bench]'")
    boom, tip = rest
    np.testing.assert_allclose(tip, solver(boom)(), rtol=0, atol=1e-12)


def test_mujoco_stepped_until_it_rests(rest):
    boom, tip = rest
    np.testing.assert_allclose(tip, peers.mujoco_stepped(boom, damping=1.0, step=1.0)(), rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("drives_only", [True, False])
def test_a_frame_of_beams_is_off_by_the_square_of_the_sag(tmp_path, drives_only):
    missed = []
    for sag in (3e-3, 3e-2):
        boom = make_boom(tmp_path, drives_only, sag)
        missed.append(np.linalg.norm(frame_assembled(boom)() - boom.arm.deflection(boom.q).pose.translation))
    assert missed[1] / missed[0] == pytest.approx(100.0, rel=0.1)

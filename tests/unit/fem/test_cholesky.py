"""The factor of a stiffness solves as a dense one does, fills in little, and is refused where something is free."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from armflex.fem.cholesky import CholeskyFactor


def grid(side: int, held: float = 1e-3) -> tuple[sparse.csc_array, np.ndarray]:
    """Return three coupled unknowns at every point of a cube, held softly, and the places."""
    line = sparse.diags_array([np.full(side - 1, -1.0)] * 2, offsets=[-1, 1], shape=(side, side))
    eye = sparse.eye_array(side)
    graph = sum(sparse.kron(sparse.kron(*pair), c) for *pair, c in ((line, eye, eye), (eye, line, eye)))
    graph = graph + sparse.kron(sparse.kron(eye, eye), line)
    laplace = graph + sparse.diags_array(held - graph.sum(axis=0))
    coupled = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 1.5]])
    places = np.stack(np.meshgrid(*[np.arange(float(side))] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return sparse.kron(laplace, coupled, "csc"), np.repeat(places, 3, axis=0)


@settings(max_examples=20, deadline=None)
@given(side=st.integers(1, 7), last=st.integers(0, 6), seed=st.integers(0, 1000))
def test_it_solves_as_a_dense_one(side: int, last: int, seed: int) -> None:
    """With unknowns that have no place and are coupled to many, too, in any order."""
    rng = np.random.default_rng(seed)
    matrix, places = grid(side)
    wide = sparse.random_array((last, len(places)), density=0.3, rng=rng)
    border = sparse.block_array([[matrix, wide.T], [wide, 1e5 * sparse.eye_array(last)]]) if last else matrix
    places = np.vstack([places, np.full((last, 3), np.nan)])
    order = rng.permutation(len(places))
    whole = sparse.csc_array(border)[order][:, order]
    right = rng.normal(size=(len(places), 2))
    found = CholeskyFactor(whole, places[order])
    expected = np.linalg.solve(whole.toarray(), right)
    np.testing.assert_allclose(found.solve(right), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(found.solve(right[:, 0]), expected[:, 0], rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_compact_solid_fills_in_little() -> None:
    """A cube of n unknowns takes about 31 n^(4/3) / 4 numbers in the order of George's dissection."""
    matrix, places = grid(16)
    found = CholeskyFactor(matrix, places)
    kept = sum(np.count_nonzero(front.factor) + front.below.size for front in found.fronts)
    assert kept < 9.0 * 16**4 * 8.0


def test_what_is_free_to_move_is_refused() -> None:
    matrix, places = grid(5, held=0.0)
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        CholeskyFactor(matrix - 1e-9 * sparse.eye_array(len(places)), places)

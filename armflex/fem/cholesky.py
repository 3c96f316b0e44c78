"""Cholesky factors of stiffness matrices whose unknowns have places: nested dissection, and dense fronts.

A compact solid fills in: SuperLU, which SciPy has, takes minutes and 4.6 GB for 40 000 nodes of a cube. Packages that
order better are proprietary (MKL), GPL where they are fast (CHOLMOD), or have no wheels for every system (MUMPS). As
places are known, the ordering is a bisection, and the rest is LAPACK's.

A. George, "Nested dissection of a regular finite element mesh", SIAM J. Numer. Anal. 10 (1973); I. S. Duff and
J. K. Reid, "The multifrontal solution of indefinite sparse symmetric linear equations", ACM TOMS 9 (1983).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import get_blas_funcs
from scipy.linalg.lapack import dpotrf
from scipy.sparse import csgraph, csr_array

from armflex.conventions import Array

dtrsm, dsyrk = get_blas_funcs(("trsm", "syrk"), dtype=np.float64)


class Front(NamedTuple):
    """Unknowns that are eliminated together.

    Attributes:
        own: Where they are among all, in the order of elimination.
        later: (m,) later unknowns that they are coupled to.
        factor: (k, k) lower triangle.
        below: (m, k) rows of the later ones.
    """

    own: slice
    later: np.ndarray
    factor: Array
    below: Array


class CholeskyFactor:
    """The factor of a symmetric positive definite matrix.

    Args:
        matrix: (n, n) sparse.
        places: (n, 3) of its unknowns; those whose place is NaN are eliminated last.
        tick: Is given how many unknowns are eliminated, of how many.

    Raises:
        numpy.linalg.LinAlgError: It is not positive definite.
    """

    def __init__(self, matrix: Any, places: Array, tick: Callable[[int, int], None] = lambda *_: None) -> None:
        tick(0, len(places))
        pieces = _dissected(matrix, places)
        self.order = np.concatenate([unknowns_of for unknowns_of, _ in pieces])
        matrix = matrix[self.order][:, self.order].tocsc()
        matrix.sort_indices()
        self.fronts: list[Front] = []
        waiting: dict[int, tuple[np.ndarray, Array]] = {}  # what a front adds to later ones: unknowns, lower triangle
        end = 0
        for number, (unknowns, inner) in enumerate(pieces):
            start, end = end, end + len(unknowns)
            count, entries = end - start, slice(matrix.indptr[start], matrix.indptr[end])
            rows, each = matrix.indices[entries], np.diff(matrix.indptr[start : end + 1])
            lower, columns = rows >= start, np.repeat(np.arange(count), each)
            added = [waiting.pop(child) for child in inner if child in waiting]
            every = np.unique(np.concatenate([rows[lower], np.arange(start, end), *(those for those, _ in added)]))
            dense = np.zeros((len(every),) * 2, order="F")
            dense[np.searchsorted(every, rows[lower]), columns[lower]] = matrix.data[entries][lower]
            for those, more in added:
                at = np.searchsorted(every, those)
                dense[np.ix_(at, at)] += more
            factor, failed = dpotrf(dense[:count, :count], lower=1)
            if failed:
                raise np.linalg.LinAlgError(f"not positive definite at unknown {self.order[start + failed - 1]}")
            below = dtrsm(1.0, factor, dense[count:, :count], side=1, lower=1, trans_a=1)
            if len(below):
                more = dsyrk(-1.0, below, beta=1.0, c=dense[count:, count:], lower=1)
                waiting[number] = every[count:], more
            self.fronts.append(Front(slice(start, end), every[count:], factor, below))
            tick(end, len(self.order))

    def solve(self, right: Array) -> Array:
        """Return the solution of (n,) or (n, m) right sides."""
        solution = np.array(right, dtype=float).reshape(len(right), -1)[self.order]
        for place, later, factor, below in self.fronts:
            solution[place] = dtrsm(1.0, factor, solution[place], lower=1)
            solution[later] -= below @ solution[place]
        for place, later, factor, below in reversed(self.fronts):
            solution[place] = dtrsm(1.0, factor, solution[place] - below.T @ solution[later], lower=1, trans_a=1)
        back = np.empty_like(solution)
        back[self.order] = solution
        return back.reshape(np.shape(right))


def _dissected(matrix: Any, places: Array) -> list[tuple[np.ndarray, list[int]]]:
    """Return unknowns that are eliminated together, and the numbers of the pieces just inside of each, those first."""
    placed = ~np.isnan(places).any(axis=1)
    points, group = np.unique(places[placed], axis=0, return_inverse=True)
    size, unknowns = len(points), np.flatnonzero(placed)[np.argsort(group.ravel(), kind="stable")]
    starts = np.concatenate([[0], np.cumsum(np.bincount(group.ravel(), minlength=size))])
    member = csr_array((np.ones(len(group), bool), (group.ravel(), np.flatnonzero(placed))), (size, len(places)))
    pieces: list[tuple[np.ndarray, list[int]]] = []

    def piece(nodes: np.ndarray, inner: list[int]) -> list[int]:
        if not len(nodes):
            return inner
        pieces.append((np.concatenate([unknowns[starts[node] : starts[node + 1]] for node in nodes]), inner))
        return [len(pieces) - 1]

    def divided(graph: Any, points: Array, nodes: np.ndarray) -> list[int]:
        # Places that are not divided further
        if len(nodes) <= 60:
            return piece(nodes, [])
        along = np.argsort(points[:, np.ptp(points, axis=0).argmax()], kind="stable")
        low, high = np.sort(along[: len(along) // 2]), np.sort(along[len(along) // 2 :])
        between = np.zeros(len(nodes), bool)
        across = graph[low][:, high]
        left, right = np.flatnonzero(np.diff(across.indptr)), np.unique(across.indices)
        of_left, of_right = _cover(across[left][:, right])
        between[low[left[of_left]]] = between[high[right[of_right]]] = True
        halves = [half[~between[half]] for half in (low, high)]
        inner = [child for half in halves for child in divided(graph[half][:, half], points[half], nodes[half])]
        return piece(nodes[between], inner)

    outer = divided((member @ (abs(matrix) > 0.0) @ member.T).tocsr(), points, np.arange(size))
    return pieces if placed.all() else [*pieces, (np.flatnonzero(~placed), outer)]


def _cover(graph: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return which rows and columns of a bipartite graph are fewest that touch every edge (Konig's theorem)."""
    rows, columns = graph.shape
    partner = csgraph.maximum_bipartite_matching(graph, perm_type="column")
    alone, matched = np.flatnonzero(partner < 0), np.flatnonzero(partner >= 0)
    edges = graph.tocoo()  # alternating paths begin, from one node more, at rows that have no partner
    start = np.concatenate([edges.coords[0], rows + partner[matched], np.full(len(alone), rows + columns)])
    end = np.concatenate([rows + edges.coords[1], matched, alone])
    paths = csr_array((np.ones(len(start), bool), (start, end)), (rows + columns + 1,) * 2)
    met = np.zeros(rows + columns + 1, bool)
    met[csgraph.breadth_first_order(paths, rows + columns, return_predecessors=False)] = True
    return ~met[:rows], met[rows:-1]

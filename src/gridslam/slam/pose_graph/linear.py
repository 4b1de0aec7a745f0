"""The sparse linear systems of GraphSLAM, and the initial guess of all poses that two of them give.

Normal equations whose pattern is found once and whose numbers change.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

_REFINEMENTS = 5
"""Iterations for the initial headings: each is one solution with the existing factorization, and few are enough."""


class MatrixBlocks(NamedTuple):
    """Contributions of M measurements to the normal equations, in blocks of `size` unknowns for each pose.

    Attributes
    ----------
    first, second : (M, size, size) float64
        Of the two poses that the measurement joins.
    cross : (M, size, size) float64
        Rows of the first pose, columns of the second.
    gradient_first, gradient_second : (M, size) float64
        Half the derivative of chi2.
    """

    first: FloatArray
    cross: FloatArray
    second: FloatArray
    gradient_first: FloatArray
    gradient_second: FloatArray


def linearize(graph: PoseGraph, poses: FloatArray, errors: FloatArray) -> MatrixBlocks:
    """Blocks J' information J and J' information e of the errors e (M, 3) at poses (N, 3).

    Unknowns are the poses' coordinates. The error sees the difference d of the positions only turned by the first
    heading: with R the rotation from the map to the frame in which the measurement ends, its Jacobians are
    J_second = diag(R, 1) and J_first = -J_second (I with the third column l), l = (-d_y, d_x, 1). So the blocks of the
    first pose are those of the second, with the third row or column replaced by the product with l.

    Source: Grisetti et al., A tutorial on graph-based SLAM (2010), equations 32 and 33.
    """
    first, second = graph.edges.T
    heading = poses[first, 2] + graph.measurements[:, 2]
    c = np.cos(heading)
    s = np.sin(heading)
    at_second = _turned(graph.information, c, s)
    gradient = np.matmul(graph.information, errors[:, :, None])[:, :, 0]
    gradient[:, 0], gradient[:, 1] = c * gradient[:, 0] - s * gradient[:, 1], s * gradient[:, 0] + c * gradient[:, 1]

    x = poses[first, 1] - poses[second, 1]
    y = poses[second, 0] - poses[first, 0]
    lever = at_second[:, :, 0] * x[:, None] + at_second[:, :, 1] * y[:, None] + at_second[:, :, 2]
    cross = -at_second
    at_first = at_second.copy()
    gradient_first = -gradient
    cross[:, 2, :] = -lever
    at_first[:, 2, :] = at_first[:, :, 2] = lever
    at_first[:, 2, 2] = x * lever[:, 0] + y * lever[:, 1] + lever[:, 2]
    gradient_first[:, 2] -= x * gradient[:, 0] + y * gradient[:, 1]
    return MatrixBlocks(at_first, cross, at_second, gradient_first, gradient)


def _turned(information: FloatArray, c: FloatArray, s: FloatArray) -> FloatArray:
    """diag(R, 1)' information diag(R, 1) for rotations R = (c, s; -s, c), (M,) each; matrix products are slower."""
    turned = information.copy()
    (xx, xy, xt), (_, yy, yt), _ = information.transpose(1, 2, 0)
    turned[:, 0, 0] = c * c * xx - 2 * c * s * xy + s * s * yy
    turned[:, 1, 1] = s * s * xx + 2 * c * s * xy + c * c * yy
    turned[:, 0, 1] = turned[:, 1, 0] = c * s * (xx - yy) + (c * c - s * s) * xy
    turned[:, 0, 2] = turned[:, 2, 0] = c * xt - s * yt
    turned[:, 1, 2] = turned[:, 2, 1] = s * xt + c * yt
    return turned


def require_connected(edges: IntArray, poses: int) -> None:
    """Raise ArgumentError, saying in how many parts and who is apart, if `edges` (M, 2) do not join all poses."""
    part = find_parts(edges, poses)
    apart = np.flatnonzero(part != part[0])
    if len(apart):
        some = ", ".join(map(str, apart[:10].tolist())) + (", ..." if len(apart) > 10 else "")
        got = f"{part.max() + 1} parts: {len(apart)} poses cannot be reached from pose 0 ({some})"
        raise ArgumentError("graph", "measurements that join all poses", got)


def find_parts(edges: IntArray, poses: int) -> IntArray:
    """Label (N,) of the connected part, from 0 on, in which `edges` (M, 2) put each pose."""
    from scipy.sparse import coo_matrix  # only who closes loops pays for their import
    from scipy.sparse.csgraph import connected_components

    joined = coo_matrix((np.ones(len(edges)), edges.T), (poses, poses))
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)


@final
class BlockSystem:
    """Sparse symmetric systems H x = b of one pattern: `size` unknowns for each pose that is not held.

    The upper triangle of H is kept by columns. All that depends on the pattern (where each number goes, the order of
    elimination, the structure of the factor) is found once; then a solution costs a numeric factorization.

    Parameters
    ----------
    edges : (M, 2) int64
        Places of the two poses that each measurement joins; together they join all poses.
    poses : int
        N > held.
    size : int
        Unknowns of a pose, >= 1.
    held : int
        Poses that are held, >= 1.
    """

    def __init__(self, edges: IntArray, poses: int, size: int, held: int = 1) -> None:
        self.size = size
        self.held = held
        self.free = poses - held
        self._first, self._second = np.maximum(edges - held, -1).T  # as free poses; -1 stands for all that are held
        self._upper = np.triu_indices(size)
        self._solver: Any = None
        low = np.minimum(self._first, self._second)
        high = np.maximum(self._first, self._second)
        none = self.free * self.free  # stands for all pairs with a pose that is held, after all others
        pairs, place = np.unique(np.where(low < 0, none, high * self.free + low), return_inverse=True)
        self._lay_out(pairs[pairs < none], place)

    def _lay_out(self, pairs: IntArray, place: IntArray) -> None:
        """Find where the numbers of each block go: column by column, the blocks above the diagonal, then its own."""
        from scipy.sparse import csc_matrix

        size = self.size
        free = self.free
        local = np.arange(self.size)[:, None]
        column, row = np.divmod(pairs, free)
        above = np.bincount(column, minlength=free)
        ends = np.cumsum(above[:, None] * size + local.T + 1)
        begin = np.concatenate(([0], ends[:-1])).reshape(free, 1, size)
        rank = np.arange(len(column)) - (np.cumsum(above) - above)[column]
        crossing = begin[column] + (rank * size)[:, None, None] + local
        diagonal = begin + (above * size)[:, None, None] + local

        indices = np.empty(ends[-1], np.int32)
        indices[crossing] = (row * size)[:, None, None] + local
        own = np.broadcast_to((np.arange(free) * size)[:, None, None] + local, diagonal.shape)
        indices[self._of_upper(diagonal)] = self._of_upper(own)
        self._pivots = ends - 1  # the diagonal's numbers end the columns
        self._matrix = csc_matrix((np.zeros(len(indices)), indices, np.concatenate(([0], ends))))

        spare = len(indices)  # takes what belongs to poses that are held
        crossing = np.concatenate((crossing, np.full((1, size, size), spare)))[place]
        backward = self._first > self._second  # then the block lies transposed above the diagonal
        crossing[backward] = crossing[backward].transpose(0, 2, 1)
        diagonal = np.concatenate((self._of_upper(diagonal), np.full((1, len(self._upper[0])), spare)))
        self._slots = np.concatenate((diagonal[self._first], crossing, diagonal[self._second]), axis=None)

    def _of_upper(self, blocks: Any) -> Any:  # noqa: ANN401 the numbers' type is that of the blocks
        return blocks[:, self._upper[0], self._upper[1]]

    def assemble(self, blocks: MatrixBlocks) -> tuple[FloatArray, FloatArray]:
        """Sum blocks to the numbers of H and to the gradient (free * size,)."""
        numbers = np.concatenate((self._of_upper(blocks.first), blocks.cross, self._of_upper(blocks.second)), axis=None)
        matrix = np.bincount(self._slots, numbers, len(self._matrix.indices) + 1)[:-1]
        of_poses = np.concatenate((self._first, self._second)) + 1
        terms = np.concatenate((blocks.gradient_first, blocks.gradient_second))
        gradient = [np.bincount(of_poses, column, self.free + 1)[1:] for column in terms.T]
        return np.asarray(matrix, np.float64), np.asarray(np.stack(gradient, axis=1).ravel(), np.float64)

    def factorize(self, matrix: FloatArray, damping: float = 0.0) -> None:
        """Factorize H + damping diag(H) for `solve`, from the numbers that `assemble` returns.

        Raises ArgumentError where rounding leaves nothing of H that can be factorized: the numbers differ too much.
        """
        import qdldl

        self._matrix.data[:] = matrix
        self._matrix.data[self._pivots] *= 1.0 + damping
        try:
            if self._solver is None:
                self._solver = qdldl.Solver(self._matrix, upper=True)
            else:
                self._solver.update(self._matrix, upper=True)
        except RuntimeError:
            diagonal = self._matrix.data[self._pivots]
            got = f"a diagonal of the normal equations from {diagonal.min():g} to {diagonal.max():g}"
            raise ArgumentError("graph", "information matrices that 64-bit numbers can add up", got) from None

    def solve(self, right_side: FloatArray) -> FloatArray:
        """Solve for one right side (free * size,) with the last factorization; returns (N, size), 0 where held."""
        solution: FloatArray = np.zeros((self.held + self.free, self.size))
        solution[self.held :] = self._solver.solve(right_side).reshape(-1, self.size)
        return solution

    def factors(self) -> Any:  # noqa: ANN401 scipy's sparse matrix
        """Return L without its unit diagonal, the diagonal D and the order p of elimination: H[p, p] = L D L'."""
        return self._solver.factors()


def initial_guess(graph: PoseGraph) -> FloatArray:
    """Poses (N, 3) near the least chi2, from the measurements and the poses that are held.

    Headings come first, as unit vectors r: r_j = R(z) r_i is linear, so without the constraint |r| = 1 the weighted
    least squares is one linear system (chordal relaxation; Martinec and Pajdla 2007, Carlone et al. 2015). Anchored at
    what is held it shrinks vectors the more the farther they are, so it is solved again with the unit vectors as right
    side: inverse iteration towards the least eigenvector, all of whose vectors are of like length (Singer 2011). Then
    chi2 is quadratic in the positions: a second linear system of the same pattern.

    Raises
    ------
    ArgumentError
        The measurements do not join all poses.
    """
    require_connected(graph.edges, len(graph.poses))
    held = graph.held
    if len(graph.poses) == held:
        return graph.poses.copy()
    system = BlockSystem(graph.edges, len(graph.poses), 2, held)
    poses = np.zeros_like(graph.poses)
    poses[:held] = graph.poses[:held]
    poses[held:, 2] = _headings(graph, system)[held:]
    first, cross, second, *gradients = linearize(graph, poses, graph.errors(poses))
    of_positions = MatrixBlocks(*(b[:, :2, :2] for b in (first, cross, second)), *(g[:, :2] for g in gradients))
    matrix, gradient = system.assemble(of_positions)
    system.factorize(matrix)
    poses[:, :2] += system.solve(-gradient)
    return poses


def _headings(graph: PoseGraph, system: BlockSystem) -> FloatArray:
    """Headings (N,) by chordal relaxation."""
    first, second = graph.edges.T
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = graph.information.transpose(1, 2, 0)
    weight = tt - (xx * yt * yt - 2 * xy * xt * yt + yy * xt * xt) / (xx * yy - xy * xy)  # 1 / variance of the heading
    c = weight * np.cos(graph.measurements[:, 2])
    s = weight * np.sin(graph.measurements[:, 2])
    own = weight[:, None, None] * np.eye(2)
    cross = -np.stack((c, s, -s, c), axis=1).reshape(-1, 2, 2)  # -weight R(z)'
    unit = np.zeros((len(graph.poses), 2, 1))
    headings = graph.poses[: graph.held, 2]
    unit[: graph.held, :, 0] = np.stack((np.cos(headings), np.sin(headings)), axis=1)
    anchored = np.matmul(cross, unit[second]), np.matmul(cross.transpose(0, 2, 1), unit[first])
    matrix, gradient = system.assemble(MatrixBlocks(own, cross, own, anchored[0][:, :, 0], anchored[1][:, :, 0]))
    system.factorize(matrix)
    vectors = system.solve(-gradient)
    for _ in range(_REFINEMENTS):
        free = vectors[graph.held :]
        lengths = np.hypot(free[:, 0], free[:, 1])
        vectors = system.solve((free / np.maximum(lengths, 1e-300)[:, None]).ravel())
    return np.asarray(np.arctan2(vectors[:, 1], vectors[:, 0]))

"""Exercise 9: GraphSLAM on a pose graph

Grisetti, Kümmerle, Stachniss, Burgard, *A tutorial on graph-based SLAM* (ITSM 2010); *Probabilistic Robotics*, chapter
11.
"""

# %% [markdown]
# Poses $x_i$ are nodes. An edge measures the pose of $j$ seen from $i$ as $z_{ij}$ with information $\Omega_{ij}$. Its
# error is the pose of the one seen from the other, compared with the measurement:
#
# $$ e_{ij} = z_{ij}^{-1} (x_i^{-1} x_j), \qquad \chi^2 = \sum e_{ij}^\top \Omega_{ij} \, e_{ij} $$
#
# With $R_i, R_z$ the rotations of $x_i$ and $z_{ij}$, and $t$ the positions,
#
# $$ e_t = R_z^\top (R_i^\top (t_j - t_i) - t_z), \qquad e_\theta = \theta_j - \theta_i - \theta_z $$
#
# Write the error and its Jacobians $A$ by $x_i$ and $B$ by $x_j$. `between(a, b)` of gridslam is $a^{-1} b$.

# %%
import math

import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between


# %% [task]
def linearize(x_i, x_j, z):
    """Error of an edge and its Jacobians.

    Parameters
    ----------
    x_i, x_j, z : (3,) float64
        Poses [x m, y m, theta rad], and the measurement.

    Returns
    -------
    e : (3,) float64
        Heading in [-pi, pi).
    A, B : (3, 3) float64
        Derivatives by x_i and by x_j.
    """
    angle = x_i[2] + z[2]
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])  # (R_i R_z)'
    B = np.eye(3)
    B[:2, :2] = turn
    A = -B
    dx, dy = x_j[:2] - x_i[:2]
    A[:2, 2] = turn @ [dy, -dx]
    return between(z, between(x_i, x_j)), A, B


# %%
checks.edge_jacobians(linearize)
print("passed")

# %% [markdown]
# Gauss-Newton: collect $H = \sum J^\top \Omega J$ and $b = \sum J^\top \Omega e$ over the edges, where $J$ has the
# blocks $A$ and $B$ in the columns of $i$ and $j$; solve $H \Delta = -b$; add $\Delta$; repeat. All poses can be
# moved together without a change of $\chi^2$, so $H$ is singular: pose 0 stays where it is.


# %% [task]
def solve(graph):
    """Poses at which chi2 is least.

    Parameters
    ----------
    graph : PoseGraph
        poses (N, 3), edges (M, 2) = [i, j], measurements (M, 3), information (M, 3, 3).

    Returns
    -------
    (N, 3) float64
        Pose 0 as it was; headings in [-pi, pi) (`wrap`).
    """
    poses = graph.poses.copy()
    size = 3 * len(poses)
    for _ in range(30):
        H = np.zeros((size, size))
        b = np.zeros(size)
        for (i, j), z, omega in zip(graph.edges, graph.measurements, graph.information, strict=True):
            e, A, B = linearize(poses[i], poses[j], z)
            J = np.zeros((3, size))
            J[:, 3 * i : 3 * i + 3] = A
            J[:, 3 * j : 3 * j + 3] = B
            H += J.T @ omega @ J
            b += J.T @ omega @ e
        step = np.zeros(size)
        step[3:] = np.linalg.solve(H[3:, 3:], -b[3:])
        poses[1:] += step.reshape(-1, 3)[1:]
        poses[1:, 2] = wrap(poses[1:, 2])
        if np.abs(step).max() < 1e-10:
            break
    return poses


# %%
checks.graph_solver(solve)
print("passed")

# %%
graph, truth = checks.ring_graph(np.random.default_rng(4), noise=2.0)
solved = solve(graph)
for poses, style in ((graph.poses, "C1.-"), (solved, "C0.-"), (truth, "k:")):
    plt.plot(*poses[:, :2].T, style)
for i, j in graph.edges[29:]:
    plt.plot(*solved[[i, j], :2].T, "C2")
plt.legend(["dead reckoning", f"solved, chi2 {graph.chi2(solved):.0f}", "truth", "closures"])
plt.axis("equal")
plt.show()

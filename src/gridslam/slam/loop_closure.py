"""Loop closure: an old place recognized corrects the trajectory, and the corrected map goes back into the filter."""

from __future__ import annotations

import math
from dataclasses import replace
from threading import Thread
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.constraints import Constraint
from gridslam.slam.drift_model import DriftModel
from gridslam.slam.graph_robust import GraduatedNonConvexity
from gridslam.slam.graph_slam import GraphSlam
from gridslam.slam.incremental import worked
from gridslam.slam.key_graph import BLOCK
from gridslam.slam.loop_closure_state import Correction, LoopClosureState, PendingConstraints, RejectionReason
from gridslam.slam.place_recognition import PlaceRecognition
from gridslam.slam.state import GridFastSlamState
from gridslam.slam.submaps import draw
from gridslam.types import BeamEnds, StepReport

__all__ = ["LoopClosure"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class LoopClosure:
    """Remember, recognize, solve, draw, merge.

    When the graph, solved with a place just recognized, puts the robot elsewhere than the filter does, the filter's
    past is replaced: all particles are reseeded on the graph's most likely trajectory, with equal weights and the one
    map drawn from it. This is Laplace's approximation of p(x_1:t | z_1:t, u_1:t) with the closure among the
    measurements, collapsed to its mode: given a map drawn from the corrected past, the newest pose is certain within a
    matcher's basin (the closure was matched), and the motion model spreads the particles again. Particles that differ
    only in how they would have closed this loop have nothing left to be weighed by, hence equal weights.

    The graph is solved aside, some linear systems at each new scan, and then the corrected map is drawn aside,
    `scans_per_step` key scans at each new one, so that no scan waits for either: the map is merged a number of scans
    after the closure was found that depends on counts alone, never on time.

    Parameters
    ----------
    recognition : PlaceRecognition
        Which places are recognized.
    solver : GraphSlam
        How the graph is solved.
    drift : DriftModel
        How uncertain tracked motion is.
    disagree_m, disagree_rad : float
        Where the filter has the recognized places within this it closed the loop itself, and is left alone.
    scans_per_step : int
        Key scans of the corrected map drawn at each new key scan, 0.3 ms each.
    poses_per_scan : int
        Poses solved for at each new scan, 1 us each; never less than one linear system of them all.
    """

    recognition: PlaceRecognition = PlaceRecognition()
    solver: GraphSlam = GraphSlam(first_guess="given", robust=GraduatedNonConvexity())
    drift: DriftModel = DriftModel()
    disagree_m: float = Field(default=0.3, gt=0)
    disagree_rad: float = Field(default=0.05, gt=0)
    scans_per_step: int = Field(default=60, ge=2)
    poses_per_scan: int = Field(default=8000, ge=1)

    def init(self, state: GridFastSlamState, beams: BeamEnds) -> None:
        """Begin with the filter's first scan."""
        state.memory = memory = LoopClosureState()
        memory.scans.append(beams, state.tracker.pose, is_key=True)
        memory.said.append(state.poses[state.best])
        memory.graph.extend(state.key_pose, state.poses[state.best], self.drift.variances(0.0, 0.0))

    def __call__(
        self,
        state: GridFastSlamState,
        memory: LoopClosureState,
        report: StepReport,
        beams: BeamEnds,
        mapper: OccupancyGridMapping,
        threads: int,
    ) -> StepReport:
        """Take note of a scan that the filter has taken; may correct `state`, and says so in the report."""
        memory.scans.append(beams, state.tracker.pose, is_key=report.skipped is None)
        ties = [] if memory.weighing is None else self._weigh(memory, memory.weighing, mapper, threads)
        if report.skipped is not None:
            return replace(report, closures=_ends(ties)) if ties else report
        self._remember(memory, state)
        if len(memory.graph) == BLOCK:  # long before a place can be an old one
            Thread(target=self.solver.prepare).start()
        found = self.recognition(memory, mapper)
        if found and memory.weighing is None and memory.correction is None and self._disagrees(memory, found, state):
            memory.weighing = PendingConstraints(len(memory.graph), len(memory.graph.ties), len(found))
        else:
            ties = ties + found
        corrected = memory.correction is not None and self._draw(memory, memory.correction, state)
        return replace(report, pose=state.poses[state.best], closures=_ends(ties), corrected=corrected)

    def _remember(self, memory: LoopClosureState, state: GridFastSlamState) -> None:
        """Add the newest key scan, where it was tracked to."""
        graph = memory.graph
        moved = between(graph.tracked[-1], state.key_pose)
        position, heading = self.drift.variances(math.hypot(moved[0], moved[1]), abs(float(moved[2])))
        doubts, before = (state.tracker.doubt_m2, state.tracker.doubt_rad2), memory.doubts
        memory.doubts = doubts
        times = self.drift.doubt**2
        spread = position + times * (doubts[0] - before[0]), heading + times * (doubts[1] - before[1])
        graph.extend(state.key_pose, compose(graph.poses[-1], moved), spread)
        memory.said.append(state.poses[state.best])

    def _disagrees(self, memory: LoopClosureState, ties: list[Constraint], state: GridFastSlamState) -> bool:
        """Whether the filter's best trajectory contradicts what was recognized."""
        trajectory = state.ancestry.trajectory(state.best)
        has = between(trajectory[[tie.from_ for tie in ties]], trajectory[[tie.to for tie in ties]])
        missed = between(has, np.array([tie.measurement for tie in ties]))
        far = np.hypot(missed[:, 0], missed[:, 1]) > self.disagree_m
        return bool((far | (np.abs(missed[:, 2]) > self.disagree_rad)).any())

    def _weigh(
        self, memory: LoopClosureState, weighing: PendingConstraints, mapper: OccupancyGridMapping, threads: int
    ) -> list[Constraint]:
        """Solve the graph a little more; at the end begin to draw the corrected past, and return the new ties.

        None are returned before the end, and none if the graph doubts them.
        """
        graph = memory.graph
        if weighing.work is None:
            weighing.work = self.solver.solving(graph.graph(keys=weighing.keys, ties=weighing.ties))
            worked(weighing.work, weighing.steps)
        steps = max(1, min(8, self.poses_per_scan // weighing.keys))
        weighing.steps += steps
        solution = worked(weighing.work, steps)
        if solution is None:
            return []
        memory.weighing = None
        poses = graph.continued(solution.poses)
        new = slice(weighing.ties - weighing.new, weighing.ties)
        true = solution.weights[-weighing.new :] >= 0.5
        ties = [tie for tie, is_true in zip(graph.ties[new], true.tolist(), strict=True) if is_true]
        memory.rejected[RejectionReason.IMPLAUSIBLE] += weighing.new - len(ties)
        if 2 * len(ties) <= weighing.new:  # what else is known speaks against the closure
            ties = []
        graph.ties[new] = ties
        if ties:
            memory.correction = Correction(poses, mapper.empty(1, threads))
        memory.correct(poses)
        return ties

    def _draw(self, memory: LoopClosureState, correction: Correction, state: GridFastSlamState) -> bool:
        """Draw on; when all is drawn, merge. Returns whether it was merged."""
        correction.poses = poses = memory.graph.continued(correction.poses)
        last = min(correction.drawn + self.scans_per_step, len(poses))
        draw(correction.maps, memory.scans, range(correction.drawn, last), poses[correction.drawn : last])
        correction.drawn = last
        if last < len(poses):
            return False
        memory.correct(poses)
        memory.said = list(poses)
        state.reseed(poses, correction.maps)
        memory.correction = None
        return True


def _ends(ties: list[Constraint]) -> tuple[tuple[int, int], ...]:
    return tuple((tie.from_, tie.to) for tie in ties)

"""Laws that the algorithms of the exercises fulfil, one module for each exercise.

gridslam's own tests call the same functions.

Each check takes an implementation as a function, and raises AssertionError where the law does not hold, with a sentence
that names the mistake where it is a typical one (`wrong_solutions.json` lists these).
"""

from __future__ import annotations

from checks.ekf_localization import correction_is_linearized, differences, prediction_is_linearized
from checks.ekf_slam import (
    RING,
    drive_in_a_circle,
    landmark_is_added,
    ring_is_mapped,
    slam_correction,
    slam_is_the_kalman_filter,
    slam_prediction,
)
from checks.fastslam import landmark_update, log_densities, particles_find_the_kalman_filter, proposal
from checks.gmapping_node import (
    PARAMETERS,
    map_message,
    map_to_odometry,
    node_maps_the_rooms,
    planar_pose,
    scan_message,
    simulated_bag,
    update_rule,
)
from checks.grid_fastslam import (
    BAND_M,
    effective_sample_size,
    fastslam_step,
    poor_drive,
    poor_odometry_is_corrected,
    recorded,
    survivors_keep_their_maps,
    worst_error,
)
from checks.monte_carlo_localization import (
    LOW_VARIANCE,
    RESAMPLING_CASES,
    WHEEL,
    counts_are_expected,
    low_variance_resampler,
    mcl_weights,
    office,
    office_map,
    poses_are_uniform,
    resampling,
    robot_is_found,
    robot_is_tracked,
    z_scores,
)
from checks.motion_models import odometry_motion, samples_have_moments
from checks.occupancy_grid_mapping import (
    BAYES_CASES,
    along,
    binary_bayes_filter,
    cell_follows_bayes_rule,
    ray_is_connected,
    ray_is_straight,
    rays,
)
from checks.pose_graphs import edge_jacobians, graph_solver, is_a_minimum, ring_graph
from checks.scan_matching import displacement_is_found, distance_in_room, ends_in_room, scan_jacobian, scan_matcher
from checks.sensor_models import beam_densities_sum_to_one, beam_model, likelihood_field

__all__ = [
    "BAND_M",
    "BAYES_CASES",
    "LOW_VARIANCE",
    "PARAMETERS",
    "RESAMPLING_CASES",
    "RING",
    "WHEEL",
    "along",
    "beam_densities_sum_to_one",
    "beam_model",
    "binary_bayes_filter",
    "cell_follows_bayes_rule",
    "correction_is_linearized",
    "counts_are_expected",
    "differences",
    "displacement_is_found",
    "distance_in_room",
    "drive_in_a_circle",
    "edge_jacobians",
    "effective_sample_size",
    "ends_in_room",
    "fastslam_step",
    "graph_solver",
    "is_a_minimum",
    "landmark_is_added",
    "landmark_update",
    "likelihood_field",
    "log_densities",
    "low_variance_resampler",
    "map_message",
    "map_to_odometry",
    "mcl_weights",
    "node_maps_the_rooms",
    "odometry_motion",
    "office",
    "office_map",
    "particles_find_the_kalman_filter",
    "planar_pose",
    "poor_drive",
    "poor_odometry_is_corrected",
    "poses_are_uniform",
    "prediction_is_linearized",
    "proposal",
    "ray_is_connected",
    "ray_is_straight",
    "rays",
    "recorded",
    "resampling",
    "ring_graph",
    "ring_is_mapped",
    "robot_is_found",
    "robot_is_tracked",
    "samples_have_moments",
    "scan_jacobian",
    "scan_matcher",
    "scan_message",
    "simulated_bag",
    "slam_correction",
    "slam_is_the_kalman_filter",
    "slam_prediction",
    "survivors_keep_their_maps",
    "update_rule",
    "worst_error",
    "z_scores",
]

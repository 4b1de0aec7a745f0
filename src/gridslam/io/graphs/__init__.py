"""Pose graphs in the format of g2o."""

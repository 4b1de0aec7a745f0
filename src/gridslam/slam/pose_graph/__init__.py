"""Pose graphs: GraphSLAM, its robust kernels and marginals."""

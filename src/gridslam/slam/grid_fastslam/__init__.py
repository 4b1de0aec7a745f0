"""Grid-based FastSLAM (GMapping): the filter, its state and its parts."""

"""The tasks in one call each, from a log to a result; `gridslam` itself has the names."""

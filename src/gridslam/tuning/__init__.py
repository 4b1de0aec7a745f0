"""Tuning: a search for parameters that suit given logs, judged on others, by `gridslam tune`."""

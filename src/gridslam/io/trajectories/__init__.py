"""Trajectories and relations between poses."""

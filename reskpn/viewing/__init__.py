"""Recorded trajectories looked at: as a film, in MuJoCo's web viewer, and in Foxglove. Needs no JAX."""

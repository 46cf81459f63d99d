"""Results of a solve: trajectories, their quality, dense rollouts, mesh refinement, plots."""

"""What a solve gives back: trajectories, how good they are, dense rollouts, finer meshes, pictures."""

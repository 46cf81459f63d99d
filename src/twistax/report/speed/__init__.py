"""What one evaluation of dynamics costs, ours and those of others, checked against each other first."""

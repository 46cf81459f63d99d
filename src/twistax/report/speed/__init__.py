"""What one evaluation of dynamics costs, by this package and by others, whose results are compared first."""

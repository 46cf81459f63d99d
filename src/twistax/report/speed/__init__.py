"""The cost of one evaluation of dynamics, by this package and by others, whose results are compared first."""

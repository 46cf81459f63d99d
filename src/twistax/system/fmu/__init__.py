"""Export of compiled systems as functional mock-up units (FMUs), FMI 3.0."""

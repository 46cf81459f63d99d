"""Events: conditions along an integration, the search for their roots, and what follows there."""

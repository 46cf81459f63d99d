"""Controllers of mechanisms by tasks."""

"""Reports on accuracy, stability and speed, which commands print."""

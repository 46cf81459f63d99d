"""The harness of all reports: measurements, what is asked of them, how they are timed and kept, and pages."""

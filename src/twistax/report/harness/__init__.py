"""The harness of all reports: measurements, expected results, timing, storage, and pages."""

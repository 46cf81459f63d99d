"""What docs/measured.md says, figure by figure: sections of checks."""

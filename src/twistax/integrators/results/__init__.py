"""What an integration returns."""

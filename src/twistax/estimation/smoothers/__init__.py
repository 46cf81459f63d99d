"""Smoothers: estimates that use measurements of later times, too."""

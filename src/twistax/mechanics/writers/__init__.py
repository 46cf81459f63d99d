"""Mechanisms as text: URDF and MJCF."""

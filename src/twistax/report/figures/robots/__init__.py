"""Figures of robots: dynamics, distances, inverse kinematics and control."""

"""Inverse kinematics of mechanisms."""

"""Mechanisms from model files."""

from .load import load

__all__ = ["load"]

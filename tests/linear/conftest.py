"""These tests share systems with those of trajectories."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent.parent / "trajectory"))

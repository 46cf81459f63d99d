"""Estimators of states from measurements, on groups: filters, a smoother, and tests of their covariances."""

from .consistency import Consistency, Verdict, consistency
from .error_state_kalman import ErrorStateKalman
from .filter import Estimate, Filter, Prediction
from .filter_run import FilterRun, Innovations
from .measurement import Measurement
from .observability import Observability
from .smoother import RauchTungStriebel, Smoothed
from .unscented_kalman import UnscentedKalman
from .update import Update

# fmt: off
__all__ = [
    "Consistency", "ErrorStateKalman", "Estimate", "Filter", "FilterRun", "Innovations", "Observability",
    "Prediction", "RauchTungStriebel", "Smoothed", "UnscentedKalman", "Update", "Verdict", "consistency",
]
# fmt: on

"""Estimators of states from measurements, on groups: filters, smoothers, and consistency tests of their covariances."""

from .consistency import Consistency, Verdict, consistency
from .error_state_kalman import ErrorStateKalman
from .filter import Filter
from .filter_run import FilterRun, Innovations
from .fitting.experiment import Experiment
from .fitting.maximum_likelihood import MaximumLikelihood, fit
from .fitting.parameter_estimate import Combination, ParameterEstimate
from .imu.allan import AllanVariance, allan
from .imu.preintegrated_navigation import PreintegratedNavigation
from .imu.preintegration import InertialState, PreintegratedImu, Preintegration
from .invariant_kalman import GroupAffinity, Invariance, InvariantKalman, group_affinity
from .measurement import Measurement
from .observability import Observability
from .prediction.adaptive_prediction import Estimate, Prediction
from .prediction.process_noise import NoiseDiscretization, Trapezoidal, VanLoan
from .smoothers.batch_smoother import BatchEstimate, BatchSmoother
from .smoothers.robust_losses import CauchyLoss, HuberLoss, RobustLoss
from .smoothers.smoother import FixedLagSmoother, RauchTungStriebel, Smoothed
from .square_root_kalman import SquareRootKalman
from .unscented_kalman import UnscentedKalman
from .update import Update

# fmt: off
__all__ = [
    "AllanVariance", "BatchEstimate", "BatchSmoother", "CauchyLoss", "Combination", "Consistency", "ErrorStateKalman",
    "Estimate", "Experiment", "Filter", "FilterRun", "FixedLagSmoother", "GroupAffinity", "HuberLoss",
    "InertialState", "Innovations", "Invariance", "InvariantKalman", "MaximumLikelihood", "NoiseDiscretization",
    "Observability", "ParameterEstimate", "Prediction", "PreintegratedImu", "PreintegratedNavigation", "Preintegration",
    "RauchTungStriebel", "RobustLoss", "Smoothed", "SquareRootKalman", "Trapezoidal", "UnscentedKalman", "Update",
    "VanLoan", "Verdict", "allan", "consistency", "group_affinity",
]
# fmt: on

"""Mechanics as expressions: joints, bodies, mechanisms and their environment."""

from . import chain_models, environment, flight, joints, loops
from .algorithms.closed_loops import closed_dynamics, loop_diagnostics, loop_gap, loop_wrench, loop_wrenches
from .algorithms.derivatives import forward_dynamics_derivatives, inverse_dynamics_derivatives
from .algorithms.dynamics import (
    bias_forces,
    coriolis_forces,
    gravity_forces,
    inverse_dynamics,
    mass_matrix,
    rnea,
)
from .algorithms.forward_dynamics import aba, forward_dynamics
from .algorithms.jacobians import ALIGNED, BODY, WORLD, frame_jacobian, frame_jacobian_rate, frame_twist
from .algorithms.joint_wrenches import joint_wrench
from .algorithms.momentum import (
    center_of_mass,
    centroidal_matrix,
    centroidal_momentum,
    kinetic_energy,
    potential_energy,
    spatial_momentum,
    total_mass,
)
from .bodies import SpatialInertia, power
from .contact import Bristles, GivenForces, Ground, given_forces
from .control.differential import DifferentialController, DifferentialStep, StepStatus
from .control.operational_space import OperationalSpace, computed_torque, operational_space
from .distances.distance_grid import DistanceGrid
from .distances.fitted import fitted_capsule, fitted_spheres
from .distances.pairs import clearances, soft_minimum
from .distances.polytope import ConvexPolytope
from .distances.signed_distance import signed_distance
from .distances.soft_distance import soft_distance
from .distances.solids import HalfSpace
from .distances.witness import WitnessPoints, witness_points
from .drives import Drive
from .identification.base_parameters import BaseParameters, base_parameters, identifiable_combinations
from .identification.fourier_motion import fourier_motion
from .identification.identification import Identification, IdentificationStatus
from .identification.identify import identify
from .identification.physical_inertia import log_cholesky, physical_inertia
from .identification.regressor import Regressor, inverse_dynamics_regressor
from .mechanism import Chain, Mechanism
from .models import DaveModel, load, load_daveml
from .reaching.reach import reach
from .reaching.result import ReachResult, ReachStatus
from .tasks.frame import FrameTask, OrientationTask, PositionTask
from .tasks.look_at import LookAtTask
from .tasks.manipulability import ManipulabilityTask
from .tasks.momentum import CenterOfMassTask, MomentumTask
from .tasks.posture import JointLimitTask, PostureTask
from .tasks.relative_frame import RelativeFrameTask
from .tasks.task import Task
from .tree import Link, Mimic

# fmt: off
__all__ = [
    "ALIGNED", "BODY", "BaseParameters", "Bristles", "CenterOfMassTask", "Chain", "ConvexPolytope", "DaveModel",
    "DifferentialController", "DifferentialStep", "DistanceGrid", "Drive", "FrameTask", "GivenForces", "Ground",
    "HalfSpace", "Identification", "IdentificationStatus", "JointLimitTask", "Link", "LookAtTask", "ManipulabilityTask",
    "Mechanism", "Mimic", "MomentumTask", "OperationalSpace", "OrientationTask", "PositionTask", "PostureTask",
    "ReachResult", "ReachStatus", "Regressor", "RelativeFrameTask", "SpatialInertia", "StepStatus", "Task", "WORLD",
    "WitnessPoints", "aba", "base_parameters", "bias_forces", "center_of_mass", "centroidal_matrix",
    "centroidal_momentum", "chain_models", "clearances", "closed_dynamics", "computed_torque", "coriolis_forces",
    "environment", "fitted_capsule", "fitted_spheres", "flight", "forward_dynamics", "forward_dynamics_derivatives",
    "fourier_motion", "frame_jacobian", "frame_jacobian_rate", "frame_twist", "given_forces", "gravity_forces",
    "identifiable_combinations", "identify", "inverse_dynamics", "inverse_dynamics_derivatives",
    "inverse_dynamics_regressor", "joint_wrench", "joints", "kinetic_energy", "load", "load_daveml", "log_cholesky",
    "loop_diagnostics", "loop_gap", "loop_wrench", "loop_wrenches", "loops", "mass_matrix", "operational_space",
    "physical_inertia", "potential_energy", "power", "reach", "rnea", "signed_distance", "soft_distance",
    "soft_minimum", "spatial_momentum", "total_mass", "witness_points",
]
# fmt: on

"""Motion, measurement and inverse sensor models: conditioned once, then applied to all particles."""

from gridslam.models.beam import BeamRangeFinder
from gridslam.models.endpoint import CauchyEndPoint, GMappingEndPoint, LikelihoodField
from gridslam.models.inverse_sensor import InverseSensorModel
from gridslam.models.motion import DiffusionMotion, GaussianIncrement, GMappingMotion, OdometryMotion, VelocityMotion

__all__ = [
    "BeamRangeFinder",
    "CauchyEndPoint",
    "DiffusionMotion",
    "GMappingEndPoint",
    "GMappingMotion",
    "GaussianIncrement",
    "InverseSensorModel",
    "LikelihoodField",
    "OdometryMotion",
    "VelocityMotion",
]

"""Velocity motion model: the control is a commanded or measured speed and turn rate."""

from __future__ import annotations

import cmath
import math
from typing import final

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import exp
from gridslam.models.motion import GaussianIncrement, finite_triple
from gridslam.models.parameters import STRICT
from gridslam.types import FloatArray

__all__ = ["VelocityMotion"]


def _chord(angle: float) -> tuple[complex, complex]:
    """End of the unit-length arc that turns by `angle`, (sin a + i (1 - cos a)) / a, and its derivative."""
    if abs(angle) < 1e-5:  # where the quotients cancel, two terms of the series are exact to 1e-10
        return complex(1.0, angle / 2), complex(-angle / 3, 0.5)
    tip = cmath.exp(1j * angle)
    chord = (tip - 1) / (1j * angle)
    return chord, (tip - chord) / angle


@final
@parameters(frozen=True, config=STRICT)
class VelocityMotion:
    """Velocity motion model: the robot drives an arc at noisy v and omega, and turns at its end by a noisy gamma dt.

    Without turn rate the arc is a straight line; no value of omega divides by zero.

    Parameters
    ----------
    alpha1 : float, (m/s)^2/(m/s)^2, >= 0
        Variance of v per squared v.
    alpha2 : float, (m/s)^2/(rad/s)^2, >= 0
        Variance of v per squared omega.
    alpha3 : float, (rad/s)^2/(m/s)^2, >= 0
        Variance of omega per squared v.
    alpha4 : float, (rad/s)^2/(rad/s)^2, >= 0
        Variance of omega per squared omega.
    alpha5, alpha6 : float, >= 0
        Variance of the final turn rate gamma per squared v and per squared omega, units as alpha3 and alpha4. Without
        it the three-dimensional pose would lie on a two-dimensional surface.

    Notes
    -----
    The defaults are wide (a tenth of the speed) for the drive; gamma only has to fill the third dimension.

    Source: Probabilistic Robotics, Table 5.3 (`sample_motion_model_velocity`).
    """

    alpha1: float = Field(default=0.01, ge=0)
    alpha2: float = Field(default=0.01, ge=0)
    alpha3: float = Field(default=0.01, ge=0)
    alpha4: float = Field(default=0.01, ge=0)
    alpha5: float = Field(default=0.001, ge=0)
    alpha6: float = Field(default=0.001, ge=0)

    def __call__(self, control: FloatArray) -> GaussianIncrement:
        """Condition on a control (3,) [v m/s, omega rad/s, dt s].

        Raises
        ------
        ArgumentError
            Unless it is three finite numbers with dt >= 0.
        """
        v, omega, dt = finite_triple(control, "control")
        if dt < 0:
            raise ArgumentError("control", "a duration dt >= 0 s", dt)
        variance = [
            self.alpha1 * v**2 + self.alpha2 * omega**2,
            self.alpha3 * v**2 + self.alpha4 * omega**2,
            self.alpha5 * v**2 + self.alpha6 * omega**2,
        ]
        chord, chord_by_angle = _chord(omega * dt)
        by_omega = v * dt**2 * chord_by_angle
        jacobian = [[chord.real * dt, by_omega.real, 0.0], [chord.imag * dt, by_omega.imag, 0.0], [0.0, dt, dt]]

        def to_increment(values: FloatArray) -> FloatArray:
            speed, rate, gamma = values.T
            increments = exp(np.stack([speed * dt, np.zeros_like(speed), rate * dt], axis=-1))
            increments[:, 2] += gamma * dt
            return increments

        increment = np.array([v * dt * chord.real, v * dt * chord.imag, math.remainder(omega * dt, math.tau)])
        mean = np.array([v, omega, 0.0])
        return GaussianIncrement(mean, np.sqrt(variance), increment, np.array(jacobian), to_increment)

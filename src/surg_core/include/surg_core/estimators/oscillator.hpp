// Parts of Kalman models of a hand: a damped oscillator, and a motion whose jerk is white noise.
#pragma once

#include <Eigen/Core>

namespace surg {

/// How position and rate of x'' = -stiffness x - 2 decay x' go on over h [s]; stiffness in 1/s^2,
/// decay in 1/s, smaller than the root of the stiffness.
Eigen::Matrix2d oscillation(double stiffness, double decay, double h);
/// Covariance that noise adds to an oscillation of constant variance while it goes on by 'kept'.
Eigen::Matrix2d oscillation_noise(const Eigen::Matrix2d& kept, double variance, double stiffness);
/// Covariance of position, velocity and acceleration after h [s] of white jerk of this spectral
/// density.
Eigen::Matrix3d jerk_noise(double density, double h);

}  // namespace surg

// Landmark filters of many particles: what a landmark is expected to look like, and Kalman's update.
#pragma once

#include <cstdint>

namespace gridslam {

enum class LandmarkSensor { range_bearing, depth_bearing, relative_position };

struct Landmarks {
  const double* poses;  // (N, 3)
  const double*
      calibration;          // (N, 2): how far the sensor is ahead, and the share by which it takes ranges for too long
  const double* positions;  // (N, M, 2)
  const double* covariances;  // (N, M, 2, 2)
  int64_t columns;            // M
};

// R predictions of one observation.
struct Predictions {
  double* residuals;    // (R, 2)
  double* covariances;  // (R, 2, 2)
  double* by_pose;      // (R, 2, 3)
  double* by_landmark;  // (R, 2, 2)
  double* by_sensor;    // (R, 2, 2), by the calibration, if there is any
};

// `pose_covariances` (R, 3, 3) is null where poses are exact.
void predict_landmarks(LandmarkSensor sensor, const Landmarks& all, const int64_t* rows, const int64_t* columns,
                       int64_t r, const double* pose_covariances, const double* measured, const double* noise,
                       const Predictions& out);

// Gaussians (X, W) and (X, D, D), of which the first W of D variables have a mean that is kept.
struct Gaussians {
  double *means, *covariances;
  int64_t width, size;
};

void kalman_update(const Gaussians& all, const int64_t* rows, int64_t r, const double* jacobians,
                   const double* innovations, const double* residuals, double* shifts, double* gains);

void draw_gaussians(const double* means, const double* covariances, const double* numbers, int64_t n, int64_t size,
                    double* drawn);

}  // namespace gridslam

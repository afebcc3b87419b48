#include "plant.h"

#include <math.h>

namespace hostlink {

namespace {

const double kMetresPerTick = 2.0 * 3.14159265358979323846 * 0.045 / 230.4;
const double kSeparationM = 0.210;
const uint32_t kStepUs = 1000;
const uint32_t kMostUs = 1000000;  // a board that was stopped does not roll on for what it missed

}  // namespace

void Plant::run_until(uint32_t now_us) {
  if (!has_begun_ || now_us - at_us_ > kMostUs) {
    has_begun_ = true;
    at_us_ = now_us;
  }
  while (now_us - at_us_ >= kStepUs) {
    at_us_ += kStepUs;
    const float dt_s = static_cast<float>(kStepUs) * 1e-6f;
    const double left_m = static_cast<double>(left_.step(left_levels_, dt_s)) * kMetresPerTick;
    const double right_m = static_cast<double>(right_.step(right_levels_, dt_s)) * kMetresPerTick;
    move(left_m, right_m);
  }
}

// A millisecond is short enough for a straight line along the middle heading.
void Plant::move(double left_m, double right_m) {
  const double forward_m = (left_m + right_m) / 2.0;
  const double turned_rad = (right_m - left_m) / kSeparationM;
  x_m_ += forward_m * cos(theta_rad_ + turned_rad / 2.0);
  y_m_ += forward_m * sin(theta_rad_ + turned_rad / 2.0);
  theta_rad_ += turned_rad;
  rolled_m_ += fabs(forward_m);
}

}  // namespace hostlink

#include "world_parameters.h"

#include <string.h>

namespace hostlink {

namespace {

const char* const kNames[] = {
    "seed",
    "track_m",
    "caster_arm_m",
    "caster_trail_m",
    "caster_pwm",
    "caster_twist_rad",
    "caster_random",
    "floor_pwm",
    "pwm_bits",
    "battery_v",
    "rated_v",
    "battery_sag_v",
    "left.full_speed_rad_s",
    "left.dead_zone_pwm",
    "left.has_jump",
    "left.rise_constant_s",
    "left.coast_constant_s",
    "left.brake_constant_s",
    "left.friction_rad_s",
    "left.radius_m",
    "left.ticks_per_turn",
    "left.slip_noise_m",
    "left.slip_accelerating_s2_m",
    "left.slip_braking_s2_m",
    "right.full_speed_rad_s",
    "right.dead_zone_pwm",
    "right.has_jump",
    "right.rise_constant_s",
    "right.coast_constant_s",
    "right.brake_constant_s",
    "right.friction_rad_s",
    "right.radius_m",
    "right.ticks_per_turn",
    "right.slip_noise_m",
    "right.slip_accelerating_s2_m",
    "right.slip_braking_s2_m",
};
const size_t kCount = sizeof kNames / sizeof kNames[0];
static_assert(sizeof(WorldParameters) == kCount * sizeof(double), "each number has its name");

const uint64_t kMostDigits = 900000000000000000u;  // one more digit fits

bool is_digit(char letter) { return letter >= '0' && letter <= '9'; }

bool read_line(const char* line, size_t size, WorldParameters& parameters) {
  for (size_t i = 0; i < kCount; ++i) {
    const size_t length = strlen(kNames[i]);
    if (size <= length || strncmp(line, kNames[i], length) != 0 || line[length] != '=') continue;
    double value = 0.0;
    const char* end = read_number(line + length + 1, value);
    if (end == nullptr || end != line + size) return false;
    world_parameter(parameters, i) = value;
    return true;
  }
  return false;
}

}  // namespace

// strtod without its heap: digits, a point, an exponent. Exact where a double is; else right to its last digits.
const char* read_number(const char* at, double& value) {
  const bool is_negative = *at == '-';
  if (*at == '-' || *at == '+') ++at;
  uint64_t digits = 0;
  int exponent = 0;
  bool has_digits = false;
  bool has_point = false;
  for (; is_digit(*at) || (*at == '.' && !has_point); ++at) {
    if (*at == '.') {
      has_point = true;
      continue;
    }
    has_digits = true;
    const bool has_room = digits < kMostDigits;
    if (has_room) digits = digits * 10 + static_cast<uint64_t>(*at - '0');
    if (has_room && has_point) --exponent;
    if (!has_room && !has_point) ++exponent;
  }
  if (!has_digits) return nullptr;
  if (*at == 'e' || *at == 'E') {
    ++at;
    const bool is_down = *at == '-';
    if (*at == '-' || *at == '+') ++at;
    if (!is_digit(*at)) return nullptr;
    int more = 0;
    for (; is_digit(*at); ++at) more = more < 1000 ? more * 10 + (*at - '0') : more;
    exponent += is_down ? -more : more;
  }
  double power = 1.0;
  for (int i = 0; i < (exponent < 0 ? -exponent : exponent) && i < 400; ++i) power *= 10.0;
  const double size = static_cast<double>(digits);
  value = (is_negative ? -1.0 : 1.0) * (exponent < 0 ? size / power : size * power);
  return at;
}

size_t world_parameter_count() { return kCount; }

const char* world_parameter_name(size_t index) { return kNames[index]; }

double& world_parameter(WorldParameters& parameters, size_t index) {
  return reinterpret_cast<double*>(&parameters)[index];
}

uint32_t read_world(const char* text, WorldParameters& parameters) {
  for (uint32_t number = 1; *text != '\0'; ++number) {
    const size_t size = strcspn(text, "\r\n");
    if (size > 0 && *text != '#' && !read_line(text, size, parameters)) return number;
    text += size;
    if (*text == '\r') ++text;
    if (*text == '\n') ++text;
  }
  return 0;
}

}  // namespace hostlink

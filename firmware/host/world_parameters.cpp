#include "world_parameters.h"

#include <string.h>

namespace hostlink {

namespace {

const double kSmall = 1e-6;
const double kLarge = 1e6;

struct Number {
  const char* name;
  double least;
  double most;
};

const Number kNumbers[] = {
    {"seed", 0.0, 4294967295.0},
    {"track_m", kSmall, kLarge},
    {"caster_arm_m", 0.0, kLarge},
    {"caster_trail_m", kSmall, kLarge},
    {"caster_pwm", 0.0, kLarge},
    {"caster_twist_rad", -kLarge, kLarge},
    {"caster_random", 0.0, kLarge},
    {"floor_pwm", 0.0, kLarge},
    {"pwm_bits", 1.0, 12.0},
    {"battery_v", 0.0, 100.0},
    {"rated_v", 1.0, 100.0},
    {"battery_sag_v", 0.0, kLarge},
    {"left.full_speed_rad_s", kSmall, 1000.0},
    {"left.dead_zone_pwm", 0.0, 4094.0},
    {"left.has_jump", 0.0, kLarge},
    {"left.rise_constant_s", kSmall, kLarge},
    {"left.coast_constant_s", kSmall, kLarge},
    {"left.brake_constant_s", kSmall, kLarge},
    {"left.friction_rad_s", 0.0, kLarge},
    {"left.radius_m", kSmall, 10.0},
    {"left.ticks_per_turn", kSmall, kLarge},
    {"left.slip_noise_m", 0.0, kLarge},
    {"left.slip_accelerating_s2_m", -kLarge, kLarge},
    {"left.slip_braking_s2_m", -kLarge, kLarge},
    {"right.full_speed_rad_s", kSmall, 1000.0},
    {"right.dead_zone_pwm", 0.0, 4094.0},
    {"right.has_jump", 0.0, kLarge},
    {"right.rise_constant_s", kSmall, kLarge},
    {"right.coast_constant_s", kSmall, kLarge},
    {"right.brake_constant_s", kSmall, kLarge},
    {"right.friction_rad_s", 0.0, kLarge},
    {"right.radius_m", kSmall, 10.0},
    {"right.ticks_per_turn", kSmall, kLarge},
    {"right.slip_noise_m", 0.0, kLarge},
    {"right.slip_accelerating_s2_m", -kLarge, kLarge},
    {"right.slip_braking_s2_m", -kLarge, kLarge},
};
const size_t kCount = sizeof kNumbers / sizeof kNumbers[0];
static_assert(sizeof(WorldParameters) == kCount * sizeof(double), "each number has its name and range");

const uint64_t kMostDigits = 900000000000000000u;  // one more digit fits

bool is_digit(char letter) { return letter >= '0' && letter <= '9'; }

bool read_line(const char* line, size_t size, WorldParameters& parameters) {
  for (size_t i = 0; i < kCount; ++i) {
    const size_t length = strlen(kNumbers[i].name);
    if (size <= length || strncmp(line, kNumbers[i].name, length) != 0 || line[length] != '=') continue;
    double value = 0.0;
    const char* end = read_number(line + length + 1, value);
    if (end == nullptr || end != line + size) return false;
    if (!(value >= kNumbers[i].least && value <= kNumbers[i].most)) return false;
    world_parameter(parameters, i) = value;
    return true;
  }
  return false;
}

}  // namespace

// strtod without its heap: digits, a point, an exponent. Exact where a double is; otherwise right to its last digits.
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
  double rest = 1.0;  // of the power: 17 digits of a tiny number need more than the largest double
  for (int i = 0; i < (exponent < 0 ? -exponent : exponent) && i < 400; ++i) (i < 300 ? power : rest) *= 10.0;
  const double size = static_cast<double>(digits);
  value = (is_negative ? -1.0 : 1.0) * (exponent < 0 ? size / power / rest : size * power * rest);
  return at;
}

size_t world_parameter_count() { return kCount; }

const char* world_parameter_name(size_t index) { return kNumbers[index].name; }

double world_parameter_least(size_t index) { return kNumbers[index].least; }

double world_parameter_most(size_t index) { return kNumbers[index].most; }

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

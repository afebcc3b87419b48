// States of the board's LED: fast blinking without WiFi, slow blinking without a host, lit with a link.
#pragma once

#include <stdint.h>

#include "passthrough.h"

namespace hostlink {

inline bool is_led_lit(LinkState state, uint32_t now_ms) {
  if (state == LinkState::kConnected) return true;
  const uint32_t half_period_ms = state == LinkState::kJoining ? 100 : 500;
  return now_ms / half_period_ms % 2 == 0;
}

}  // namespace hostlink

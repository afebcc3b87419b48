// Copy to settings.h and fill in. settings.h is not committed: the password of the WiFi is in it.
#pragma once

#include "src/settings_type.h"

inline hostlink::Settings settings() {
  hostlink::Settings s;
  s.wifi_name = "my-network";
  s.wifi_password = "";
  s.server = "192.168.1.10";
  // s.key = "the same as in the host's key file";   // without it host and device do not prove who they are
  // s.is_uart_swapped = true;        // UART on GPIO15 and GPIO13: see "Boot noise" in docs/build-robot.md
  // s.update_password = "choose";    // allow updates over the air while no host is connected
  return s;
}

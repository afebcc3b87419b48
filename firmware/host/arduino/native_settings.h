// The settings of the native process: they come from its command line.
#pragma once

#include "machine.h"
#include "src/settings_type.h"

inline hostlink::Settings settings() {
  const standin::Options& options = standin::machine().options;
  hostlink::Settings s;
  s.wifi_name = "here";
  s.server = options.server.c_str();
  s.server_port = options.server_port;
  s.key = options.key.c_str();
  s.is_uart_swapped = options.is_uart_swapped;
  s.update_password = "here";
  return s;
}

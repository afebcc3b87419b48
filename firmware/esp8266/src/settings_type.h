// Settings of one robot. settings.h in the sketch's folder fills them in.
#pragma once

#include <stdint.h>

namespace hostlink {

struct Settings {
  const char* wifi_name = "";
  const char* wifi_password = "";
  const char* server = "";  // name or address of the computer that runs hostlink
  uint16_t server_port = 11411;
  const char* key = "";  // the key in the host's tcp.key_file; empty: neither side requires it
  uint32_t uart_baud = 38400;
  bool is_uart_swapped = false;      // UART on GPIO15 (TX) and GPIO13 (RX), which do not carry the boot messages
  const char* name = "hostlink";     // in the router's list, and for updates over the air
  const char* update_password = "";  // for updates over the air; empty: no updates
};

}  // namespace hostlink

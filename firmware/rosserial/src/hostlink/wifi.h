// WiFi of an ESP8266 or ESP32: a station that rejoins by itself, and the TCP connection to the host.
#pragma once

#if defined(ESP32)
#include <WiFi.h>
#include <lwip/sockets.h>
#else
#include <ESP8266WiFi.h>
#endif

#include "../ros/node_handle.h"
#include "client_hardware.h"

namespace hostlink {

// attach() it to the node; a sketch without a node calls spin().
class WifiStation : public ros::Task {
 public:
  // Returns at once: the SDK joins while the loop turns.
  void begin(const char* name, const char* password, const char* own_name = nullptr) {
    WiFi.persistent(false);  // avoid wear of the flash at each start
    WiFi.mode(WIFI_STA);
#if defined(ESP32)
    WiFi.setSleep(false);  // modem sleep adds 100 to 300 ms
    if (own_name != nullptr) WiFi.setHostname(own_name);
#else
    WiFi.setSleepMode(WIFI_NONE_SLEEP);
    if (own_name != nullptr) WiFi.hostname(own_name);
#endif
    WiFi.setAutoReconnect(true);
    WiFi.begin(name, password);
    joined_at_ms_ = static_cast<uint32_t>(millis());
  }

  static bool is_joined() { return WiFi.status() == WL_CONNECTED; }

  void spin() {
    const uint32_t now_ms = static_cast<uint32_t>(millis());
    if (is_joined()) {
      joined_at_ms_ = now_ms;
    } else if (now_ms - joined_at_ms_ > kRejoinMs) {
      joined_at_ms_ = now_ms;
      WiFi.reconnect();
    }
  }

 private:
  static const uint32_t kRejoinMs = 20000;  // the SDK has given up: start again

  void spin(ros::Node&) override { spin(); }

  uint32_t joined_at_ms_ = 0;
};

class WifiHardware : public ClientHardware<WiFiClient> {
 public:
  WifiHardware() {
    setNetwork(&WifiStation::is_joined);
#if !defined(ESP32)
    client().setTimeout(kConnectMs);
#endif
  }

#if defined(ESP32)
  // The client's own write() waits for seconds when the peer is lost.
  size_t write(const uint8_t* bytes, size_t size) override {
    if (!is_connected()) return 0;
    const int sent = ::send(client().fd(), bytes, size, MSG_DONTWAIT);
    return sent > 0 ? static_cast<size_t>(sent) : 0;
  }
#else
 private:
  static const unsigned long kConnectMs = 1000;  // the core's own timeout is 5 s
#endif
};

}  // namespace hostlink

// The ESP8266's ports. These two files are the only ones that include headers of its Arduino core.
#pragma once

#include <Arduino.h>
#include <ESP8266WiFi.h>

#include "../ports.h"
#include "../settings_type.h"

namespace board {

class SerialUart : public hostlink::Uart {
 public:
  void begin(const hostlink::Settings& settings);
  size_t read(uint8_t* bytes, size_t limit_bytes) override;
  size_t room_bytes() override;
  size_t write(const uint8_t* bytes, size_t count) override;
};

class WifiNetwork : public hostlink::Network {
 public:
  void begin(const hostlink::Settings& settings);
  bool is_joined() override;
  int signal_dbm() override;
  void rejoin() override;
  bool connect() override;
  bool is_connected() override;
  size_t read(uint8_t* bytes, size_t limit_bytes) override;
  size_t room_bytes() override;
  size_t write(const uint8_t* bytes, size_t count) override;
  void close() override;

 private:
  WiFiClient client_;
  const char* server_ = "";
  uint16_t server_port_ = 0;
};

// Updates over the air, if there is a password for them.
class Updates {
 public:
  void begin(const hostlink::Settings& settings);
  void step();

 private:
  const char* name_ = "";
  const char* password_ = "";
  bool has_begun_ = false;
};

uint32_t random_seed();
void begin_led();
void set_led(bool is_lit);

}  // namespace board

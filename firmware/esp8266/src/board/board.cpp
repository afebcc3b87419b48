#include "board.h"

#include <ArduinoOTA.h>

namespace board {

namespace {
const size_t kUartReceiveBytes = 1024;  // 270 ms of the UART: the core's 256 last 67 ms
const unsigned long kConnectLimit_ms = 1000;
const unsigned int kCloseLimit_ms = 1;  // 0 would mean the core's 300 ms
// A silent connection is found dead after 5 + 3 * 2 s.
const uint16_t kKeepAliveIdle_s = 5;
const uint16_t kKeepAliveInterval_s = 2;
const uint8_t kKeepAliveProbes = 3;

size_t least(int available, size_t limit) {
  const size_t count = available > 0 ? static_cast<size_t>(available) : 0;
  return count < limit ? count : limit;
}
}  // namespace

void SerialUart::begin(const hostlink::Settings& settings) {
  Serial.setRxBufferSize(kUartReceiveBytes);  // only before begin()
  Serial.begin(settings.uart_baud);
  Serial.setDebugOutput(false);  // the device would read the SDK's messages
  if (settings.is_uart_swapped) Serial.swap();
}

size_t SerialUart::read(uint8_t* bytes, size_t limit_bytes) {
  const size_t count = least(Serial.available(), limit_bytes);
  return count == 0 ? 0 : Serial.readBytes(bytes, count);
}

size_t SerialUart::room_bytes() { return least(Serial.availableForWrite(), SIZE_MAX); }

size_t SerialUart::write(const uint8_t* bytes, size_t count) {
  return Serial.write(bytes, least(Serial.availableForWrite(), count));  // more would block until the wire is free
}

void WifiNetwork::begin(const hostlink::Settings& settings) {
  server_ = settings.server;
  server_port_ = settings.server_port;
  WiFi.persistent(false);  // avoid wear of the flash at each start
  WiFi.mode(WIFI_STA);
  WiFi.setSleepMode(WIFI_NONE_SLEEP);  // modem sleep adds 100 to 300 ms
  WiFi.setAutoReconnect(true);
  WiFi.hostname(settings.name);
  WiFi.begin(settings.wifi_name, settings.wifi_password);
}

bool WifiNetwork::is_joined() { return WiFi.status() == WL_CONNECTED; }

int WifiNetwork::signal_dbm() { return WiFi.RSSI(); }  // 31 where there is no signal

void WifiNetwork::rejoin() { WiFi.reconnect(); }

bool WifiNetwork::connect() {
  client_.setTimeout(kConnectLimit_ms);
  if (client_.connect(server_, server_port_) != 1) return false;
  client_.setNoDelay(true);  // each connection starts with Nagle's algorithm on
  client_.keepAlive(kKeepAliveIdle_s, kKeepAliveInterval_s, kKeepAliveProbes);
  return true;
}

bool WifiNetwork::is_connected() { return client_.connected() != 0; }

size_t WifiNetwork::read(uint8_t* bytes, size_t limit_bytes) {
  // Check first: read() of a client that was never connected is unsafe in some versions of the core.
  const size_t count = least(client_.available(), limit_bytes);
  if (count == 0) return 0;
  const int got = client_.read(bytes, count);
  return got > 0 ? static_cast<size_t>(got) : 0;
}

size_t WifiNetwork::room_bytes() { return least(static_cast<int>(client_.availableForWrite()), SIZE_MAX); }

size_t WifiNetwork::write(const uint8_t* bytes, size_t count) {
  const size_t room = room_bytes();  // more would block until the peer reads
  return client_.write(bytes, count < room ? count : room);
}

void WifiNetwork::close() { client_.stop(kCloseLimit_ms); }

void Updates::begin(const hostlink::Settings& settings) {
  name_ = settings.name;
  password_ = settings.update_password;
}

void Updates::step() {
  if (password_[0] == '\0' || WiFi.status() != WL_CONNECTED) return;
  if (!has_begun_) {
    ArduinoOTA.setHostname(name_);
    ArduinoOTA.setPassword(password_);
    ArduinoOTA.begin(false);  // without mDNS: an address is enough, and nothing else runs in the loop
    has_begun_ = true;
  }
  ArduinoOTA.handle();
}

uint32_t random_seed() { return ESP.random(); }

void begin_led() { pinMode(LED_BUILTIN, OUTPUT); }

void set_led(bool is_lit) { digitalWrite(LED_BUILTIN, is_lit ? LOW : HIGH); }  // LOW lights the LED

}  // namespace board

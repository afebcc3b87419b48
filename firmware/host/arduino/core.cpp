// Arduino.h and ESP8266WiFi.h on the emulated machine. Each call blocks as long as in the real core.
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <random>

#include "ESP8266WiFi.h"
#include "machine.h"

HardwareSerial Serial;
EspClass ESP;
ESP8266WiFiClass WiFi;

using standin::machine;

namespace {
constexpr int64_t kTurn_us = 1000;
constexpr unsigned kReadLimit_ms = 1000;
constexpr unsigned kFlushLimit_ms = 300;

[[noreturn]] void misuse(const char* what) {
  std::fprintf(stderr, "the real core would fail here: %s\n", what);
  std::abort();
}
}  // namespace

uint32_t millis() { return static_cast<uint32_t>(machine().now_us() / 1000); }
uint32_t micros() { return static_cast<uint32_t>(machine().now_us()); }
void delay(unsigned long duration_ms) { machine().delay(static_cast<int64_t>(duration_ms) * 1000); }
void yield() { machine().rest(kTurn_us); }
void pinMode(uint8_t, uint8_t) {}
void digitalWrite(uint8_t, uint8_t) {}

void HardwareSerial::begin(unsigned long baud) {
  has_begun_ = true;
  machine().uart.begin(machine().options.is_uart_paced ? baud : 0);
}

size_t HardwareSerial::setRxBufferSize(size_t size) {
  if (has_begun_) misuse("setRxBufferSize() after begin()");
  machine().uart.set_ring_bytes(size);
  return size;
}

void HardwareSerial::setDebugOutput(bool is_wanted) {
  if (is_wanted) misuse("debug output on the device's UART");
}

void HardwareSerial::swap() {}

int HardwareSerial::available() {
  machine().advance();
  return static_cast<int>(machine().uart.available());
}

int HardwareSerial::availableForWrite() {
  machine().advance();
  return static_cast<int>(machine().uart.transmit_room());
}

int HardwareSerial::read() { return machine().uart.read(); }

size_t HardwareSerial::readBytes(uint8_t* buffer, size_t length) {
  size_t count = 0;
  const uint32_t since = millis();
  while (count < length) {
    const int byte = read();
    if (byte >= 0)
      buffer[count++] = static_cast<uint8_t>(byte);
    else if (millis() - since >= kReadLimit_ms)
      break;
    else
      yield();
  }
  return count;
}

size_t HardwareSerial::write(const uint8_t* buffer, size_t size) {
  for (size_t i = 0; i < size; ++i) {
    while (machine().uart.transmit_room() == 0) machine().rest(kTurn_us);
    machine().uart.transmit(buffer[i]);
  }
  machine().advance();
  return size;
}

uint32_t EspClass::random() { return std::random_device{}(); }

void ESP8266WiFiClass::persistent(bool) {}
bool ESP8266WiFiClass::mode(WiFiMode_t) { return true; }
bool ESP8266WiFiClass::setSleepMode(WiFiSleepType_t) { return true; }
bool ESP8266WiFiClass::setAutoReconnect(bool) { return true; }
bool ESP8266WiFiClass::hostname(const char*) { return true; }

wl_status_t ESP8266WiFiClass::begin(const char*, const char*) {
  machine().radio.join(machine().now_us());
  return WL_DISCONNECTED;
}

bool ESP8266WiFiClass::reconnect() {
  machine().radio.join(machine().now_us());
  return true;
}

wl_status_t ESP8266WiFiClass::status() {
  return machine().radio.is_joined(machine().now_us()) ? WL_CONNECTED : WL_DISCONNECTED;
}

int8_t ESP8266WiFiClass::RSSI() { return static_cast<int8_t>(machine().radio.options.signal_dbm); }

namespace {
int open_socket(const char* host, uint16_t port) {
  addrinfo hints{}, *address = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  if (getaddrinfo(host, std::to_string(port).c_str(), &hints, &address) != 0) return -1;
  const int fd = socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  ::connect(fd, address->ai_addr, address->ai_addrlen);
  freeaddrinfo(address);
  return fd;
}

// 1 connected, 0 refused, -1 not yet known.
int dialled(int fd) {
  pollfd polled{fd, POLLOUT, 0};
  if (poll(&polled, 1, 0) == 0) return -1;
  int error = 0;
  socklen_t length = sizeof error;
  getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &length);
  return error == 0 ? 1 : 0;
}
}  // namespace

int WiFiClient::connect(const char* host, uint16_t port) {
  stop();
  connection_.reset();
  const uint32_t since = millis();
  delay(machine().radio.options.connect_ms);
  if (machine().radio.dialling == standin::Dialling::kRefuse) return 0;
  int fd = -1;
  int result = -1;
  while (result < 0 && millis() - since < timeout_ms_) {
    const bool reaches =
        machine().radio.has_air(machine().now_us()) && machine().radio.dialling != standin::Dialling::kHang;
    if (fd < 0 && reaches) fd = open_socket(host, port);
    if (fd >= 0) result = dialled(fd);
    if (result < 0) delay(1);
  }
  if (result == 1) {
    connection_ = machine().radio.adopt(fd);
    return 1;
  }
  if (fd >= 0) ::close(fd);
  return 0;
}

uint8_t WiFiClient::connected() { return connection_ && connection_->is_open() ? 1 : 0; }

int WiFiClient::available() {
  machine().advance();
  return connection_ ? static_cast<int>(connection_->available()) : 0;
}

int WiFiClient::read(uint8_t* buffer, size_t size) {
  if (!connection_) misuse("WiFiClient::read() without a connection");
  return static_cast<int>(connection_->read(buffer, size));
}

size_t WiFiClient::availableForWrite() { return connection_ && connection_->is_open() ? connection_->send_room() : 0; }

size_t WiFiClient::write(const uint8_t* buffer, size_t size) {
  if (!connection_ || size == 0) return 0;
  ++machine().radio.sent_writes;
  const size_t limit = machine().radio.options.write_limit_bytes;
  const size_t wanted = limit == 0 ? size : std::min(size, limit);
  const uint32_t since = millis();
  size_t count = 0;
  while (true) {
    count += connection_->queue(buffer + count, wanted - count);
    machine().advance();
    if (count == wanted || !connection_->is_open() || millis() - since >= timeout_ms_) return count;
    delay(1);
  }
}

void WiFiClient::setNoDelay(bool is_wanted) {
  const int value = is_wanted ? 1 : 0;
  if (connection_) setsockopt(connection_->fd(), IPPROTO_TCP, TCP_NODELAY, &value, sizeof value);
}

void WiFiClient::keepAlive(uint16_t idle_s, uint16_t interval_s, uint8_t count) {
  if (!connection_) misuse("WiFiClient::keepAlive() without a connection");
  connection_->keep_alive((idle_s + int64_t{interval_s} * count) * 1000000);
}

bool WiFiClient::stop(unsigned int limit_ms) {
  if (!connection_) return true;
  const uint32_t since = millis();
  const unsigned int limit = limit_ms == 0 ? kFlushLimit_ms : limit_ms;
  while (connection_->is_open() && !connection_->is_flushed() && millis() - since < limit) delay(1);
  if (connection_->fd() >= 0) {
    const bool is_heard = machine().radio.has_air(machine().now_us());
    const int fd = connection_->release();
    if (is_heard)
      ::close(fd);
    else
      machine().radio.bury(fd);
  }
  connection_.reset();
  return true;
}

// The board behind Arduino.h: a sketch of firmware/rosserial as a process.
//
//   sketches NAME HOST PORT [SERIAL_PORT]
//
// Serial and the network are connections to the host; with SERIAL_PORT, Serial is one to that port, where another
// board may be.
//
// The program writes a line for each change of an output: "digital PIN LEVEL", "analog PIN DUTY", "servo PIN DEGREES".
// Lines of its input set what the sketch reads: "digital PIN LEVEL" (with its interrupt), "analog PIN VALUE", "pulse
// PIN MICROSECONDS", "register N VALUE".
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

#include "Arduino.h"
#include "Ethernet.h"
#include "Servo.h"
#include "WiFi.h"
#include "Wire.h"
#include "sketches.h"
#include "tcp_socket.h"

HardwareSerial Serial;
TwoWire Wire;
WiFiClass WiFi;
EthernetClass Ethernet;

namespace {

const char* host = "";
uint16_t port = 0;
uint16_t serial_port = 0;

}  // namespace

extern const char* const& standin_host;  // wifi_udp.cpp
extern const uint16_t& standin_port;
const char* const& standin_host = host;
const uint16_t& standin_port = port;

namespace {

const int kPins = 256;
const int kTurnMs = 1;
const unsigned long kReconnectMs = 200;

TcpSocket serial;
unsigned long serial_tried_at = 0;
int levels[kPins];
int values[kPins];
int duties[kPins];
int registers[kPins];
unsigned long pulses[kPins];
void (*edges[kPins])();

unsigned long long now_us() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<unsigned long long>(now.tv_sec) * 1000000u + static_cast<unsigned long long>(now.tv_nsec) / 1000u;
}

void report(const char* kind, int pin, int value) {
  printf("%s %d %d\n", kind, pin, value);
  fflush(stdout);
}

void set_input(const char* line) {
  char kind[16];
  int number = 0;
  int value = 0;
  if (sscanf(line, "%15s %d %d", kind, &number, &value) != 3 || number < 0 || number >= kPins) return;
  if (strcmp(kind, "digital") == 0) {
    const bool has_changed = levels[number] != value;
    levels[number] = value;
    if (has_changed && edges[number] != nullptr) edges[number]();
  } else if (strcmp(kind, "analog") == 0) {
    values[number] = value;
  } else if (strcmp(kind, "pulse") == 0) {
    pulses[number] = static_cast<unsigned long>(value);
  } else if (strcmp(kind, "register") == 0) {
    registers[number] = value;
  }
}

void read_inputs() {
  static char line[64];
  static size_t size = 0;
  char next = 0;
  while (::read(STDIN_FILENO, &next, 1) == 1) {
    if (next != '\n') {
      if (size < sizeof line - 1) line[size++] = next;
      continue;
    }
    line[size] = '\0';
    size = 0;
    set_input(line);
  }
}

}  // namespace

unsigned long millis() { return static_cast<unsigned long>(now_us() / 1000); }
unsigned long micros() { return static_cast<unsigned long>(now_us()); }
void delay(unsigned long ms) { ::usleep(static_cast<useconds_t>(ms * 1000)); }
void delayMicroseconds(unsigned int us) { ::usleep(us); }
void yield() {}

void pinMode(uint8_t pin, uint8_t mode) {
  if (mode == INPUT_PULLUP) levels[pin] = HIGH;
}

void digitalWrite(uint8_t pin, uint8_t level) {
  if (levels[pin] == level) return;
  levels[pin] = level;
  report("digital", pin, level);
}

int digitalRead(uint8_t pin) { return levels[pin]; }
int analogRead(uint8_t pin) { return values[pin]; }

void analogWrite(uint8_t pin, int duty) {
  if (duties[pin] == duty) return;
  duties[pin] = duty;
  report("analog", pin, duty);
}

unsigned long pulseIn(uint8_t pin, uint8_t, unsigned long timeout_us) {
  return pulses[pin] < timeout_us ? pulses[pin] : 0;
}

void attachInterrupt(uint8_t pin, void (*on_edge)(), int) { edges[pin] = on_edge; }

void HardwareSerial::begin(unsigned long) {}
size_t HardwareSerial::setRxBufferSize(size_t bytes) { return bytes; }

int HardwareSerial::available() {
  if (!serial.is_open() && millis() - serial_tried_at >= kReconnectMs) {
    serial_tried_at = millis();
    serial.connect(host, serial_port);
  }
  return serial.available();
}

int HardwareSerial::read() { return available() > 0 ? serial.read() : -1; }
int HardwareSerial::availableForWrite() { return serial.is_open() ? serial.room() : 64; }
size_t HardwareSerial::write(const uint8_t* bytes, size_t size) {
  return serial.is_open() ? serial.write(bytes, size) : size;  // a UART without a reader accepts everything
}

void Servo::write(int angle_deg) { report("servo", pin_, angle_deg); }

size_t TwoWire::write(uint8_t byte) {
  if (!has_register_) {
    register_ = byte;
    has_register_ = true;
  } else {
    registers[register_++] = byte;
  }
  return 1;
}

uint8_t TwoWire::requestFrom(uint8_t, uint8_t count) {
  left_ = count;
  return count;
}

int TwoWire::read() {
  if (left_ == 0) return -1;
  --left_;
  return registers[register_++];
}

wl_status_t WiFiClass::begin(const char*, const char*) {
  has_begun_ = true;
  began_at_ms_ = millis();
  return WL_IDLE_STATUS;
}

wl_status_t WiFiClass::status() const {
  return has_begun_ && millis() - began_at_ms_ >= 100 ? WL_CONNECTED : WL_DISCONNECTED;
}

int WiFiClient::connect(const char*, uint16_t) { return socket_.connect(host, port) ? 1 : 0; }
int WiFiClient::connect(IPAddress, uint16_t) { return socket_.connect(host, port) ? 1 : 0; }

namespace {

const Sketch* find_sketch(const char* name) {
  for (int i = 0; i < kSketchCount; ++i) {
    if (strcmp(kSketches[i].name, name) == 0) return &kSketches[i];
  }
  return nullptr;
}

}  // namespace

int main(int count, char** words) {
  const Sketch* sketch = count > 1 ? find_sketch(words[1]) : nullptr;
  if (sketch == nullptr || count < 4) {
    fprintf(stderr, "usage: %s NAME HOST PORT [SERIAL_PORT]\n", words[0]);
    return 2;
  }
  host = words[2];
  port = static_cast<uint16_t>(atoi(words[3]));
  serial_port = count > 4 ? static_cast<uint16_t>(atoi(words[4])) : port;
  ::fcntl(STDIN_FILENO, F_SETFL, ::fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
  sketch->setup();
  for (;;) {
    read_inputs();
    sketch->loop();
    ::poll(nullptr, 0, kTurnMs);
  }
}

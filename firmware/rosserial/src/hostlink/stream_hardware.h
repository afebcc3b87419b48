// A serial port of an Arduino core: a UART, USB, or another Stream. ros_lib's name for it: ArduinoHardware.
#pragma once

#include <Arduino.h>

#include "../ros/link.h"

namespace hostlink {

const unsigned long kSerialBaud = 57600;  // rosserial's default

class StreamHardware : public ros::Link {
 public:
  StreamHardware() { setPort(&Serial); }
  template <class Port>
  explicit StreamHardware(Port* port, unsigned long baud = kSerialBaud) : baud_(baud) {
    setPort(port);
  }

  // Before initNode(). A port without availableForWrite(), such as SoftwareSerial, takes a few bytes a turn, and the
  // turn waits for them.
  template <class Port>
  void setPort(Port* port) {
    port_ = port;
    begin_ = &begin<Port>;
    room_ = &room<Port>;
  }
  void setBaud(unsigned long baud) { baud_ = baud; }
  unsigned long getBaud() const { return baud_; }

  void init() { begin_(port_, baud_); }
  int read() override { return port_->read(); }
  size_t write(const uint8_t* bytes, size_t size) override {
    const size_t room = room_(port_);
    return room == 0 ? 0 : port_->write(bytes, size < room ? size : room);
  }
  bool drains() override { return true; }
  uint32_t milliseconds() override {
    yield();
    return static_cast<uint32_t>(millis());
  }

 private:
  template <class Port>
  static void begin(Stream* port, unsigned long baud) {
    static_cast<Port*>(port)->begin(baud);
  }
  // The stream's own function: in some cores Stream has none, in others its function returns 0.
  template <class Port>
  static size_t room(Stream* port) {
    const int room = available(*static_cast<Port*>(port), &Port::availableForWrite);
    return room > 0 ? static_cast<size_t>(room) : 0;
  }
  template <class Port, class Room>
  static int available(Port& port, Room Port::*) {
    return port.availableForWrite();
  }
  template <class Port, class Room>
  static int available(Port&, Room Print::*) {  // inherited: 0
    return kWaitingBytes;
  }

  static const int kWaitingBytes = 8;

  Stream* port_ = nullptr;
  void (*begin_)(Stream*, unsigned long) = nullptr;
  size_t (*room_)(Stream*) = nullptr;
  unsigned long baud_ = kSerialBaud;
};

}  // namespace hostlink

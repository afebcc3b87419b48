// Stand-in for an Arduino core, so that an example of firmware/rosserial runs as a process: Serial is a TCP connection
// to the host, the pins are lines of text (board.cpp).
#pragma once

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

const uint8_t LOW = 0, HIGH = 1;
const uint8_t INPUT = 0, OUTPUT = 1, INPUT_PULLUP = 2;
const int CHANGE = 1, FALLING = 2, RISING = 3;
const uint8_t LED_BUILTIN = 13;
const uint8_t A0 = 100, A1 = 101, A2 = 102, A3 = 103;
typedef uint8_t byte;

#define F(text) (reinterpret_cast<const __FlashStringHelper*>(text))
class __FlashStringHelper;

unsigned long millis();
unsigned long micros();
void delay(unsigned long ms);
void delayMicroseconds(unsigned int us);
void yield();
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
int digitalRead(uint8_t pin);
int analogRead(uint8_t pin);
void analogWrite(uint8_t pin, int duty);
unsigned long pulseIn(uint8_t pin, uint8_t level, unsigned long timeout_us = 1000000);
inline uint8_t digitalPinToInterrupt(uint8_t pin) { return pin; }
void attachInterrupt(uint8_t pin, void (*on_edge)(), int mode);
inline void noInterrupts() {}
inline void interrupts() {}

class Print {
 public:
  virtual size_t write(uint8_t byte) = 0;
  virtual size_t write(const uint8_t* bytes, size_t size) = 0;
  virtual int availableForWrite() { return 0; }  // like the cores: without information, wait

 protected:
  ~Print() {}
};

class Stream : public Print {
 public:
  virtual int available() = 0;
  virtual int read() = 0;
};

class HardwareSerial : public Stream {
 public:
  void begin(unsigned long baud);
  size_t setRxBufferSize(size_t bytes);  // of an ESP8266 and an ESP32
  int available() override;
  int read() override;
  int availableForWrite() override;
  size_t write(uint8_t byte) override { return write(&byte, 1); }
  size_t write(const uint8_t* bytes, size_t size) override;
  void flush() {}  // nothing is buffered
};

extern HardwareSerial Serial;

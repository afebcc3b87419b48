// Stand-in for the ESP8266 Arduino core: the part that the sketch uses, with the core's names and types.
#pragma once

#include <cstddef>
#include <cstdint>

#define HIGH 0x1
#define LOW 0x0
#define INPUT 0x00
#define OUTPUT 0x01
#define LED_BUILTIN 2

uint32_t millis();  // the core's unsigned long, which is 32 bits there
uint32_t micros();
void delay(unsigned long duration_ms);
void yield();
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);

class HardwareSerial {
 public:
  void begin(unsigned long baud);
  size_t setRxBufferSize(size_t size);
  void setDebugOutput(bool is_wanted);
  void swap();
  int available();
  int availableForWrite();
  int read();
  size_t readBytes(uint8_t* buffer, size_t length);  // blocks until they arrive, like the core's
  size_t write(const uint8_t* buffer, size_t size);  // blocks until the wire is free, like the core's

 private:
  bool has_begun_ = false;
};

class EspClass {
 public:
  uint32_t random();
};

extern HardwareSerial Serial;
extern EspClass ESP;

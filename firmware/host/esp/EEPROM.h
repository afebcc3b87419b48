// Stand-in for the EEPROM and the `ESP` of both cores.
#pragma once

#include "Arduino.h"

class EEPROMClass {
 public:
#if defined(ESP32)
  bool begin(size_t size);
#else
  void begin(size_t size);
#endif
  uint8_t read(int at);
  void write(int at, uint8_t value);
  bool commit();
#if defined(ESP32)
  uint16_t length();
#else
  size_t length();
#endif
};

class EspClass {
 public:
  void restart();
};

extern EEPROMClass EEPROM;
extern EspClass ESP;

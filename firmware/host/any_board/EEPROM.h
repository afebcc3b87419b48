// Stand-in for an ESP8266's EEPROM, whose flash is the file in ANY_BOARD_FLASH, and for the `ESP` of its core.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

class EEPROMClass {
 public:
  void begin(size_t size) {
    size_ = size;
    const char* path = getenv("ANY_BOARD_FLASH");
    FILE* flash = path == nullptr ? nullptr : fopen(path, "rb");
    if (flash == nullptr) return;
    for (int byte = getc(flash), at = 0; byte != EOF && at < kBytes; byte = getc(flash), ++at) {
      bytes_[at] = static_cast<uint8_t>(byte);
    }
    fclose(flash);
  }
  uint8_t read(int at) { return bytes_[at]; }
  void write(int at, uint8_t value) { bytes_[at] = value; }
  bool commit() { return true; }  // not stored
  size_t length() { return size_; }

 private:
  static const int kBytes = 512;

  size_t size_ = 0;
  uint8_t bytes_[kBytes] = {};
};

class EspClass {
 public:
  void restart() { exit(0); }
};

static EEPROMClass EEPROM;
static EspClass ESP;

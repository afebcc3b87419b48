// Settings in the flash that ESP8266 and ESP32 show as EEPROM:
//   #include <EEPROM.h>
//   #include <hostlink/settings_eeprom.h>
//   hostlink::EepromStorage<EEPROMClass> storage(EEPROM);
#pragma once

#include "board_settings.h"

namespace hostlink {

template <class Eeprom>
class EepromStorage : public SettingsStorage {
 public:
  // From `first` on; the bytes before it belong to the sketch, which may begin() its EEPROM with another size.
  explicit EepromStorage(Eeprom& eeprom, int first = 0) : eeprom_(eeprom), first_(first) {}

  bool read(uint8_t* bytes, size_t size) override {
    if (!has_begun_ || eeprom_.length() < end_of(size)) begin(size);
    for (size_t i = 0; i < size; ++i) bytes[i] = eeprom_.read(first_ + static_cast<int>(i));
    return true;
  }

  bool write(const uint8_t* bytes, size_t size) override {
    if (!has_begun_ || eeprom_.length() < end_of(size)) begin(size);
    for (size_t i = 0; i < size; ++i) eeprom_.write(first_ + static_cast<int>(i), bytes[i]);
    const bool is_committed = eeprom_.commit();  // also true for a copy that was not changed
    begin(size);                                 // reads the flash again
    bool is_kept = is_committed;
    for (size_t i = 0; i < size; ++i) is_kept = is_kept && eeprom_.read(first_ + static_cast<int>(i)) == bytes[i];
    return is_kept;
  }

 private:
  size_t end_of(size_t size) const { return static_cast<size_t>(first_) + size; }
  void begin(size_t size) {
    const size_t least = end_of(size);
    const size_t now = eeprom_.length();
    eeprom_.begin(now < least ? least : now);
    has_begun_ = true;
  }

  Eeprom& eeprom_;
  int first_;
  bool has_begun_ = false;
};

}  // namespace hostlink

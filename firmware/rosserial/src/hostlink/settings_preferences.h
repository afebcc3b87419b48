// Settings among the Preferences of an ESP32, which distribute their writes over the flash:
//   #include <Preferences.h>
//   #include <hostlink/settings_preferences.h>
//   Preferences preferences;
//   hostlink::PreferencesStorage<Preferences> storage(preferences);
#pragma once

#include "board_settings.h"

namespace hostlink {

template <class Preferences>
class PreferencesStorage : public SettingsStorage {
 public:
  explicit PreferencesStorage(Preferences& preferences) : preferences_(preferences) {}

  bool read(uint8_t* bytes, size_t size) override {
    if (!preferences_.begin("hostlink", true)) return false;
    const size_t got = preferences_.getBytes("settings", bytes, size);
    preferences_.end();
    return got == size;
  }

  bool write(const uint8_t* bytes, size_t size) override {
    if (!preferences_.begin("hostlink", false)) return false;
    const size_t put = preferences_.putBytes("settings", bytes, size);
    preferences_.end();
    return put == size;
  }

 private:
  Preferences& preferences_;
};

}  // namespace hostlink

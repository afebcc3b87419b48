// Settings that a board keeps when it is flashed again: address of its host, name, WiFi and keys. `hostlink board
// setup` sets them over the serial line, `hostlink board info` shows them; passwords and keys cannot be read back.
// Board-free: the storage is an interface (settings_eeprom.h, settings_preferences.h).
// docs/arduino.md#settings-on-the-board
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hostlink {

// Storage of the settings, from its first byte on.
class SettingsStorage {
 public:
  virtual bool read(uint8_t* bytes, size_t size) = 0;
  virtual bool write(const uint8_t* bytes, size_t size) = 0;  // returns when they are stored

 protected:
  ~SettingsStorage() {}
};

class BoardSettings {
 public:
  enum Field : uint8_t { kHost, kPort, kName, kWifiName, kWifiPassword, kKey, kUpdatePassword, kFieldCount };
  enum Error : uint8_t { kDone, kUnknownName, kTooShort, kTooLong, kBadValue, kNotStored, kLost };

  explicit BoardSettings(SettingsStorage& storage) : storage_(storage) {}

  bool load();  // false: not stored, or damaged; then all are empty
  // Store the settings that were set: all of them, or none.
  Error save();

  const char* host() const { return text(kHost); }
  uint16_t port() const;  // 11411, hostlink's default, if not set
  const char* name() const { return text(kName); }
  const char* name_space();  // the name as NodeHandle::setNamespace takes it: "robot_3/"; valid as long as this object
  const char* wifi_name() const { return text(kWifiName); }
  const char* wifi_password() const { return text(kWifiPassword); }
  const char* key() const { return text(kKey); }
  const char* update_password() const { return text(kUpdatePassword); }

  const char* text(Field field) const { return reinterpret_cast<const char*>(record_ + at(field)); }
  // `value` contains no zero byte; empty: not set. Nothing is stored before save().
  Error set(Field field, const uint8_t* value, size_t size);

  static const char* field_name(Field field);
  static bool is_secret(Field field);
  static bool find_field(const char* name, size_t size, Field& field);

 private:
  static const size_t kHostBytes = 63;
  static const size_t kPortBytes = 5;
  static const size_t kNameBytes = 32;
  static const size_t kWifiNameBytes = 32;
  static const size_t kSecretBytes = 64;
  static const size_t kHeadBytes = 4;
  static const size_t kCheckBytes = 4;
  static const size_t kRecordBytes = kHeadBytes + (kHostBytes + 1) + (kPortBytes + 1) + (kNameBytes + 1) +
                                     (kWifiNameBytes + 1) + 3 * (kSecretBytes + 1) + kCheckBytes;

  struct Rule {
    const char* name;
    uint8_t least;  // of a value that is not empty
    uint8_t most;
    bool is_secret;
  };
  static const Rule kRules[kFieldCount];

  static size_t at(Field field);
  void clear();
  bool is_intact() const;

  SettingsStorage& storage_;
  uint8_t record_[kRecordBytes] = {};
  char name_space_[kNameBytes + 2] = {};

 public:
  static const size_t kStoredBytes = kRecordBytes;  // the room that a storage needs
};

// CRC-32 as zlib's, of bytes in pieces: begin with 0.
uint32_t crc32(uint32_t before, const uint8_t* bytes, size_t size);

}  // namespace hostlink

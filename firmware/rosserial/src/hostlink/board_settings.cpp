#include "board_settings.h"

#include <string.h>

namespace hostlink {

namespace {

const uint16_t kUsualPort = 11411;
const uint8_t kHead[4] = {'H', 'L', 'S', '1'};

uint32_t read_u32(const uint8_t* bytes) {
  return static_cast<uint32_t>(bytes[0]) | static_cast<uint32_t>(bytes[1]) << 8 |
         static_cast<uint32_t>(bytes[2]) << 16 | static_cast<uint32_t>(bytes[3]) << 24;
}

void write_u32(uint8_t* bytes, uint32_t value) {
  for (int i = 0; i < 4; ++i) bytes[i] = static_cast<uint8_t>(value >> (8 * i));
}

bool is_printable(uint8_t byte) { return byte > ' ' && byte != 0x7F; }

// 1 to 65535, in digits; 0: not a port.
uint16_t read_port(const uint8_t* text, size_t size) {
  uint32_t port = 0;
  for (size_t i = 0; i < size; ++i) {
    if (text[i] < '0' || text[i] > '9') return 0;
    port = port * 10 + (text[i] - static_cast<uint32_t>('0'));
  }
  return port > 0xFFFF ? static_cast<uint16_t>(0) : static_cast<uint16_t>(port);
}

bool is_ros_name(const uint8_t* text, size_t size) {
  for (size_t i = 0; i < size; ++i) {
    const uint8_t c = text[i];
    const bool is_letter = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
    const bool is_inner = c == '_' || c == '/' || (c >= '0' && c <= '9');
    if (!is_letter && (i == 0 || !is_inner || (c == '/' && text[i - 1] == '/'))) return false;
  }
  return size == 0 || text[size - 1] != '/';
}

}  // namespace

const BoardSettings::Rule BoardSettings::kRules[kFieldCount] = {
    {"host", 1, kHostBytes, false},           {"port", 1, kPortBytes, false},
    {"name", 1, kNameBytes, false},           {"wifi_name", 1, kWifiNameBytes, false},
    {"wifi_password", 8, kSecretBytes, true},  // WPA2: 8 to 63 characters, or 64 hexadecimal digits
    {"key", 16, kSecretBytes, true},          {"update_password", 1, kSecretBytes, true},
};

const char* BoardSettings::field_name(Field field) { return kRules[field].name; }

bool BoardSettings::is_secret(Field field) { return kRules[field].is_secret; }

bool BoardSettings::find_field(const char* name, size_t size, Field& field) {
  for (uint8_t i = 0; i < kFieldCount; ++i) {
    if (strlen(kRules[i].name) == size && memcmp(kRules[i].name, name, size) == 0) {
      field = static_cast<Field>(i);
      return true;
    }
  }
  return false;
}

size_t BoardSettings::at(Field field) {
  size_t at = kHeadBytes;
  for (uint8_t i = 0; i < field; ++i) at += kRules[i].most + 1u;
  return at;
}

bool BoardSettings::load() {
  if (storage_.read(record_, sizeof record_) && is_intact()) return true;
  clear();
  return false;
}

BoardSettings::Error BoardSettings::save() {
  memcpy(record_, kHead, sizeof kHead);
  write_u32(record_ + kRecordBytes - kCheckBytes, crc32(0, record_, kRecordBytes - kCheckBytes));
  return storage_.write(record_, sizeof record_) ? kDone : kNotStored;
}

uint16_t BoardSettings::port() const {
  const uint16_t port = read_port(record_ + at(kPort), strlen(text(kPort)));
  return port == 0 ? kUsualPort : port;
}

const char* BoardSettings::name_space() {
  const size_t size = strlen(name());
  memcpy(name_space_, name(), size + 1);
  if (size > 0) {
    name_space_[size] = '/';
    name_space_[size + 1] = '\0';
  }
  return name_space_;
}

BoardSettings::Error BoardSettings::set(Field field, const uint8_t* value, size_t size) {
  const Rule& rule = kRules[field];
  if (size > rule.most) return kTooLong;
  if (size > 0 && size < rule.least) return kTooShort;
  const bool may_have_spaces = field == kWifiName || field == kWifiPassword;
  for (size_t i = 0; i < size; ++i) {
    if (!is_printable(value[i]) && !(may_have_spaces && value[i] == ' ')) return kBadValue;
  }
  if (field == kPort && size > 0 && read_port(value, size) == 0) return kBadValue;
  if (field == kName && !is_ros_name(value, size)) return kBadValue;
  uint8_t* text = record_ + at(field);
  memset(text, 0, rule.most + 1u);
  if (size > 0) memcpy(text, value, size);
  return kDone;
}

void BoardSettings::clear() { memset(record_, 0, sizeof record_); }

// Data in the flash is as untrusted as data from a wire: each text must end.
bool BoardSettings::is_intact() const {
  const uint8_t* check = record_ + kRecordBytes - kCheckBytes;
  if (memcmp(record_, kHead, sizeof kHead) != 0 || read_u32(check) != crc32(0, record_, kRecordBytes - kCheckBytes)) {
    return false;
  }
  for (uint8_t i = 0; i < kFieldCount; ++i) {
    if (record_[at(static_cast<Field>(i)) + kRules[i].most] != 0) return false;
  }
  return true;
}

uint32_t crc32(uint32_t before, const uint8_t* bytes, size_t size) {
  uint32_t crc = ~before;
  for (size_t i = 0; i < size; ++i) {
    crc ^= bytes[i];
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ (0xEDB88320u & (0u - (crc & 1u)));
  }
  return ~crc;
}

}  // namespace hostlink

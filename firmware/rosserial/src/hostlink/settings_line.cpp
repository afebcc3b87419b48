#include "settings_line.h"

#include <string.h>

namespace hostlink {

namespace {

const char kMark[] = "#hl ";
const size_t kMarkBytes = sizeof kMark - 1;
const size_t kCheckDigits = 8;
const char kDigits[] = "0123456789ABCDEF";
// Texts of BoardSettings::Error.
const char* const kErrors[] = {"", "unknown", "short", "long", "value", "stored", "lost"};
static_assert(BoardSettings::kFieldCount <= 8, "set_fields_ has a bit for each");

int digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

bool read_check(const char* text, uint32_t& check) {
  check = 0;
  for (size_t i = 0; i < kCheckDigits; ++i) {
    if (digit(text[i]) < 0) return false;
    check = check << 4 | static_cast<uint32_t>(digit(text[i]));
  }
  return true;
}

// Replace %XX by its byte, in place. False: a % without two digits, or a zero byte.
bool decode(char* text, size_t& size) {
  size_t to = 0;
  for (size_t from = 0; from < size; ++from, ++to) {
    text[to] = text[from];
    if (text[from] != '%') continue;
    if (size - from < 3 || digit(text[from + 1]) < 0 || digit(text[from + 2]) < 0) return false;
    text[to] = static_cast<char>(digit(text[from + 1]) << 4 | digit(text[from + 2]));
    if (text[to] == 0) return false;
    from += 2;
  }
  size = to;
  return true;
}

}  // namespace

bool SettingsLine::add(uint8_t byte) {
  if (byte == '#') {  // a new line begins
    size_ = 0;
    is_too_long_ = false;
  }
  if (byte != '\n' && byte != '\r') {
    is_too_long_ = is_too_long_ || size_ == kLineBytes;
    add_char(static_cast<char>(byte));
    return false;
  }
  verb_ = kNone;
  if (!is_too_long_) parse(size_);
  memset(line_, 0, sizeof line_);  // no password stays in memory
  size_ = 0;
  is_too_long_ = false;
  return verb_ != kNone;
}

void SettingsLine::parse(size_t size) {
  if (size < kMarkBytes + kCheckDigits + 1 || memcmp(line_, kMark, kMarkBytes) != 0) return;
  const size_t end = size - kCheckDigits - 1;
  uint32_t check = 0;
  if (line_[end] != ' ' || !read_check(line_ + end + 1, check)) return;
  if (crc32(0, reinterpret_cast<const uint8_t*>(line_), end) != check) return;
  size_t at = kMarkBytes;
  uint32_t number = 0;
  while (at < end && line_[at] >= '0' && line_[at] <= '9' && number <= 0xFFFF) {
    number = number * 10 + static_cast<uint32_t>(line_[at++] - '0');
  }
  if (at == kMarkBytes || at == end || line_[at] != ' ' || number > 0xFFFF) return;
  char* words = line_ + at + 1;
  const size_t words_size = end - at - 1;
  number_ = static_cast<uint16_t>(number);
  next_field_ = 0;
  error_ = BoardSettings::kDone;
  if (words_size == 4 && memcmp(words, "info", 4) == 0) {
    verb_ = kInfo;
  } else if (words_size > 5 && memcmp(words, "save ", 5) == 0) {
    parse_save(words + 5, words_size - 5);
  } else if (words_size == 6 && memcmp(words, "forget", 6) == 0) {
    verb_ = kForget;
  } else if (words_size > 4 && memcmp(words, "set ", 4) == 0) {
    verb_ = kSet;
    error_ = set(words + 4, words_size - 4);
  }
}

void SettingsLine::parse_save(const char* count, size_t size) {
  if (size != 1 || count[0] < '0' || count[0] > '9') return;
  int set = 0;
  for (uint8_t fields = set_fields_; fields != 0; fields = static_cast<uint8_t>(fields >> 1)) set += fields & 1;
  verb_ = kSave;
  if (set != count[0] - '0') error_ = BoardSettings::kLost;
}

BoardSettings::Error SettingsLine::set(char* words, size_t size) {
  char* equals = static_cast<char*>(memchr(words, '=', size));
  BoardSettings::Field field = BoardSettings::kHost;
  if (equals == nullptr) return BoardSettings::kBadValue;
  const size_t name_size = static_cast<size_t>(equals - words);
  if (!BoardSettings::find_field(words, name_size, field)) return BoardSettings::kUnknownName;
  char* value = equals + 1;
  size_t value_size = size - name_size - 1;
  if (!decode(value, value_size)) return BoardSettings::kBadValue;
  const BoardSettings::Error error = settings_.set(field, reinterpret_cast<const uint8_t*>(value), value_size);
  if (error == BoardSettings::kDone) set_fields_ = static_cast<uint8_t>(set_fields_ | 1u << field);
  return error;
}

size_t SettingsLine::answer(bool& is_last, bool& is_saved) {
  is_last = true;
  switch (verb_) {
    case kInfo:
      return info_line(is_last);
    case kSave:
      if (error_ == BoardSettings::kDone) error_ = settings_.save();
      is_saved = error_ == BoardSettings::kDone;
      return result_line(error_);
    case kForget:
      settings_.load();
      set_fields_ = 0;
      return result_line(BoardSettings::kDone);
    case kSet:
      return result_line(error_);
    case kNone:
      break;
  }
  return 0;
}

size_t SettingsLine::info_line(bool& is_last) {
  is_last = next_field_ == BoardSettings::kFieldCount;
  if (is_last) return result_line(BoardSettings::kDone);
  const BoardSettings::Field field = static_cast<BoardSettings::Field>(next_field_++);
  begin_line();
  const bool is_secret = BoardSettings::is_secret(field);
  add_text(is_secret ? "secret " : "value ");
  add_text(BoardSettings::field_name(field));
  add_char('=');
  if (is_secret) {
    add_text(settings_.text(field)[0] == 0 ? "unset" : "set");
  } else {
    add_encoded(settings_.text(field));
  }
  return end_line();
}

size_t SettingsLine::result_line(BoardSettings::Error error) {
  begin_line();
  if (error == BoardSettings::kDone) {
    add_text("ok");
  } else {
    add_text("error ");
    add_text(kErrors[error]);
  }
  return end_line();
}

void SettingsLine::begin_line() {
  size_ = 0;
  add_text(kMark);
  uint16_t divisor = 10000;
  while (divisor > 1 && number_ < divisor) divisor = static_cast<uint16_t>(divisor / 10);
  for (; divisor > 0; divisor = static_cast<uint16_t>(divisor / 10)) add_char(kDigits[number_ / divisor % 10]);
  add_char(' ');
}

void SettingsLine::add_text(const char* text) {
  while (*text != 0) add_char(*text++);
}

void SettingsLine::add_encoded(const char* text) {
  for (; *text != 0; ++text) {
    const uint8_t byte = static_cast<uint8_t>(*text);
    if (byte > ' ' && byte < 0x7F && byte != '%' && byte != '#') {
      add_char(*text);
      continue;
    }
    add_char('%');
    add_char(kDigits[byte >> 4]);
    add_char(kDigits[byte & 0x0F]);
  }
}

// Room for the longest line: a name, three characters for each byte of a value, the check.
size_t SettingsLine::end_line() {
  const uint32_t check = crc32(0, reinterpret_cast<const uint8_t*>(line_), size_);
  add_char(' ');
  for (int shift = 28; shift >= 0; shift -= 4) add_char(kDigits[check >> shift & 0x0F]);
  add_char('\n');
  const size_t size = size_;
  size_ = 0;
  return size;
}

}  // namespace hostlink

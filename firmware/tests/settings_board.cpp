// A board with settings on a serial port, for tests/firmware/test_board_settings.py: a pty is its UART, a file its
// flash. Arguments: the file, and the behaviour: "noisy" prints between the answers, "deaf" receives a wrong byte
// now and then, "worn" cannot write its flash, "preferences" is an ESP32, "shared" has a sketch with an EEPROM of its
// own, "forgetful" restarts once between the settings and their storing, "brownout" each time; "pipe": standard input
// and output are its UART, and it ends with them. On standard output the path of the pty, then a line with all settings
// whenever they are stored, passwords too: only the test reads it.
//
// With a second file and "torn": the power fails after each byte of the second one's record, written over the first
// one's or over an erased flash. On standard output, for each, whether what is loaded is of the "first", of the
// "second", or "empty".
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include <memory>
#include <vector>

#include "hostlink/settings_eeprom.h"
#include "hostlink/settings_line.h"
#include "hostlink/settings_preferences.h"

namespace {

class File {
 public:
  explicit File(const char* path) : path_(path) {}
  size_t read(uint8_t* bytes, size_t size) const {
    FILE* file = fopen(path_, "rb");
    if (file == nullptr) return 0;
    const size_t got = fread(bytes, 1, size, file);
    fclose(file);
    return got;
  }
  bool write(const uint8_t* bytes, size_t size) const {
    FILE* file = fopen(path_, "wb");
    if (file == nullptr) return false;
    const bool is_written = fwrite(bytes, 1, size, file) == size;
    return fclose(file) == 0 && is_written;
  }

 private:
  const char* path_;
};

// Like the EEPROM of an ESP8266: a copy in RAM, which begin() reads and commit() writes if a byte of it has changed.
class Eeprom {
 public:
  Eeprom(const char* path, bool is_worn) : file_(path), is_worn_(is_worn) {}
  void begin(size_t size) {
    bytes_.assign(size, 0xFF);
    file_.read(bytes_.data(), size);
    is_dirty_ = false;
  }
  size_t length() { return bytes_.size(); }
  uint8_t read(int at) { return has(at) ? bytes_[static_cast<size_t>(at)] : static_cast<uint8_t>(0); }
  void write(int at, uint8_t value) {
    if (!has(at) || bytes_[static_cast<size_t>(at)] == value) return;
    bytes_[static_cast<size_t>(at)] = value;
    is_dirty_ = true;
  }
  bool commit() { return !is_dirty_ || (!is_worn_ && file_.write(bytes_.data(), bytes_.size())); }

 private:
  bool has(int at) const { return at >= 0 && static_cast<size_t>(at) < bytes_.size(); }

  File file_;
  bool is_worn_;
  bool is_dirty_ = false;
  std::vector<uint8_t> bytes_;
};

// Like the Preferences of an ESP32.
class Preferences {
 public:
  explicit Preferences(const char* path) : file_(path) {}
  bool begin(const char*, bool) { return true; }
  void end() {}
  size_t getBytes(const char*, void* bytes, size_t size) { return file_.read(static_cast<uint8_t*>(bytes), size); }
  size_t putBytes(const char*, const void* bytes, size_t size) {
    return file_.write(static_cast<const uint8_t*>(bytes), size) ? size : 0;
  }

 private:
  File file_;
};

// Like an Arduino Stream.
class Uart {
 public:
  Uart(int descriptor, int out, const char* kind)
      : descriptor_(descriptor), out_(out), is_deaf_(strcmp(kind, "deaf") == 0) {
    restarts_left_ = strcmp(kind, "forgetful") == 0 ? 1 : 0;
  }
  // Whether the power failed: at the first bytes of a request to store.
  bool has_restarted() {
    const bool has = is_restarting_;
    is_restarting_ = false;
    return has;
  }
  int available() {
    if (is_restarting_) return 0;
    pollfd waited = {descriptor_, POLLIN, 0};
    return poll(&waited, 1, 0) > 0 && (waited.revents & POLLIN) != 0 ? 1 : 0;
  }
  int read() {
    uint8_t byte = 0;
    if (::read(descriptor_, &byte, 1) != 1) exit(0);  // the other end is gone
    newest_ = newest_ << 8 | byte;
    if (newest_ == kSave && restarts_left_ > 0) {
      --restarts_left_;
      is_restarting_ = true;
    }
    return is_deaf_ && ++count_ % 193 == 0 ? byte ^ 0x10 : byte;
  }
  unsigned lines() const { return lines_; }
  size_t write(const uint8_t* bytes, size_t size) {
    size_t written = 0;
    ++lines_;
    while (written < size) {
      const ssize_t step = ::write(out_, bytes + written, size - written);
      if (step <= 0) break;
      written += static_cast<size_t>(step);
    }
    return written;
  }
  void flush() {}
  void print(const char* text) { write(reinterpret_cast<const uint8_t*>(text), strlen(text)); }

 private:
  static const uint32_t kSave = 0x73617665;  // "save"

  int descriptor_;
  int out_;
  bool is_deaf_;
  int restarts_left_;
  bool is_restarting_ = false;
  uint32_t newest_ = 0;
  unsigned count_ = 0;
  unsigned lines_ = 0;
};

void report(const hostlink::BoardSettings& settings) {
  printf("%s\t%u\t%s\t%s\t%s\t%s\t%s\n", settings.host(), settings.port(), settings.name(), settings.wifi_name(),
         settings.wifi_password(), settings.key(), settings.update_password());
  fflush(stdout);
}

// The board's end of a new pty; the other end stays open here, so that it may be opened and closed as often as needed.
int open_uart() {
  const int ours = posix_openpt(O_RDWR | O_NOCTTY);
  if (ours < 0 || grantpt(ours) != 0 || unlockpt(ours) != 0) exit(2);
  const int theirs = open(ptsname(ours), O_RDWR | O_NOCTTY);
  termios line = {};
  if (theirs < 0 || tcgetattr(theirs, &line) != 0) exit(2);
  cfmakeraw(&line);
  tcsetattr(theirs, TCSANOW, &line);
  printf("%s\n", ptsname(ours));
  return ours;
}

struct Sketch {
  explicit Sketch(hostlink::SettingsStorage& storage) : settings(storage), line(settings) { settings.load(); }

  hostlink::BoardSettings settings;
  hostlink::SettingsLine line;
};

class Memory : public hostlink::SettingsStorage {
 public:
  explicit Memory(const char* path) { File(path).read(bytes, sizeof bytes); }
  bool read(uint8_t* to, size_t size) override { return memcpy(to, bytes, size) != nullptr; }
  bool write(const uint8_t* from, size_t size) override { return memcpy(bytes, from, size) != nullptr; }

  uint8_t bytes[hostlink::BoardSettings::kStoredBytes] = {};
};

const char* state(const Memory& flash, const Memory& first, const Memory& second) {
  Memory copy(flash);
  hostlink::BoardSettings settings(copy);
  if (!settings.load()) {
    for (uint8_t i = 0; i < hostlink::BoardSettings::kFieldCount; ++i) {
      if (settings.text(static_cast<hostlink::BoardSettings::Field>(i))[0] != 0) return "mixed";
    }
    return "empty";
  }
  if (memcmp(flash.bytes, first.bytes, sizeof first.bytes) == 0) return "first";
  return memcmp(flash.bytes, second.bytes, sizeof second.bytes) == 0 ? "second" : "mixed";
}

int tear(const char* first_path, const char* second_path) {
  const Memory first(first_path);
  const Memory second(second_path);
  for (size_t i = 0; i < 2 * (sizeof first.bytes + 1); ++i) {
    Memory flash(first);
    if (i % 2 == 1) memset(flash.bytes, 0xFF, sizeof flash.bytes);
    memcpy(flash.bytes, second.bytes, i / 2);
    puts(state(flash, first, second));
  }
  return 0;
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 3) return 2;
  const char* kind = arguments[2];
  if (strcmp(kind, "torn") == 0) return count == 4 ? tear(arguments[1], arguments[3]) : 2;
  const bool is_pipe = strcmp(kind, "pipe") == 0;
  const bool is_noisy = strcmp(kind, "noisy") == 0;
  const int descriptor = is_pipe ? 0 : open_uart();
  Uart uart(descriptor, is_pipe ? 1 : descriptor, kind);
  Eeprom eeprom(arguments[1], strcmp(kind, "worn") == 0);
  Preferences preferences(arguments[1]);
  hostlink::EepromStorage<Eeprom> in_eeprom(eeprom, 16);
  hostlink::PreferencesStorage<Preferences> in_preferences(preferences);
  hostlink::SettingsStorage* storage = &in_eeprom;
  if (strcmp(kind, "preferences") == 0) storage = &in_preferences;
  std::unique_ptr<Sketch> sketch(new Sketch(*storage));
  if (!is_pipe) report(sketch->settings);
  if (strcmp(kind, "shared") == 0) eeprom.begin(64);  // its own bytes are before the settings
  for (;;) {
    pollfd waited = {descriptor, POLLIN, 0};
    poll(&waited, 1, sketch->line.has_answer() ? 0 : is_noisy ? 5 : -1);
    if (is_noisy) uart.print("voltage 11.9\xff #hl \r\n#hl 1 ok 00000000\n wheel");
    const bool is_over = (waited.revents & POLLHUP) != 0 && (waited.revents & POLLIN) == 0;
    if (is_over && !sketch->line.has_answer()) return 0;
    const unsigned lines = uart.lines();
    if (sketch->line.spin(uart) && !is_pipe) report(sketch->settings);
    if (uart.lines() > lines + 1) return 3;  // a turn lasts no longer than a line
    if (uart.has_restarted()) sketch.reset(new Sketch(*storage));
  }
}

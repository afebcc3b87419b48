// The board's side of `hostlink board setup` and `info`: lines of text over the serial port, between the sketch's own
// output. A line is "#hl NUMBER WORDS CRC\n": the CRC-32 of everything before its space, in eight hexadecimal digits.
//
//   request               answer
//   info                  value NAME=VALUE, or secret NAME=set|unset, a line each; then: ok
//   set NAME=VALUE        ok, or error unknown|short|long|value; VALUE: bytes outside of ! to ~, and %, as %XX
//   save COUNT            ok when it is stored, or error stored; error lost if not COUNT settings were set since
//                         forget: the board has restarted in between. Nothing is stored then: start again with forget
//   forget                ok; discards what was set since the last save
//
// An answer has the request's number. A request can be repeated. A damaged line is ignored, and the host repeats it.
#pragma once

#include "board_settings.h"

namespace hostlink {

class SettingsLine {
 public:
  static const size_t kLineBytes = 256;

  explicit SettingsLine(BoardSettings& settings) : settings_(settings) {}

  // One turn: reads the available bytes, or answers with one line, so that a slow port delays no watchdog. True: new
  // settings are stored; restart, or reconnect. `Port` is a Stream.
  template <class Port>
  bool spin(Port& port) {
    for (size_t i = 0; i < kBytesPerTurn && !has_answer_ && port.available() > 0; ++i) {
      has_answer_ = add(static_cast<uint8_t>(port.read()));
    }
    if (!has_answer_) return false;
    bool is_last = false;
    bool is_saved = false;
    const size_t size = answer(is_last, is_saved);
    if (size > 0) port.write(reinterpret_cast<const uint8_t*>(line_), size);
    has_answer_ = !is_last;
    if (is_saved) port.flush();  // a restart cuts off bytes that were not sent
    return is_saved;
  }

  // Add one byte. True: it ends a request; call answer() until the last line.
  bool add(uint8_t byte);
  // The next line of the answer is in line(). 0: the request gets none.
  size_t answer(bool& is_last, bool& is_saved);
  const char* line() const { return line_; }
  bool has_answer() const { return has_answer_; }  // another turn must write more

 private:
  static const size_t kBytesPerTurn = 256;
  enum Verb : uint8_t { kNone, kInfo, kSet, kSave, kForget };

  void parse(size_t size);
  void parse_save(const char* count, size_t size);
  BoardSettings::Error set(char* words, size_t size);
  size_t info_line(bool& is_last);
  size_t result_line(BoardSettings::Error error);
  void begin_line();
  void add_text(const char* text);
  void add_encoded(const char* text);
  size_t end_line();
  void add_char(char c) {
    if (size_ < kLineBytes) line_[size_++] = c;
  }

  BoardSettings& settings_;
  char line_[kLineBytes] = {};
  size_t size_ = 0;
  bool is_too_long_ = false;
  bool has_answer_ = false;
  Verb verb_ = kNone;
  uint16_t number_ = 0;
  uint8_t next_field_ = 0;
  uint8_t set_fields_ = 0;  // one bit for each setting since forget
  BoardSettings::Error error_ = BoardSettings::kDone;
};

}  // namespace hostlink

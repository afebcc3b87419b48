// Publishes the state of a board on /diagnostics: a level, a text, and numbers with their names.
#pragma once

#include <diagnostic_msgs/DiagnosticArray.h>

#include "node_handle.h"

namespace ros {

// `kValues`: the most key/value pairs. A text must stay valid; a number becomes a text here.
template <size_t kValues = 4>
class Diagnostics {
 public:
  // Name of the part, and name of the board.
  Diagnostics(const char* name, const char* hardware_id) : publisher_("/diagnostics", &message_) {
    status_.name = name;
    status_.hardware_id = hardware_id;
    status_.values = values_;
    message_.status = &status_;
    message_.status_length = 1;
  }

  bool init(NodeApi& node) { return node.advertise(publisher_); }

  // Start a new status; then add() its values, and publish().
  void set(int8_t level, const char* text) {
    status_.level = level;
    status_.message = text;
    status_.values_length = 0;
  }
  void ok(const char* text = "OK") { set(0, text); }
  void warn(const char* text) { set(1, text); }
  void error(const char* text) { set(2, text); }

  bool add(const char* key, const char* value) {
    if (status_.values_length == kValues) return false;
    diagnostic_msgs::KeyValue& pair = values_[status_.values_length++];
    pair.key = key;
    pair.value = value;
    return true;
  }
  bool add(const char* key, int32_t number) {
    if (status_.values_length == kValues) return false;
    return add(key, write(number, numbers_[status_.values_length]));
  }

  int publish(NodeApi& node) {
    message_.header.stamp = node.now();
    return publisher_.publish(&message_);
  }

 private:
  static const size_t kDigits = 12;

  static const char* write(int32_t number, char* chars) {
    char* at = chars + kDigits - 1;
    *at = '\0';
    uint32_t left = number < 0 ? 0u - static_cast<uint32_t>(number) : static_cast<uint32_t>(number);
    do {
      *--at = static_cast<char>('0' + left % 10);
      left /= 10;
    } while (left > 0);
    if (number < 0) *--at = '-';
    return at;
  }

  diagnostic_msgs::DiagnosticArray message_;
  diagnostic_msgs::DiagnosticStatus status_;
  diagnostic_msgs::KeyValue values_[kValues];
  char numbers_[kValues][kDigits] = {};
  Publisher publisher_;
};

}  // namespace ros

#include "signal_report.h"

#include <string.h>

namespace hostlink {

const uint32_t SignalReport::kSoonest_ms;
const uint32_t SignalReport::kLatest_ms;
const int SignalReport::kChange_dbm;
const size_t SignalReport::kFrameBytesMax;
const int SignalReport::kWeak_dbm;

namespace {

const uint8_t kIdLog = 7;
const uint8_t kDebug = 0;
const uint8_t kWarn = 2;
const int kLeast_dbm = -127;
const size_t kHeaderBytes = 5;
const char kText[] = "WiFi signal ";
const char kUnit[] = " dBm";

size_t add(uint8_t* to, const char* text) {
  const size_t count = strlen(text);
  memcpy(to, text, count);
  return count;
}

size_t add_number(uint8_t* to, int number) {
  char digits[5] = "-";
  const int size = -number;
  size_t count = 1;
  if (size >= 100) digits[count++] = '1';
  if (size >= 10) digits[count++] = static_cast<char>('0' + size / 10 % 10);
  digits[count++] = static_cast<char>('0' + size % 10);
  memcpy(to, digits, count);
  return count;
}

}  // namespace

// A valid level in dBm is negative.
bool SignalReport::is_due(int signal_dbm, uint32_t now_ms) const {
  if (signal_dbm >= 0 || signal_dbm < kLeast_dbm) return false;
  const uint32_t passed_ms = now_ms - reported_at_ms_;
  const int change_dbm = signal_dbm > reported_dbm_ ? signal_dbm - reported_dbm_ : reported_dbm_ - signal_dbm;
  return !has_reported_ || passed_ms >= kLatest_ms || (passed_ms >= kSoonest_ms && change_dbm >= kChange_dbm);
}

size_t SignalReport::write(int signal_dbm, uint32_t now_ms, uint8_t* frame) {
  reported_at_ms_ = now_ms;
  reported_dbm_ = signal_dbm;
  has_reported_ = true;
  uint8_t* const payload = frame + kHeaderBytes + 2;
  const bool is_weak = signal_dbm < kWeak_dbm;
  payload[0] = is_weak && !was_weak_ ? kWarn : kDebug;
  was_weak_ = is_weak;
  uint8_t* const text = payload + 5;
  size_t text_bytes = add(text, kText);
  text_bytes += add_number(text + text_bytes, signal_dbm);
  text_bytes += add(text + text_bytes, kUnit);
  const uint8_t size[4] = {static_cast<uint8_t>(text_bytes), 0, 0, 0};
  memcpy(payload + 1, size, sizeof size);
  const uint8_t payload_bytes = static_cast<uint8_t>(5 + text_bytes);
  const uint8_t header[7] = {0xff, 0xfe, payload_bytes, 0, static_cast<uint8_t>(~payload_bytes), kIdLog, 0};
  memcpy(frame, header, sizeof header);
  uint8_t sum = 0;
  for (size_t i = kHeaderBytes; i < kHeaderBytes + 2 + payload_bytes; ++i) sum = static_cast<uint8_t>(sum + frame[i]);
  frame[kHeaderBytes + 2 + payload_bytes] = static_cast<uint8_t>(~sum);
  return kHeaderBytes + 3 + payload_bytes;
}

}  // namespace hostlink

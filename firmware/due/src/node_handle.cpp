#include "node_handle.h"

#include <string.h>

namespace hostlink {

namespace {

// Of the rosserial protocol and its original client library (docs/protocol.md#special-ids, docs/protocol.md#timing).
const uint16_t kFirstTopicId = 100;
const uint16_t kMaxSubscribers = 25;
const uint8_t kIdPublisher = 0;
const uint8_t kIdSubscriber = 1;
const uint8_t kIdParameter = 6;
const uint8_t kIdLog = 7;
const uint8_t kIdTime = 10;
const uint8_t kIdStop = 11;
const uint32_t kFrameTimeoutMs = 20;
const uint32_t kKeptFrameTimeoutMs = 250;  // a frame of 512 bytes lasts 135 ms at 38400 baud; WiFi pauses come on top
const uint32_t kRetryMs = 10;
const uint32_t kTimeIntervalMs = 2500;
const uint32_t kHostTimeoutMs = 11000;
const size_t kTimeBytes = 8;
const size_t kBytesPerTurn = 1024;  // a flood must not keep the control loop away

uint32_t read_u32(const uint8_t* bytes) {
  return static_cast<uint32_t>(bytes[0]) | static_cast<uint32_t>(bytes[1]) << 8 |
         static_cast<uint32_t>(bytes[2]) << 16 | static_cast<uint32_t>(bytes[3]) << 24;
}

void write_u32(uint8_t* bytes, uint32_t value) {
  for (int i = 0; i < 4; ++i) bytes[i] = static_cast<uint8_t>(value >> (8 * i));
}

}  // namespace

uint16_t NodeHandle::advertise(const char* ns, const char* name, const char* type, const char* md5) {
  if (from_device_count_ == kTopicsMax) return 0;
  Topic topic = {ns, name, type, md5, 0, nullptr, nullptr};
  from_device_[from_device_count_] = topic;
  return static_cast<uint16_t>(kFirstTopicId + kMaxSubscribers + from_device_count_++);
}

void NodeHandle::subscribe(const char* ns, const char* name, const char* type, const char* md5, size_t size,
                           Callback callback, void* context) {
  if (to_device_count_ == kTopicsMax) return;
  Topic topic = {ns, name, type, md5, size, callback, context};
  to_device_[to_device_count_++] = topic;
}

uint32_t NodeHandle::spin() {
  if (!is_spinning_) begin_turn();
  for (size_t count = 0; count < kBytesPerTurn; ++count) {
    const int byte = hal_.read();
    if (byte < 0) {
      if (retry_ == Retry::kPaper && reader_.is_inside() && !is_retrying_) {
        is_retrying_ = true;
        return kRetryMs;
      }
      break;
    }
    is_retrying_ = false;
    if (receive(static_cast<uint8_t>(byte))) break;
  }
  is_spinning_ = false;
  if (is_configured_ && began_ms_ - time_requested_ms_ > kTimeIntervalMs) {
    request_time();
    time_requested_ms_ = began_ms_;
  }
  flush();
  return 0;
}

void NodeHandle::begin_turn() {
  is_spinning_ = true;
  is_retrying_ = false;
  began_ms_ = hal_.millis();
  if (began_ms_ - time_received_ms_ > kHostTimeoutMs) is_configured_ = false;
  const uint32_t timeout_ms = retry_ == Retry::kKeepState ? kKeptFrameTimeoutMs : kFrameTimeoutMs;
  if (reader_.is_inside() && began_ms_ - frame_began_ms_ > timeout_ms) {
    reader_.give_up();
    frame_began_ms_ = began_ms_;
    act(reader_.again());
  }
}

// True when this turn ends here, as the original's does after a request for topics.
bool NodeHandle::receive(uint8_t byte) {
  const uint32_t dropped = reader_.dropped();
  const bool was_inside = reader_.is_inside();
  const FrameReader::Result result = reader_.add(byte);
  if (!was_inside || reader_.dropped() != dropped) frame_began_ms_ = began_ms_;  // another start: its time begins now
  return act(result);
}

bool NodeHandle::act(FrameReader::Result result) {
  bool ends_turn = false;
  while (result == FrameReader::kFrame) {
    ends_turn = act_on_frame() || ends_turn;
    frame_began_ms_ = began_ms_;
    result = reader_.again();
  }
  if (result == FrameReader::kWrongVersion && !is_configured_) request_time();  // shows our version
  return ends_turn;
}

bool NodeHandle::act_on_frame() {
  const uint8_t* payload = reader_.payload();
  const size_t size = reader_.payload_bytes();
  switch (reader_.topic_id()) {
    case kIdPublisher:
      request_time();
      send_topics();
      time_requested_ms_ = time_received_ms_ = began_ms_;
      return true;
    case kIdTime:
      if (size == kTimeBytes) time_received_ms_ = hal_.millis();
      break;
    case kIdParameter:
      receive_parameter(payload, size);
      break;
    case kIdStop:
      is_configured_ = false;
      break;
    default:
      deliver(reader_.topic_id(), payload, size);
  }
  return false;
}

bool NodeHandle::is_expected(uint16_t topic_id, size_t size) const {
  switch (topic_id) {
    case kIdPublisher:
    case kIdStop:
      return size == 0;
    case kIdTime:
      return size == kTimeBytes;
    case kIdParameter:
      return true;
    default:
      const size_t number = static_cast<size_t>(topic_id) - kFirstTopicId;  // too large for the ids below
      return topic_id >= kFirstTopicId && number < to_device_count_ && to_device_[number].size == size;
  }
}

void NodeHandle::deliver(uint16_t topic_id, const uint8_t* payload, size_t size) {
  if (!is_expected(topic_id, size)) {
    ++refused_;
    return;
  }
  const size_t number = static_cast<size_t>(topic_id) - kFirstTopicId;
  ++delivered_;
  to_device_[number].callback(to_device_[number].context, payload, size);
}

bool NodeHandle::publish(uint16_t topic_id, const uint8_t* payload, size_t size) {
  if (topic_id >= kFirstTopicId && !is_configured_) return false;
  if (!begin_frame(topic_id, size)) return false;
  put(payload, size);
  end_frame();
  if (topic_id >= kFirstTopicId) ++published_;
  return true;
}

void NodeHandle::log(uint8_t level, const char* text) {
  if (!begin_frame(kIdLog, 1 + 4 + strlen(text))) return;
  put(&level, 1);
  put_text("", text);
  end_frame();
}

void NodeHandle::request_parameter(const char* ns, const char* name, FloatsCallback callback, void* context) {
  parameter_ = callback;
  parameter_context_ = context;
  if (!begin_frame(kIdParameter, 4 + strlen(ns) + strlen(name))) return;
  put_text(ns, name);
  end_frame();
}

// int32[] ints, float32[] floats, string[] strings: the floats are what this robot requests; ints are read as such.
void NodeHandle::receive_parameter(const uint8_t* payload, size_t size) {
  if (parameter_ == nullptr || size < 4) return;
  float values[kFloatsMax] = {};
  size_t at = 0;
  size_t count = 0;
  for (int kind = 0; kind < 2 && count == 0; ++kind) {
    if (size - at < 4) return;
    const size_t announced = read_u32(payload + at);
    at += 4;
    if (announced > (size - at) / 4) return;
    count = announced < kFloatsMax ? announced : kFloatsMax;
    for (size_t i = 0; i < count; ++i) {
      const uint32_t bits = read_u32(payload + at + 4 * i);
      if (kind == 0) {
        values[i] = static_cast<float>(static_cast<int32_t>(bits));
      } else {
        memcpy(&values[i], &bits, sizeof bits);
      }
    }
    at += 4 * announced;
  }
  FloatsCallback callback = parameter_;
  parameter_ = nullptr;
  callback(parameter_context_, values, count);
}

void NodeHandle::request_time() {
  const uint8_t nothing[kTimeBytes] = {};
  publish(kIdTime, nothing, sizeof nothing);
}

void NodeHandle::send_topics() {
  bool is_whole = true;
  for (size_t i = 0; i < from_device_count_; ++i) {
    const uint16_t topic_id = static_cast<uint16_t>(kFirstTopicId + kMaxSubscribers + i);
    is_whole = send_topic(kIdPublisher, topic_id, from_device_[i]) && is_whole;
  }
  for (size_t i = 0; i < to_device_count_; ++i) {
    is_whole = send_topic(kIdSubscriber, static_cast<uint16_t>(kFirstTopicId + i), to_device_[i]) && is_whole;
  }
  is_configured_ = is_whole;  // else the host receives no data, and requests the topics again
}

bool NodeHandle::send_topic(uint8_t kind, uint16_t topic_id, const Topic& topic) {
  const size_t name_bytes = strlen(topic.ns) + strlen(topic.name);
  if (!begin_frame(kind, 2 + 4 + name_bytes + 4 + strlen(topic.type) + 4 + strlen(topic.md5) + 4)) return false;
  const uint8_t id[2] = {static_cast<uint8_t>(topic_id), static_cast<uint8_t>(topic_id >> 8)};
  put(id, sizeof id);
  put_text(topic.ns, topic.name);
  put_text("", topic.type);
  put_text("", topic.md5);
  uint8_t buffer[4];
  write_u32(buffer, kPayloadBytesMax);
  put(buffer, sizeof buffer);
  end_frame();
  return true;
}

// A frame goes into the queue whole, or not at all. Where there is no room the oldest messages of topics go: the next
// ones replace them. Topics, requests and lines of the log are sent once, and stay.
bool NodeHandle::begin_frame(uint16_t topic_id, size_t payload_bytes) {
  const size_t size = payload_bytes + kOverheadBytes;
  bool has_room = size <= kQueueBytes;
  while (has_room && size > kQueueBytes - queue_size_) has_room = drop_oldest();
  if (!has_room) {
    ++dropped_to_host_;
    return false;
  }
  const uint8_t low = static_cast<uint8_t>(payload_bytes);
  const uint8_t high = static_cast<uint8_t>(payload_bytes >> 8);
  const uint8_t header[5] = {0xFF, 0xFE, low, high, static_cast<uint8_t>(~(low + high))};
  for (size_t i = 0; i < sizeof header; ++i) put_raw(header[i]);
  checksum_ = 0;
  const uint8_t id[2] = {static_cast<uint8_t>(topic_id), static_cast<uint8_t>(topic_id >> 8)};
  put(id, sizeof id);
  return true;
}

// The oldest message of a topic that is not on its way yet; false when there is none.
bool NodeHandle::drop_oldest() {
  for (size_t at = begun_bytes_; at < queue_size_; at += frame_bytes(at)) {
    if (peek(at + 6) == 0 && peek(at + 5) < kFirstTopicId) continue;
    const size_t gone = frame_bytes(at);
    for (size_t from = at + gone; from < queue_size_; ++from) {
      queue_[(queue_head_ + from - gone) % kQueueBytes] = peek(from);
    }
    queue_size_ -= gone;
    ++dropped_to_host_;
    --published_;
    return true;
  }
  return false;
}

// Of the frame that begins there in the queue, by its header.
size_t NodeHandle::frame_bytes(size_t at) const {
  return kOverheadBytes + (static_cast<size_t>(peek(at + 2)) | static_cast<size_t>(peek(at + 3)) << 8);
}

void NodeHandle::put(const uint8_t* bytes, size_t count) {
  for (size_t i = 0; i < count; ++i) {
    checksum_ = static_cast<uint8_t>(checksum_ + bytes[i]);
    put_raw(bytes[i]);
  }
}

void NodeHandle::put_text(const char* first, const char* second) {
  const size_t first_bytes = strlen(first);
  const size_t second_bytes = strlen(second);
  uint8_t size[4];
  write_u32(size, static_cast<uint32_t>(first_bytes + second_bytes));
  put(size, sizeof size);
  put(reinterpret_cast<const uint8_t*>(first), first_bytes);
  put(reinterpret_cast<const uint8_t*>(second), second_bytes);
}

void NodeHandle::end_frame() { put_raw(static_cast<uint8_t>(~checksum_)); }

void NodeHandle::put_raw(uint8_t byte) { queue_[(queue_head_ + queue_size_++) % kQueueBytes] = byte; }

void NodeHandle::flush() {
  while (queue_size_ > 0) {
    const size_t to_end = kQueueBytes - queue_head_;
    const size_t taken = hal_.write(queue_ + queue_head_, queue_size_ < to_end ? queue_size_ : to_end);
    if (taken == 0) return;
    leave(taken);
  }
}

// So many bytes are on the wire: of which frame the rest must follow?
void NodeHandle::leave(size_t count) {
  while (count > 0) {
    if (begun_bytes_ == 0) begun_bytes_ = frame_bytes(0);
    const size_t step = count < begun_bytes_ ? count : begun_bytes_;
    queue_head_ = (queue_head_ + step) % kQueueBytes;
    queue_size_ -= step;
    begun_bytes_ -= step;
    count -= step;
  }
}

}  // namespace hostlink

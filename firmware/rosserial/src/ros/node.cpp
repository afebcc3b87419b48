#include "node.h"

#include <string.h>

#include "own_frames.h"

namespace ros {

namespace {

// From rosserial and its original client library (docs/protocol.md#special-ids, docs/protocol.md#timing).
const uint16_t kIdParameter = 6;
const uint16_t kIdTime = 10;
const uint16_t kIdStop = 11;
const uint32_t kFrameTimeoutMs = 20;
const uint32_t kKeptFrameTimeoutMs = 250;  // a frame of 512 bytes lasts 135 ms at 38400 baud; WiFi pauses come on top
const uint32_t kRetryMs = 10;
const uint32_t kTimeIntervalMs = 2500;
const uint32_t kHostTimeoutMs = 11000;
const uint32_t kLateParameterMs = 1000;  // rosserial_python does not answer for a missing parameter: not longer
const uint16_t kSlowMs = 5;              // half of the last turn: the ring of a UART lasts about ten
const uint16_t kPatienceMs = 1000;
const size_t kTimeBytes = 8;
const size_t kBytesPerTurn = 1024;  // a flood must not block the control loop
const size_t kLogBytes = 5;         // level and length
const int kNeverFits = -2;          // result of send()

bool is_to_host(Kind kind) { return (static_cast<uint8_t>(kind) & 1) == 0; }

}  // namespace

bool Node::add(Sender& sender) {
  return add(sender, senders_, static_cast<uint16_t>(kFirstTopicId + receivers_max_), senders_max_);
}

bool Node::add(Receiver& receiver) { return add(receiver, receivers_, kFirstTopicId, receivers_max_); }

bool Node::add(Sender& sender, Receiver& receiver) {
  const bool is_new = sender.node_ == nullptr;
  if (!add(sender)) return false;
  if (add(receiver)) return true;
  if (!is_new) return false;
  Endpoint** last = &senders_;
  while (*last != &sender) last = &(*last)->next_;
  *last = nullptr;
  sender.node_ = nullptr;
  return false;
}

bool Node::add(Endpoint& endpoint, Endpoint*& first, uint16_t first_id, uint16_t most) {
  if (endpoint.node_ != nullptr) return endpoint.node_ == this;
  const Announcement announcement = {full_name(namespace_, endpoint.name_), 0, endpoint.type_, endpoint.md5_, 0};
  Writer counting(nullptr, 0);
  put_announcement(&announcement, counting);
  if (counting.size() > queue_.payload_bytes_max()) return false;
  uint16_t count = 0;
  Endpoint** last = &first;
  for (; *last != nullptr; last = &(*last)->next_) ++count;
  if (count == most) return false;
  *last = &endpoint;
  endpoint.id_ = static_cast<uint16_t>(first_id + count);
  endpoint.node_ = this;
  return true;
}

void Node::attach(Task& task) {
  if (task.node_ != nullptr) return;
  task.node_ = this;
  task.next_ = tasks_;
  tasks_ = &task;
}

uint32_t Node::spin() {
  if (is_calling_) return 0;
  const bool is_over = !is_spinning_ && begin_turn();
  if (!is_over && !read_link()) return kRetryMs;
  is_spinning_ = false;
  if (is_configured_ && began_ms_ - time_requested_ms_ > kTimeIntervalMs) {
    request_time();
    time_requested_ms_ = began_ms_;
  }
  announce();
  is_calling_ = true;
  for (Task* task = tasks_; task != nullptr; task = task->next_) task->spin(*this);
  is_calling_ = false;
  drain();
  return 0;
}

// Send what is queued. A slow loop waits for a UART: its ring holds 63 bytes on an AVR, and the rest of a longer frame
// would follow a whole turn later.
void Node::drain() {
  uint8_t last_ms = 0;  // the first look at the clock counts as a millisecond
  while (queue_.flush(link_) && patience_ms_ > 0 && link_.drains()) {
    const uint8_t now_ms = static_cast<uint8_t>(link_.milliseconds());
    if (now_ms != last_ms) --patience_ms_;
    last_ms = now_ms;
  }
}

bool Node::spin_until(const bool& is_done, uint32_t timeout_ms) {
  if (!can_wait()) return false;
  const uint32_t began_ms = link_.milliseconds();
  awaited_ = &is_done;
  while (!is_done && link_.milliseconds() - began_ms < timeout_ms) spin();
  awaited_ = nullptr;
  return is_done;
}

// Returns true when the turn ends here.
bool Node::begin_turn() {
  is_spinning_ = true;
  is_retrying_ = false;
  began_ms_ = link_.milliseconds();
  patience_ms_ = static_cast<uint16_t>(began_ms_ - emptied_at_ms_) / 2;
  if (patience_ms_ < kSlowMs) patience_ms_ = 0;
  if (patience_ms_ > kPatienceMs) patience_ms_ = kPatienceMs;
  clock_.advance(began_ms_);
  if (is_configured_ && began_ms_ - time_received_ms_ > kHostTimeoutMs && lose_host()) return true;
  // Bytes after a frame that ended a turn.
  if (reader_.has_frame() && act(reader_.again())) return true;
  return retry_ != Retry::kKeepState && give_up_frame();
}

bool Node::give_up_frame() {
  const uint32_t timeout_ms = retry_ == Retry::kKeepState ? kKeptFrameTimeoutMs : kFrameTimeoutMs;
  if (!reader_.is_inside() || began_ms_ - frame_began_ms_ <= timeout_ms) return false;
  reader_.give_up();
  frame_began_ms_ = began_ms_;
  return act(reader_.again());
}

// False: the clause of the paper waits.
bool Node::read_link() {
  for (size_t count = 0; count < kBytesPerTurn; ++count) {
    const int byte = link_.read();
    if (byte == Link::kRestarted) {
      reader_.clear();
      queue_.clear();
      lose_host();
      return true;
    }
    if (byte < 0) return find_nothing();
    is_retrying_ = false;
    if (receive(static_cast<uint8_t>(byte))) return true;
  }
  return true;
}

// All available bytes were read. False: the clause of the paper waits.
bool Node::find_nothing() {
  emptied_at_ms_ = link_.milliseconds();
  if (retry_ == Retry::kKeepState) {  // only now: the rest may have waited for a blocked loop
    give_up_frame();
    return true;
  }
  if (retry_ != Retry::kPaper || !reader_.is_inside() || is_retrying_) return true;
  is_retrying_ = true;
  return false;
}

// True: the turn ends here, so that the sketch stops what it drives for this host before the next host is read.
bool Node::lose_host() {
  is_configured_ = false;
  announcing_ = nullptr;
  parameter_ = nullptr;
  is_parameter_late_ = false;
  return retry_ == Retry::kKeepState;  // the original continues to read
}

// True when this turn ends here, like the original's after a request for topics.
bool Node::receive(uint8_t byte) {
  const uint32_t dropped = reader_.dropped();
  const bool was_inside = reader_.is_inside();
  const FrameReader::Result result = reader_.add(byte);
  if (!was_inside || reader_.dropped() != dropped) frame_began_ms_ = began_ms_;  // another start: its time begins now
  return act(result);
}

bool Node::act(FrameReader::Result result) {
  while (result == FrameReader::kFrame) {
    const bool ends_turn = act_on_frame();
    frame_began_ms_ = began_ms_;
    if (ends_turn || (awaited_ != nullptr && *awaited_)) return true;  // the bytes after it follow in the next turn
    result = reader_.again();
  }
  if (result == FrameReader::kWrongVersion && !is_configured_) request_time();  // the host sees our version
  return false;
}

bool Node::act_on_frame() {
  uint8_t* payload = reader_.payload();
  const size_t size = reader_.payload_bytes();
  switch (reader_.topic_id()) {
    case static_cast<uint16_t>(Kind::kPublisher):
      if (!is_configured_) emptied_at_ms_ = began_ms_;  // the bytes after it belong to the new connection
      request_time();
      announcing_ = senders_ != nullptr ? senders_ : receivers_;
      if (announcing_ == nullptr) end_announcement();
      announce();
      time_requested_ms_ = time_received_ms_ = began_ms_;
      return true;
    case kIdTime:
      if (size == kTimeBytes) receive_time(payload);
      break;
    case kIdParameter:
      receive_parameter(payload, size);
      break;
    case kIdStop:
      return lose_host();
    default:
      deliver(reader_.topic_id(), payload, size);
  }
  return false;
}

bool Node::is_expected(uint16_t topic_id, size_t size) const {
  switch (topic_id) {
    case static_cast<uint16_t>(Kind::kPublisher):
    case kIdStop:
      return size == 0;
    case kIdTime:
      return size == kTimeBytes;
    case kIdParameter:
      return true;
    default:
      const Receiver* receiver = find_receiver(topic_id);
      return receiver != nullptr && receiver->size_.has(size);
  }
}

// Whether it is a message of a topic, not half of a service.
bool Node::is_replaceable(uint16_t id) const {
  const Endpoint* endpoint = senders_;
  while (endpoint != nullptr && endpoint->id_ != id) endpoint = endpoint->next_;
  return endpoint != nullptr && endpoint->kind_ == Kind::kPublisher;
}

Receiver* Node::find_receiver(uint16_t topic_id) const {
  Endpoint* endpoint = receivers_;
  while (endpoint != nullptr && endpoint->id_ != topic_id) endpoint = endpoint->next_;
  return static_cast<Receiver*>(endpoint);
}

void Node::deliver(uint16_t topic_id, uint8_t* payload, size_t size) {
  Receiver* receiver = find_receiver(topic_id);
  if (receiver == nullptr || !receiver->size_.has(size)) {
    ++refused_;
    return;
  }
  is_calling_ = true;
  const bool is_good = receiver->receive_(*receiver, payload, size);
  is_calling_ = false;
  ++(is_good ? delivered_ : refused_);
}

int Node::publish(const Sender& sender, const void* message, Serialize serialize) {
  if (!is_configured_) return 0;
  const int size = send(sender.id_, message, serialize);
  ++(size < 0 ? not_queued_ : published_);
  if (size == kNeverFits && !has_told_) {
    has_told_ = true;
    send_counted(kIdLog, sender.name_, put_too_large);
  }
  if (patience_ms_ > 0 && !is_calling_) drain();
  return size < 0 ? -1 : size;
}

bool Node::send_counted(uint16_t id, const void* message, Serialize serialize) {
  const bool is_queued = send(id, message, serialize) >= 0;
  if (!is_queued) ++not_queued_;
  return is_queued;
}

void Node::log(Level level, const char* text) {
  const size_t size = strlen(text);
  const size_t most = queue_.payload_bytes_max() - kLogBytes;  // a longer text is cut
  const LogLine line = {level, FlashText(nullptr), text, size < most ? size : most};
  send_counted(kIdLog, &line, put_line);
}

void Node::log(Level level, FlashText text) {
  const size_t most = queue_.payload_bytes_max() - kLogBytes;
  const LogLine line = {level, text, nullptr, text.size() < most ? text.size() : most};
  send_counted(kIdLog, &line, put_line);
}

bool Node::request_parameter(const char* name, ParameterCallback callback, void* context) {
  if (link_.milliseconds() - parameter_forgotten_ms_ >= kLateParameterMs) is_parameter_late_ = false;
  if (parameter_ != nullptr || is_parameter_late_) return false;
  const Name full = full_name(namespace_, name);
  if (send(kIdParameter, &full, put_parameter_name) < 0) return false;
  parameter_ = callback;
  parameter_context_ = context;
  return true;
}

void Node::forget_parameter(const void* context) {
  if (parameter_ == nullptr || parameter_context_ != context) return;
  is_parameter_late_ = true;
  parameter_forgotten_ms_ = link_.milliseconds();
  parameter_ = nullptr;
}

void Node::receive_parameter(uint8_t* payload, size_t size) {
  ParameterAnswer answer;
  if (!answer.read(payload, size)) return;
  is_parameter_late_ = false;
  if (parameter_ == nullptr) return;
  ParameterCallback callback = parameter_;
  parameter_ = nullptr;
  is_calling_ = true;
  callback(parameter_context_, answer);
  is_calling_ = false;
}

void Node::receive_time(uint8_t* payload) {
  time_received_ms_ = link_.milliseconds();
  Reader in(payload, kTimeBytes, nullptr, 0);
  Time host;
  in.get(host);
  if (!host.isZero()) clock_.answer(host, time_received_ms_);
}

void Node::request_time() {
  clock_.request(link_.milliseconds());
  send_counted(kIdTime, nullptr, put_no_time);
}

// What does not fit now follows in the next turns.
void Node::announce() {
  if (announcing_ == nullptr) return;
  while (announcing_ != nullptr) {
    const Endpoint& next = *announcing_;
    const bool to_host = is_to_host(next.kind_);
    const size_t buffer_bytes = to_host ? queue_.payload_bytes_max() : reader_.payload_bytes_max();
    const Announcement announcement = {full_name(namespace_, next.name_), next.id_, next.type_, next.md5_,
                                       static_cast<uint32_t>(buffer_bytes)};
    const uint16_t kind = static_cast<uint16_t>(next.kind_);
    if (send(kind, &announcement, put_announcement) < 0) {
      drain();
      if (send(kind, &announcement, put_announcement) < 0) return;
    }
    announcing_ = next.next_ == nullptr && to_host ? receivers_ : next.next_;
  }
  end_announcement();
}

void Node::end_announcement() {
  is_configured_ = true;
  has_told_ = false;
  ++announcements_;
}

// A frame is queued whole, or not at all: -1 for now, or kNeverFits.
int Node::send(uint16_t id, const void* message, Serialize serialize) {
  Writer out = queue_.open();
  if (!serialize(message, out) || !queue_.has_room(out.size())) {
    if (out.size() > queue_.payload_bytes_max()) return kNeverFits;
    const bool has_room = queue_.make_room(id, out.size());
    if (has_room) out = queue_.open();
    if (!has_room || !serialize(message, out)) return -1;
  }
  queue_.close(id, out.size());
  return static_cast<int>(out.size());
}

}  // namespace ros

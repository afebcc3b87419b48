// NodeHandle: the device side of rosserial: topics, time, log, parameters. No heap; every length from the wire is
// bounded.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frame_reader.h"
#include "hal.h"

namespace hostlink {

// What happens when the bytes of a frame stop coming in its middle (docs/protocol.md#the-retry-clause).
enum class Retry {
  kNone,       // the original library: a frame that is not complete 20 ms after its first byte is dropped
  kPaper,      // the paper's listing 1: the same, but wait 10 ms and read once more before the loop is left
  kKeepState,  // the default: keep what has come and never wait; after 250 ms read it again from its second byte
};

class NodeHandle : private Expected {
 public:
  typedef void (*Callback)(void* context, const uint8_t* payload, size_t size);
  typedef void (*FloatsCallback)(void* context, const float* values, size_t count);  // count 0: there is none

  static const size_t kTopicsMax = 8;  // each way
  static const size_t kFloatsMax = 8;  // of one parameter
  static const size_t kQueueBytes = 2048;

  explicit NodeHandle(Hal& hal, Retry retry = Retry::kKeepState)
      : hal_(hal), retry_(retry), reader_(retry == Retry::kKeepState, *this) {}

  // Announce topics before the first spin(); the texts must stay where they are. advertise() returns the id.
  uint16_t advertise(const char* ns, const char* name, const char* type, const char* md5);
  void subscribe(const char* ns, const char* name, const char* type, const char* md5, size_t size, Callback callback,
                 void* context);

  // One turn. 0: done; else the clause of the paper wants to be called again after so many milliseconds.
  uint32_t spin();

  bool is_configured() const { return is_configured_; }
  // False: dropped and counted. One that is queued may still go for a newer one, when the line is full.
  bool publish(uint16_t topic_id, const uint8_t* payload, size_t size);
  void log(uint8_t level, const char* text);
  void request_parameter(const char* ns, const char* name, FloatsCallback callback, void* context);

  uint32_t delivered() const { return delivered_; }  // messages that reached their callback
  uint32_t published() const { return published_; }  // messages of topics that went to the host, or will
  uint32_t dropped_from_host() const { return reader_.dropped(); }
  uint32_t dropped_to_host() const { return dropped_to_host_; }
  // Good frames with an id or a size that no topic of ours has; kKeepState counts them as dropped, by their header.
  uint32_t refused() const { return refused_; }

 private:
  struct Topic {
    const char* ns;
    const char* name;
    const char* type;
    const char* md5;
    size_t size;
    Callback callback;
    void* context;
  };

  bool is_expected(uint16_t topic_id, size_t size) const override;
  void begin_turn();
  bool receive(uint8_t byte);
  bool act(FrameReader::Result result);
  bool act_on_frame();
  void deliver(uint16_t topic_id, const uint8_t* payload, size_t size);
  void receive_parameter(const uint8_t* payload, size_t size);
  void request_time();
  void send_topics();
  bool send_topic(uint8_t kind, uint16_t topic_id, const Topic& topic);
  bool begin_frame(uint16_t topic_id, size_t payload_bytes);
  void put(const uint8_t* bytes, size_t count);
  void put_text(const char* first, const char* second);
  void end_frame();
  void put_raw(uint8_t byte);
  uint8_t peek(size_t at) const { return queue_[(queue_head_ + at) % kQueueBytes]; }
  size_t frame_bytes(size_t at) const;
  bool drop_oldest();
  void flush();
  void leave(size_t count);

  Hal& hal_;
  Retry retry_;
  FrameReader reader_;
  Topic from_device_[kTopicsMax] = {};
  Topic to_device_[kTopicsMax] = {};
  size_t from_device_count_ = 0;
  size_t to_device_count_ = 0;
  bool is_configured_ = false;
  bool is_spinning_ = false;
  bool is_retrying_ = false;
  uint32_t began_ms_ = 0;
  uint32_t frame_began_ms_ = 0;
  uint32_t time_requested_ms_ = 0;
  uint32_t time_received_ms_ = 0;
  FloatsCallback parameter_ = nullptr;
  void* parameter_context_ = nullptr;
  uint8_t queue_[kQueueBytes] = {};
  size_t queue_head_ = 0;
  size_t queue_size_ = 0;
  size_t begun_bytes_ = 0;  // of the first frame, which is on the wire in part: what is left of it
  uint8_t checksum_ = 0;
  uint32_t dropped_to_host_ = 0;
  uint32_t refused_ = 0;
  uint32_t delivered_ = 0;
  uint32_t published_ = 0;
};

}  // namespace hostlink

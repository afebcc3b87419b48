// Node: the device side of rosserial, independent of the messages: topics, services, time, log, parameters. No heap;
// every length from the wire is bounded. Buffers and endpoints belong to the sketch; node_handle.h has the classes that
// it uses.
#pragma once

#include "endpoint.h"
#include "frame_queue.h"
#include "frame_reader.h"
#include "host_clock.h"
#include "link.h"
#include "parameter_answer.h"
#include "task.h"

namespace ros {

// What to do when the bytes of a frame stop arriving in its middle (docs/protocol.md#the-retry-clause).
enum class Retry : uint8_t {
  kNone,       // the original library: a frame that is not complete 20 ms after its first byte is dropped
  kPaper,      // the paper's listing 1: the same, but wait 10 ms and read once more before leaving the loop
  kKeepState,  // the default: keep the bytes and never wait; after 250 ms read the frame again from its second byte
};

enum class Level : uint8_t { kDebug, kInfo, kWarn, kError, kFatal };

class Node : private Topics {
 public:
  typedef void (*ParameterCallback)(void* context, ParameterAnswer& answer);
  typedef bool (*Serialize)(const void* message, Writer& out);

  // Prefix of every name that begins with neither / nor ~. The text must stay valid.
  void set_namespace(const char* name_space) { namespace_ = name_space; }

  // Before the first spin(). False: there are too many, or the announcement does not fit into the output buffer.
  bool add(Sender& sender);
  bool add(Receiver& receiver);
  bool add(Sender& sender, Receiver& receiver);  // both, or none
  void attach(Task& task);

  // One turn. Returns 0, or with the clause of the paper the milliseconds after which to call it again.
  uint32_t spin();
  // Runs turns until a callback has set `is_done`; the payload of its message then stays until the next turn. False
  // after timeout_ms, and at once where it cannot wait.
  bool spin_until(const bool& is_done, uint32_t timeout_ms);
  bool can_wait() const { return !is_calling_ && awaited_ == nullptr; }  // a callback cannot wait

  bool is_configured() const { return is_configured_; }
  // How often the host was sent the topics, modulo 256. On a link without connections a change shows a new host.
  uint8_t announcements() const { return announcements_; }
  // In a callback: how long its message may have waited for this turn, at most; the link was not empty since then.
  uint32_t waited_ms() { return is_calling_ ? link_.milliseconds() - emptied_at_ms_ : 0; }
  // The bytes of the payload. -1: dropped and counted, for a message larger than the buffer with a line of the log; 0:
  // the host has not asked for topics. A queued message may still be dropped for a newer one when the line is full. In
  // a loop of 8 ms and more it is sent at once; for a UART both publish() and spin() wait, together for as long as the
  // rest of the sketch takes, and for a second at most.
  int publish(const Sender& sender, const void* message, Serialize serialize);
  void log(Level level, const char* text);
  void log(Level level, FlashText text);
  // One at a time: an answer does not name its parameter. False: another answer is expected, or a request was given up
  // less than a second ago; or there is no room.
  bool request_parameter(const char* name, ParameterCallback callback, void* context);
  // Cancel the request of this context. A request of another context, made since the host was lost, stays.
  void forget_parameter(const void* context);

  uint32_t milliseconds() { return link_.milliseconds(); }
  HostClock& clock() { return clock_; }

  uint32_t delivered() const { return delivered_; }                     // messages that reached their callback
  uint32_t published() const { return published_ - queue_.dropped(); }  // messages that went to the host, or will
  uint32_t dropped_from_host() const { return reader_.dropped(); }
  uint32_t dropped_to_host() const { return not_queued_ + queue_.dropped() + queue_.dropped_lines(); }
  // Valid frames with an id, a size or a content that fits no topic; kKeepState counts a wrong id or size as
  // dropped, by their header.
  uint32_t refused() const { return refused_; }

 protected:
  struct Buffers {
    uint8_t* from_host;
    size_t from_host_bytes;
    uint8_t* to_host;
    size_t to_host_bytes;
    size_t message_bytes;  // of a message to the host, at most
  };

  Node(Link& link, const Buffers& buffers, uint16_t receivers_max, uint16_t senders_max, Retry retry)
      : link_(link),
        retry_(retry),
        receivers_max_(receivers_max),
        senders_max_(senders_max),
        reader_(buffers.from_host, buffers.from_host_bytes, retry == Retry::kKeepState, *this),
        queue_(buffers.to_host, buffers.to_host_bytes, buffers.message_bytes, *this) {}
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;
  ~Node() {}

 private:
  bool is_expected(uint16_t topic_id, size_t size) const override;
  bool is_replaceable(uint16_t id) const override;
  bool add(Endpoint& endpoint, Endpoint*& first, uint16_t first_id, uint16_t most);
  bool begin_turn();
  void drain();
  bool read_link();
  bool find_nothing();
  bool give_up_frame();
  bool lose_host();
  bool receive(uint8_t byte);
  bool act(FrameReader::Result result);
  bool act_on_frame();
  Receiver* find_receiver(uint16_t topic_id) const;
  void deliver(uint16_t topic_id, uint8_t* payload, size_t size);
  void receive_time(uint8_t* payload);
  void receive_parameter(uint8_t* payload, size_t size);
  void request_time();
  void announce();
  void end_announcement();
  int send(uint16_t id, const void* message, Serialize serialize);
  bool send_counted(uint16_t id, const void* message, Serialize serialize);

  Link& link_;
  Retry retry_;
  bool is_configured_ = false;
  bool is_spinning_ = false;  // also while the clause of the paper waits
  bool is_retrying_ = false;
  bool is_calling_ = false;  // a callback
  bool has_told_ = false;    // this host, that a message is larger than the buffer
  uint8_t announcements_ = 0;
  uint16_t receivers_max_;
  uint16_t senders_max_;
  FrameReader reader_;
  FrameQueue queue_;
  HostClock clock_;
  const char* namespace_ = "";
  Endpoint* senders_ = nullptr;
  Endpoint* receivers_ = nullptr;
  Endpoint* announcing_ = nullptr;  // the next endpoint
  Task* tasks_ = nullptr;
  const bool* awaited_ = nullptr;  // by spin_until
  uint32_t began_ms_ = 0;
  uint16_t patience_ms_ = 0;    // how long this turn and publish() may still wait for the line: half of the last turn
  uint32_t emptied_at_ms_ = 0;  // all available bytes were read
  uint32_t frame_began_ms_ = 0;
  uint32_t time_requested_ms_ = 0;
  uint32_t time_received_ms_ = 0;
  ParameterCallback parameter_ = nullptr;
  void* parameter_context_ = nullptr;
  uint32_t parameter_forgotten_ms_ = 0;
  bool is_parameter_late_ = false;  // the answer to a request that was given up may still arrive
  uint32_t not_queued_ = 0;
  uint32_t refused_ = 0;
  uint32_t delivered_ = 0;
  uint32_t published_ = 0;
};

}  // namespace ros

// The WiFi side: joining is slow, connections become silent instead of ending when the radio is off, and a peer does
// not notice a close during that time.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace standin {

struct RadioOptions {
  unsigned join_ms = 100;
  int signal_dbm = 31;       // the core's value for no address
  unsigned connect_ms = 20;  // the least duration of a connect()
  size_t send_buffer_bytes = 2920;
  size_t write_limit_bytes = 0;  // the most that one write() accepts; 0: what fits the send buffer
};

enum class Dialling { kNormal, kRefuse, kHang };

// One TCP connection; counts as open until the peer's end, a reset or missing keepalive answers are noticed.
class Connection {
 public:
  Connection(int fd, size_t send_buffer_bytes) : fd_(fd), send_buffer_bytes_(send_buffer_bytes) {}
  ~Connection();
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  void advance(int64_t now_us, bool has_air);
  size_t send_room() const;
  size_t queue(const uint8_t* bytes, size_t count);  // adds as many as there is room for
  size_t available() const { return received_.size(); }
  size_t read(uint8_t* bytes, size_t limit_bytes);
  bool is_open() const { return is_open_; }
  bool is_flushed() const { return send_room() == send_buffer_bytes_; }
  void keep_alive(int64_t limit_us) { keep_alive_us_ = limit_us; }
  int fd() const { return fd_; }
  bool wants_bytes() const { return is_open_ && received_.size() < kReceiveBytes; }
  int release();  // the socket, without closing it

 private:
  static constexpr size_t kReceiveBytes = 5840;

  void receive();
  void send();

  int fd_;
  size_t send_buffer_bytes_;
  std::vector<uint8_t> received_;
  std::vector<uint8_t> queued_;
  bool is_open_ = true;
  int64_t heard_us_ = 0;
  int64_t keep_alive_us_ = 0;
};

class Radio {
 public:
  RadioOptions options;
  Dialling dialling = Dialling::kNormal;

  void join(int64_t now_us);
  void set_up(bool is_up, int64_t now_us);
  void set_mute(bool is_mute) { is_mute_ = is_mute; }
  bool is_joined(int64_t now_us) const;
  bool has_air(int64_t now_us) const { return is_joined(now_us) && !is_mute_; }
  void advance(int64_t now_us);
  std::vector<int> fds(int64_t now_us) const;

  std::shared_ptr<Connection> adopt(int fd);
  void bury(int fd) { ghosts_.push_back(fd); }  // closed while silent: the peer still considers it open

  size_t closed_in_silence() const { return ghosts_.size(); }

  unsigned begins = 0;
  unsigned connects = 0;
  uint64_t sent_writes = 0;

 private:
  std::vector<std::weak_ptr<Connection>> connections_;
  std::vector<int> ghosts_;
  bool is_up_ = true;
  bool is_mute_ = false;
  bool wants_join_ = false;
  int64_t joined_at_us_ = 0;
};

}  // namespace standin

// A UART and its wire: 10 bits a byte, a 128-byte transmit FIFO, a receive ring that loses bytes when it is full.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <vector>

namespace standin {

class UartLine {
 public:
  static constexpr size_t kTransmitBytes = 128;

  void open(const std::string& where);  // listen:PORT, connect:HOST:PORT or pty; throws std::runtime_error
  void begin(unsigned long baud);       // 0: as fast as bytes come
  void set_ring_bytes(size_t bytes) { ring_bytes_ = bytes; }
  bool has_peer() const { return fd_ >= 0; }
  void advance(int64_t now_us);
  void add_noise(unsigned bytes);

  // When the next byte is due, for the sleep of the machine; fds() are the other events.
  int64_t next_event_us(int64_t now_us) const;
  std::vector<int> fds() const;

  size_t available() const { return received_.size(); }
  int read();
  size_t transmit_room() const { return kTransmitBytes - std::min(kTransmitBytes, transmitting_.size()); }
  void transmit(uint8_t byte) { transmitting_.push_back(byte); }

  uint64_t received_bytes = 0;
  uint64_t overflowed_bytes = 0;
  uint64_t transmitted_bytes = 0;
  uint64_t lost_bytes = 0;  // sent while the other end was not connected

 private:
  // Bytes pass one by one; a busy wire keeps its rate when this process is scheduled late.
  struct Lane {
    int64_t next_us = 0;
    bool is_busy = false;
  };

  void listen_on(const std::string& port);
  void connect_to(const std::string& host, const std::string& port);
  void open_pty();
  void find_peer(int64_t now_us);
  void receive(int64_t now_us);
  bool fill();
  void send(int64_t now_us);
  void put_on_wire(const std::vector<uint8_t>& bytes);
  void hang_up();

  std::deque<uint8_t> received_;
  std::deque<uint8_t> transmitting_;
  std::vector<uint8_t> arriving_;  // read from the socket, not yet on the wire
  size_t arrived_ = 0;
  Lane receive_lane_;
  Lane send_lane_;
  size_t ring_bytes_ = 256;
  double byte_us_ = 0;
  int fd_ = -1;
  int listener_ = -1;
  bool is_pty_ = false;
  std::string host_, port_;
  int64_t redial_us_ = 0;
};

}  // namespace standin

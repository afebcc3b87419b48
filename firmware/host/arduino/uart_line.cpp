#include "uart_line.h"

#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <pty.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <stdexcept>

namespace standin {

namespace {
constexpr int64_t kRedial_us = 100000;
constexpr int64_t kAfterAPause_us = 1000000;

void set_low_latency(int fd) {
  const int one = 1;
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
  fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
}

std::runtime_error failure(const std::string& what) { return std::runtime_error(what + ": " + std::strerror(errno)); }
}  // namespace

void UartLine::open(const std::string& where) {
  const size_t colon = where.find(':');
  const std::string kind = where.substr(0, colon);
  const std::string rest = colon == std::string::npos ? "" : where.substr(colon + 1);
  if (kind == "pty") return open_pty();
  if (kind == "listen") return listen_on(rest);
  const size_t last = rest.rfind(':');
  if (kind != "connect" || last == std::string::npos) throw std::runtime_error("not a UART: " + where);
  connect_to(rest.substr(0, last), rest.substr(last + 1));
}

void UartLine::listen_on(const std::string& port) {
  listener_ = socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  const int one = 1;
  setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<uint16_t>(std::stoul(port)));
  socklen_t length = sizeof address;
  if (bind(listener_, reinterpret_cast<sockaddr*>(&address), length) != 0) throw failure("UART port " + port);
  if (listen(listener_, 1) != 0) throw failure("UART port " + port);
  getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &length);
  std::printf("{\"event\": \"uart.listening\", \"port\": %d}\n", ntohs(address.sin_port));
}

void UartLine::connect_to(const std::string& host, const std::string& port) {
  host_ = host;
  port_ = port;
}

void UartLine::open_pty() {
  int other = -1;
  char name[128];
  if (openpty(&fd_, &other, name, nullptr, nullptr) != 0) throw failure("pty");
  termios raw{};
  tcgetattr(other, &raw);
  cfmakeraw(&raw);
  tcsetattr(other, TCSANOW, &raw);  // `other` stays open: the line outlives its users
  fcntl(fd_, F_SETFL, O_NONBLOCK);
  is_pty_ = true;
  std::printf("{\"event\": \"uart.listening\", \"pty\": \"%s\"}\n", name);
}

void UartLine::begin(unsigned long baud) { byte_us_ = baud == 0 ? 0 : 10e6 / static_cast<double>(baud); }

void UartLine::add_noise(unsigned bytes) {
  uint32_t random = 0x2545f491;
  for (unsigned i = 0; i < bytes; ++i) {
    random = random * 1664525u + 1013904223u;
    const auto byte = static_cast<uint8_t>(random >> 24);
    transmitting_.push_back(i % 16 == 7 ? 0xff : byte);  // sometimes a false start of a frame
  }
}

void UartLine::advance(int64_t now_us) {
  if (fd_ < 0 || listener_ >= 0) find_peer(now_us);
  receive(now_us);
  send(now_us);
}

// The last caller is the device: it may have restarted.
void UartLine::find_peer(int64_t now_us) {
  int found = -1;
  if (listener_ >= 0) {
    found = accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
  } else if (!host_.empty() && now_us >= redial_us_) {
    redial_us_ = now_us + kRedial_us;
    addrinfo hints{}, *address = nullptr;
    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(host_.c_str(), port_.c_str(), &hints, &address) != 0) return;
    found = socket(address->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (::connect(found, address->ai_addr, address->ai_addrlen) != 0) {
      ::close(found);
      found = -1;
    }
    freeaddrinfo(address);
  }
  if (found < 0) return;
  hang_up();
  fd_ = found;
  set_low_latency(fd_);
}

void UartLine::hang_up() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
  arriving_.clear();
  arrived_ = 0;
}

bool UartLine::fill() {
  if (arrived_ < arriving_.size()) return true;
  if (fd_ < 0) return false;
  arriving_.resize(4096);
  arrived_ = 0;
  const ssize_t count = ::read(fd_, arriving_.data(), arriving_.size());
  arriving_.resize(count > 0 ? static_cast<size_t>(count) : 0);
  if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR && !is_pty_)) hang_up();
  return !arriving_.empty();
}

void UartLine::receive(int64_t now_us) {
  Lane& lane = receive_lane_;
  while (true) {
    if (!fill()) {
      lane.is_busy = false;
      return;
    }
    if (!lane.is_busy) lane.next_us = now_us + static_cast<int64_t>(byte_us_);
    lane.is_busy = true;
    if (lane.next_us > now_us) return;
    lane.next_us += static_cast<int64_t>(byte_us_);
    ++received_bytes;
    const uint8_t byte = arriving_[arrived_++];
    if (received_.size() < ring_bytes_) {
      received_.push_back(byte);
    } else {
      ++overflowed_bytes;
    }
  }
}

void UartLine::send(int64_t now_us) {
  Lane& lane = send_lane_;
  std::vector<uint8_t> bytes;
  while (!transmitting_.empty()) {
    if (!lane.is_busy) lane.next_us = now_us + static_cast<int64_t>(byte_us_);
    lane.is_busy = true;
    if (lane.next_us > now_us) break;
    lane.next_us += static_cast<int64_t>(byte_us_);
    bytes.push_back(transmitting_.front());
    transmitting_.pop_front();
  }
  if (transmitting_.empty()) lane.is_busy = false;
  if (!bytes.empty()) put_on_wire(bytes);
}

void UartLine::put_on_wire(const std::vector<uint8_t>& bytes) {
  const ssize_t written = fd_ < 0   ? -1
                          : is_pty_ ? ::write(fd_, bytes.data(), bytes.size())
                                    : ::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  const size_t count = written > 0 ? static_cast<size_t>(written) : 0;
  transmitted_bytes += count;
  lost_bytes += bytes.size() - count;
}

int UartLine::read() {
  if (received_.empty()) return -1;
  const int byte = received_.front();
  received_.pop_front();
  return byte;
}

int64_t UartLine::next_event_us(int64_t now_us) const {
  int64_t next_us = now_us + kAfterAPause_us;
  if (receive_lane_.is_busy) next_us = std::min(next_us, receive_lane_.next_us);
  if (send_lane_.is_busy) next_us = std::min(next_us, send_lane_.next_us);
  return next_us;
}

std::vector<int> UartLine::fds() const {
  std::vector<int> fds;
  if (fd_ >= 0 && !receive_lane_.is_busy) fds.push_back(fd_);
  if (listener_ >= 0) fds.push_back(listener_);
  return fds;
}

}  // namespace standin

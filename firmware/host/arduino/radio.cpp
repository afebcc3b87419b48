#include "radio.h"

#include <linux/sockios.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

namespace standin {

Connection::~Connection() {
  if (fd_ >= 0) ::close(fd_);
}

int Connection::release() {
  const int fd = fd_;
  fd_ = -1;
  is_open_ = false;
  return fd;
}

void Connection::advance(int64_t now_us, bool has_air) {
  if (!is_open_) return;
  if (has_air) {
    heard_us_ = now_us;
    send();
    receive();
  } else if (keep_alive_us_ > 0 && queued_.empty() && now_us - heard_us_ > keep_alive_us_) {
    is_open_ = false;
  }
}

void Connection::receive() {
  uint8_t bytes[2048];
  while (wants_bytes()) {
    const ssize_t count = ::recv(fd_, bytes, std::min(sizeof bytes, kReceiveBytes - received_.size()), MSG_DONTWAIT);
    if (count > 0) {
      received_.insert(received_.end(), bytes, bytes + count);
      continue;
    }
    if (count < 0 && (errno == EAGAIN || errno == EINTR)) return;
    is_open_ = false;                  // like the core: closed while bytes of the peer are unread
    if (count < 0) received_.clear();  // a reset discards them
  }
}

void Connection::send() {
  while (!queued_.empty()) {
    const ssize_t count = ::send(fd_, queued_.data(), queued_.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (count <= 0) {
      is_open_ = is_open_ && (errno == EAGAIN || errno == EINTR);
      return;
    }
    queued_.erase(queued_.begin(), queued_.begin() + count);
  }
}

// The real stack keeps bytes until the peer has acknowledged them.
size_t Connection::send_room() const {
  int unacknowledged = 0;
  if (fd_ < 0 || ioctl(fd_, SIOCOUTQ, &unacknowledged) != 0) return 0;
  const size_t used = queued_.size() + static_cast<size_t>(unacknowledged);
  return used < send_buffer_bytes_ ? send_buffer_bytes_ - used : 0;
}

size_t Connection::queue(const uint8_t* bytes, size_t count) {
  const size_t taken = std::min(count, send_room());
  queued_.insert(queued_.end(), bytes, bytes + taken);
  return taken;
}

size_t Connection::read(uint8_t* bytes, size_t limit_bytes) {
  const size_t count = std::min(limit_bytes, received_.size());
  std::copy_n(received_.begin(), count, bytes);
  received_.erase(received_.begin(), received_.begin() + static_cast<std::ptrdiff_t>(count));
  return count;
}

void Radio::join(int64_t now_us) {
  ++begins;
  wants_join_ = true;
  joined_at_us_ = now_us + options.join_ms * 1000;
}

void Radio::set_up(bool is_up, int64_t now_us) {
  if (is_up && !is_up_) joined_at_us_ = now_us + options.join_ms * 1000;
  is_up_ = is_up;
}

bool Radio::is_joined(int64_t now_us) const { return is_up_ && wants_join_ && now_us >= joined_at_us_; }

void Radio::advance(int64_t now_us) {
  for (const auto& weak : connections_) {
    if (const auto connection = weak.lock()) connection->advance(now_us, has_air(now_us));
  }
}

std::vector<int> Radio::fds(int64_t now_us) const {
  std::vector<int> fds;
  for (const auto& weak : connections_) {
    const auto connection = weak.lock();
    if (connection && connection->wants_bytes() && has_air(now_us)) fds.push_back(connection->fd());
  }
  return fds;
}

std::shared_ptr<Connection> Radio::adopt(int fd) {
  ++connects;
  const auto is_gone = [](const std::weak_ptr<Connection>& weak) { return weak.expired(); };
  connections_.erase(std::remove_if(connections_.begin(), connections_.end(), is_gone), connections_.end());
  const auto connection = std::make_shared<Connection>(fd, options.send_buffer_bytes);
  connections_.push_back(connection);
  return connection;
}

}  // namespace standin

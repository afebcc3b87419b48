#include "tcp_socket.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

bool TcpSocket::connect(const char* host, uint16_t port) {
  close();
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  if (inet_pton(AF_INET, host, &address.sin_addr) != 1) return false;
  descriptor_ = ::socket(AF_INET, SOCK_STREAM, 0);
  if (::connect(descriptor_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    close();
    return false;
  }
  const int yes = 1;
  ::setsockopt(descriptor_, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
  return true;
}

void TcpSocket::close() {
  if (descriptor_ >= 0) ::close(descriptor_);
  descriptor_ = -1;
  at_ = count_ = 0;
}

void TcpSocket::fill() {
  if (at_ < count_ || descriptor_ < 0) return;
  const ssize_t got = ::recv(descriptor_, bytes_, sizeof bytes_, MSG_DONTWAIT);
  if (got == 0 || (got < 0 && errno != EAGAIN)) {
    close();
    return;
  }
  at_ = 0;
  count_ = got > 0 ? static_cast<int>(got) : 0;
}

int TcpSocket::available() {
  fill();
  return count_ - at_;
}

int TcpSocket::read() { return available() > 0 ? bytes_[at_++] : -1; }

size_t TcpSocket::write(const uint8_t* bytes, size_t size) {
  if (descriptor_ < 0) return 0;
  const ssize_t sent = ::send(descriptor_, bytes, size, MSG_DONTWAIT | MSG_NOSIGNAL);
  return sent > 0 ? static_cast<size_t>(sent) : 0;
}

int TcpSocket::room() {
  pollfd wanted = {descriptor_, POLLOUT, 0};
  return descriptor_ >= 0 && ::poll(&wanted, 1, 0) > 0 && (wanted.revents & POLLOUT) != 0 ? 128 : 0;
}

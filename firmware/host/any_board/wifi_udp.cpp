#include <arpa/inet.h>
#include <sys/socket.h>

#include "WiFiUdp.h"

extern const char* const& standin_host;
extern const uint16_t& standin_port;

uint8_t WiFiUDP::begin(uint16_t) {
  descriptor_ = ::socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_port = htons(standin_port);
  inet_pton(AF_INET, standin_host, &address.sin_addr);
  return ::connect(descriptor_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 ? 1 : 0;
}

int WiFiUDP::beginPacket(IPAddress host, uint16_t port) {
  to_ = host;
  port_ = port;
  out_size_ = 0;
  return 1;
}

size_t WiFiUDP::write(const uint8_t* bytes, size_t size) {
  const size_t room = sizeof out_ - out_size_;
  const size_t taken = size < room ? size : room;
  memcpy(out_ + out_size_, bytes, taken);
  out_size_ += taken;
  return taken;
}

int WiFiUDP::endPacket() { return ::send(descriptor_, out_, out_size_, MSG_DONTWAIT | MSG_NOSIGNAL) > 0 ? 1 : 0; }

int WiFiUDP::parsePacket() {
  const ssize_t got = ::recv(descriptor_, in_, sizeof in_, MSG_DONTWAIT);
  at_ = 0;
  count_ = got > 0 ? static_cast<int>(got) : 0;
  from_ = to_;  // the socket is connected to one host
  return count_;
}

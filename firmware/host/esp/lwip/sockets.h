// Stand-in for lwIP's sockets, which an ESP32's core has.
#pragma once

#include <stddef.h>

#define MSG_DONTWAIT 0x08

int send(int descriptor, const void* bytes, size_t size, int flags);

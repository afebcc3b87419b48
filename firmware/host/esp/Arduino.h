// Stand-in for Arduino.h of an ESP8266 (with ESP8266 defined) or an ESP32 (with ESP32): names and types of their cores,
// without their code. For compiling only.
#pragma once

#include "../any_board/Arduino.h"

#if defined(ESP32)
uint32_t esp_random();
#else
#define RANDOM_REG32 (*reinterpret_cast<volatile uint32_t*>(0x3FF20E44))
#endif

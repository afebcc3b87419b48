// rosserial for any board: the header that a sketch includes. The API reads like ros_lib's; README.md has differences.
//
// On an Arduino core `ros::NodeHandle` is a node on Serial. With ROSSERIAL_ARDUINO_TCP defined before, as in ros_lib,
// it is one on TCP: WiFi on an ESP8266 or ESP32, otherwise an Ethernet shield.
#pragma once

#include "ros/node_handle.h"

#if defined(ARDUINO)
#include "ArduinoHardware.h"

namespace ros {

#if defined(__AVR_ATmega328P__) || defined(__AVR_ATmega168__) || defined(__AVR_ATmega32U4__)
typedef NodeHandle_<ArduinoHardware, 25, 25, 280, 280> NodeHandle;  // of 2 to 2.5 KB
#else
typedef NodeHandle_<ArduinoHardware> NodeHandle;
#endif

}  // namespace ros
#endif

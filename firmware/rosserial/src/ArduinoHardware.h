// Hardware of ros::NodeHandle, with ros_lib's names for header and class; ros.h has the choices.
#pragma once

#if !defined(ROSSERIAL_ARDUINO_TCP)
#include "hostlink/stream_hardware.h"
typedef hostlink::StreamHardware ArduinoHardware;
#elif defined(ESP8266) || defined(ESP32)
#include "hostlink/wifi.h"
typedef hostlink::WifiHardware ArduinoHardware;
#else
#include "hostlink/ethernet.h"
typedef hostlink::EthernetHardware ArduinoHardware;
#endif

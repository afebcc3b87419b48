// Stand-in for ESP8266WiFi.h.
#pragma once

#include "WiFi.h"

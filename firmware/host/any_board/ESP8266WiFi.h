// Stand-in: the same names as WiFi.h of an ESP32.
#pragma once

#include "WiFi.h"

// Base class of every message.
#pragma once

#include "flash_text.h"
#include "wire.h"

namespace ros {

class Msg {};

}  // namespace ros

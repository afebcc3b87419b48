// Ethernet shields (W5100, W5500): the TCP connection to the host. The sketch begins Ethernet itself.
#pragma once

#include <Ethernet.h>

#include "client_hardware.h"

namespace hostlink {

typedef ClientHardware<EthernetClient> EthernetHardware;

}  // namespace hostlink

"""hostlink: the host for rosserial robots."""

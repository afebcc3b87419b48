"""hostlink: a host for rosserial robots."""

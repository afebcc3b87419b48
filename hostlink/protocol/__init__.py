"""rosserial on the wire: pure, no I/O, no clock."""

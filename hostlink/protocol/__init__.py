"""rosserial protocol: frames, sessions, topic negotiation. No I/O and no clock."""

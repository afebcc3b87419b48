"""The rosserial protocol: frames, topic negotiation, sessions. No I/O and no clock."""

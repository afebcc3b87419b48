"""A rosserial robot without hardware."""

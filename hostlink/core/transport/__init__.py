"""Transports: bytes to and from a device over TCP, UDP or a serial port. They do not know frames."""

"""The ways in for devices: TCP, UDP and serial ports."""

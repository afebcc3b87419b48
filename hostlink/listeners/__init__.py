"""The ways in for devices: TCP connections and serial ports."""

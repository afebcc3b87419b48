"""Listeners for devices on TCP, UDP and serial ports."""

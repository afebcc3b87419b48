"""Protocols that devices speak: DeviceSession and DeviceProtocol, and rosserial as their first implementation."""

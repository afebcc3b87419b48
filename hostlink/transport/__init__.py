"""Bytes in and out of a device; knows no frame."""

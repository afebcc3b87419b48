"""Translates between the hub and client programs. Decides nothing."""

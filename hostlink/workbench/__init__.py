"""Programs that measure and simulate robots."""

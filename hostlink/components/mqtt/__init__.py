"""Component that offers the robots to an MQTT broker: states, stops, locks, velocities, Home Assistant."""

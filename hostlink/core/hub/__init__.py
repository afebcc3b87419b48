"""All devices together: topics, services, parameters, robots."""

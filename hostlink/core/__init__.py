"""The part that holds robots: device protocols, links, the hub and the rules of velocities."""

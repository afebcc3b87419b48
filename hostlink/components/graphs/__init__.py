"""Other graphs: each is bridged by participants of the hub, and loaded only when it is asked for."""

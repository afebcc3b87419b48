"""DDS-XRCE as micro-ROS boards speak it, host side: wire format, framings, streams, session. Pure."""

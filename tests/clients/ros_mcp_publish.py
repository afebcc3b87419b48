"""Answer of ros-mcp to an assistant that publishes a velocity: python ros_mcp_publish.py PORT TOPIC.

Runs in build/ros-mcp-venv, with ros-mcp as a process that speaks MCP, as its users start it. Prints the answers of its
tools as one JSON object.
"""

import asyncio
import json
import sys

from fastmcp import Client
from fastmcp.client.transports import StdioTransport

TWIST = {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


async def main() -> None:
    port, topic = int(sys.argv[1]), sys.argv[2]
    named = {"topic": topic, "msg_type": "geometry_msgs/Twist"}
    async with Client(StdioTransport(sys.executable, ["-m", "ros_mcp.main"])) as assistant:
        await assistant.call_tool("connect_to_robot", {"ip": "127.0.0.1", "port": port})
        once = await assistant.call_tool("publish_once", {**named, "msg": TWIST})
        durations = {"messages": [TWIST], "durations": [0.0]}
        several = await assistant.call_tool("publish_for_durations", {**named, **durations})
    sys.stdout.write(json.dumps({"publish_once": once.data, "publish_for_durations": several.data}))


if __name__ == "__main__":
    asyncio.run(main())

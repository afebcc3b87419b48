"""Answers of ros-mcp's tools to an assistant: python ros_mcp_tools.py CALLS [SERVER].

CALLS is JSON: a list of [tool, arguments]. Runs in build/ros-mcp-venv, with ros-mcp as a process that speaks MCP, as
its users start it: `-m ros_mcp.main`, or the program SERVER. Prints the answers as a JSON list.
"""

import asyncio
import json
import sys

from fastmcp import Client
from fastmcp.client.transports import StdioTransport


async def main() -> None:
    calls, server = json.loads(sys.argv[1]), sys.argv[2:] or ["-m", "ros_mcp.main"]
    answers = []
    async with Client(StdioTransport(sys.executable, server)) as assistant:
        for tool, arguments in calls:
            answer = await assistant.call_tool(tool, arguments)
            answers.append(answer.data)
    sys.stdout.write(json.dumps(answers))


if __name__ == "__main__":
    asyncio.run(main())

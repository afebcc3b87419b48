"""List the topics, subscribe to one, publish on another, call a service.

Needs a running daemon with robot_0: start `hostlink demo`, then run `python any_topic.py`.
"""

import argparse
import asyncio
import sys

import hostlink.client


async def main(url: str) -> None:
    async with hostlink.client.connect(url) as host:
        for topic in await host.topics():
            print(f"{topic['name']}: {topic['type']}, {topic['messages']} messages so far")

        async with host.subscribe("/robot_0/odometry", throttle_rate_ms=500) as poses:
            pose = await anext(poses)  # a geometry_msgs/Pose2D, as a dict of its fields
            print(f"robot_0 is at {pose['x']:.2f}, {pose['y']:.2f}")

        async with (
            host.advertise("/greetings", "std_msgs/String"),
            host.subscribe("/greetings") as greetings,
        ):
            await host.publish("/greetings", {"data": "hello"})
            print((await anext(greetings))["data"])

        answer = await host.call("/rosapi/topic_type", {"topic": "/robot_0/odometry"})
        print(answer["type"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("url", nargs="?", default=hostlink.client.DEFAULT_URL, help="of the daemon (%(default)s)")
    arguments = parser.parse_args()
    print(__doc__)
    try:
        asyncio.run(main(arguments.url))
    except hostlink.client.HostlinkError as error:
        sys.exit(str(error))

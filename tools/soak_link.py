"""The paper's link in real time: daemon, relay and simulated robot over TCP, every message counted (`make soak`).

A lost segment every two minutes and one cut half-way, as in tests/integration/test_the_papers_link.py, or the faults
that the options name. Prints the row of docs/reliability.md; ends with status 1 when a message was lost outside the
cuts.
"""

import argparse
import asyncio
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.cli.serve import running
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config, LinkConfig, TcpConfig
from hostlink.core.messages.catalog import Catalog
from hostlink.core.runtime import logs
from tests.support.link_report import Account
from tests.support.virtual_device import POSE, NumberedRobot, VirtualDevice
from tests.support.virtual_world import NUMBERS, command
from tools.fault_script import parse
from tools.faults import Script
from tools.relay import Relay, TcpEnd, connect_tcp, listen_tcp

COMMAND_INTERVAL_S = 0.1
LOOP_S = 1 / 60
SETTLE_S = 2.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--line", action="append", help="a line of the script instead of the paper's link's")
    arguments = parser.parse_args()
    logs.configure(level="error")
    lines = arguments.line or ["every 120 lose", f"at {arguments.seconds / 2} cut"]
    robot = NumberedRobot(Catalog())
    robot.publish_every = round(0.1 / LOOP_S)
    account = asyncio.run(drive(robot, parse([f"seed {arguments.seed}", *lines]), arguments.seconds))
    # A busy machine turns the robot's loop late, and then its ring of 127 bytes is too small: the robot's own loss.
    own = {"ring_bytes": robot.device.from_host.lost_bytes, "frames": robot.device.dropped_frames}
    print(json.dumps({"seconds": arguments.seconds, "script": lines, **account.row(), "lost by the robot": own}))
    outside = sum(outside for outside, _ in account.lost().values())
    return 1 if outside > own["frames"] else 0


async def drive(robot: NumberedRobot, script: Script, seconds: float) -> Account:
    """Commands ten times a second through the relay, odometry as often."""
    config = Config(tcp=TcpConfig(host="127.0.0.1", port=0), link=LinkConfig(uart_bytes_s=3840)).with_tables(
        api=ApiConfig(port=0)
    )
    account = Account(poses_sent=robot.sent)
    loop = asyncio.get_running_loop()
    async with running(config) as (hub, addresses), asyncio.TaskGroup() as tasks:

        async def reach_host() -> TcpEnd:
            return await connect_tcp(*addresses.tcp)

        def accept(end: TcpEnd) -> None:
            running_tasks.append(tasks.create_task(relay.serve(end)))

        async def dial() -> TcpEnd:
            return await connect_tcp(*server.sockets[0].getsockname()[:2])

        relay = Relay(script, reach_host, lambda what, _: account.faults.append((loop.time(), what)))
        hub.join("soak").subscribe(
            "/robot_0/odometry",
            lambda message: account.poses_received.append((loop.time(), int(POSE.unpack(message.payload)[0]))),
        )
        async with await listen_tcp(accept, "127.0.0.1", 0) as server:
            device = VirtualDevice(robot, dial, loop_s=LOOP_S)
            running_tasks = [tasks.create_task(device.run()), tasks.create_task(relay.run())]
            await asyncio.sleep(SETTLE_S)
            for number in range(round(seconds / COMMAND_INTERVAL_S)):
                if command(hub, number % NUMBERS):
                    account.commands_sent.append((loop.time(), number % NUMBERS))
                await asyncio.sleep(COMMAND_INTERVAL_S)
            await asyncio.sleep(SETTLE_S)
            for task in running_tasks:
                task.cancel()
    account.obeyed(robot.commands)
    return account


if __name__ == "__main__":
    sys.exit(main())

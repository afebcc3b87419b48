"""tools/chaos.py between a device and a running daemon, over TCP: the faults that end a connection; the program."""

import asyncio
import contextlib
import json
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.daemon import daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
from tests.support.waiting import expect
from tools.fault_script import parse
from tools.faults import Fault, Kind
from tools.relay import Relay, TcpEnd, connect_tcp, listen_tcp

CHAOS = Path(__file__).parents[2] / "tools" / "chaos.py"
TIMEOUT_S = 60.0  # on a busy machine many are cut before they have announced their topics


@contextlib.asynccontextmanager
async def relayed(host: tuple[str, int], *lines: str) -> AsyncIterator[tuple[Relay, tuple[str, int]]]:
    """A relay to this host, and where it listens."""

    async def connect() -> TcpEnd:
        return await connect_tcp(*host)

    async with asyncio.TaskGroup() as tasks:
        relay = Relay(parse(lines), connect, lambda *_: None)
        passages: list[asyncio.Task[None]] = []

        def accept(device: TcpEnd) -> None:
            passages.append(tasks.create_task(relay.serve(device)))

        async with await listen_tcp(accept, "127.0.0.1", 0) as server:
            faults = tasks.create_task(relay.run())
            yield relay, server.sockets[0].getsockname()[:2]
        for task in (faults, *passages):
            task.cancel()


async def is_gone(device: FakeDevice) -> bool:
    """Whether the device's connection has ended."""
    await device.closed()
    return True


async def negotiate_and_be_cut(address: tuple[str, int]) -> None:
    """Connect as a robot, again and again, until the topics were announced before the connection was cut."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            with contextlib.suppress(EOFError, OSError):
                async with fake_device(address, robot_topics()) as device:
                    assert await is_gone(device)
                    return


async def test_bytes_in_single_pieces_are_the_same_messages() -> None:
    async with (
        daemon() as host,
        relayed(host.tcp, "split 1-7") as (_, address),
        fake_device(address, robot_topics()) as device,
    ):
        await device.send(pose(1.0) + pose(2.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 2)
        assert (await host.get("/api/links"))["links"][0]["skipped_bytes"] == 0


@pytest.mark.parametrize("kind", [Kind.CUT, Kind.CLOSE, Kind.REBOOT])
async def test_a_fault_that_ends_the_connection_ends_it_at_both_ends(kind: Kind) -> None:
    async with (
        daemon() as host,
        relayed(host.tcp) as (relay, address),
        fake_device(address, robot_topics()) as device,
    ):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        relay.inflict(Fault(kind, 0.0, None))
        assert await is_gone(device)
        await expect(lambda: not host.hub.links.all())
        async with fake_device(address, robot_topics()) as again:
            await again.send(pose(1.0))
            await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
    assert relay.counts["connections"] == 2


async def test_a_half_open_link_stays_open_for_the_host_until_the_robot_is_back() -> None:
    async with (
        daemon() as host,
        relayed(host.tcp) as (relay, address),
        fake_device(address, robot_topics()) as device,
    ):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        old = host.hub.robots.find("robot_0").link
        relay.inflict(Fault(Kind.HALF_OPEN, 0.0, None))
        assert await is_gone(device)
        assert host.hub.links.all() == [old]
        async with fake_device(address, robot_topics()):
            await expect(lambda: host.hub.links.all() not in ([], [old]) and old not in host.hub.links.all())


@pytest.mark.slow
async def test_the_program_reports_what_it_did() -> None:
    async with daemon() as host:
        chaos = await asyncio.create_subprocess_exec(
            sys.executable, CHAOS, "--listen", "127.0.0.1:0", "--to", "{}:{}".format(*host.tcp), "--json",
            "--every", "0.2", "cut", "--split", "1-7", "--seed", "7",
            stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        assert chaos.stdout is not None
        listening = json.loads(await chaos.stdout.readline())
        assert (listening["what"], listening["seed"]) == ("listening", 7)
        address, _, port = listening["at"].rpartition(":")
        await negotiate_and_be_cut((address, int(port)))
        chaos.send_signal(signal.SIGINT)
        reported = [json.loads(line) for line in (await chaos.stdout.read()).splitlines()]
        assert await chaos.wait() == 0
    assert {"connected", "cut", "ended", "done"} <= {line["what"] for line in reported}
    assert reported[-1]["what"] == "done"
    assert reported[-1]["bytes from-device"] > 200


async def test_a_wrong_word_is_one_line_and_status_2() -> None:
    chaos = await asyncio.create_subprocess_exec(
        sys.executable, CHAOS, "--at", "10", "explode", stderr=asyncio.subprocess.PIPE
    )
    _, complaint = await chaos.communicate()
    assert chaos.returncode == 2
    assert complaint.decode().startswith("chaos: no fault explode; known: lose, blackout")

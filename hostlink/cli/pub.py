"""`hostlink pub`: publish messages on a topic."""

import asyncio
from contextlib import AbstractAsyncContextManager
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, TopicName, Url, json_object
from hostlink.cli.output import write_error
from hostlink.client import DEFAULT_URL, Host, connect
from hostlink.errors import HostlinkError


def command(
    topic: TopicName,
    message: Annotated[
        str, typer.Argument(help='JSON, as {"linear": {"x": 0.1}}; missing fields are zero, all of them without it.')
    ] = "{}",
    *,
    type_name: Annotated[
        str, typer.Option("--type", help="As geometry_msgs/Twist; that of the topic if it is known.")
    ] = "",
    rate: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Messages a second, with --count.")] = 10.0,
    count: Annotated[int, typer.Option(min=0, help="How many; 0: until Ctrl-C.")] = 1,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Publish a message once, or at a rate. A robot that is driven so stops when this command ends."""
    asyncio.run(
        _pub(connect(url, token=token, reconnect=False), topic, json_object("MESSAGE", message), type_name, rate, count)
    )


async def _pub(
    connected: AbstractAsyncContextManager[Host],
    topic: str,
    message: dict[str, object],
    type_name: str,
    rate_hz: float,
    count: int,
) -> None:
    async with connected as host:
        sent = 0
        while not count or sent < count:
            if sent:
                await asyncio.sleep(1 / rate_hz)
            await host.publish(topic, message, type_name=type_name)
            sent += 1
        await _await_refusal(host, topic)
    write_error(f"{sent} sent")


async def _await_refusal(host: Host, topic: str) -> None:
    await host.settle()
    refusal = host.pop_refusal(topic)
    if refusal:
        raise HostlinkError(refusal)

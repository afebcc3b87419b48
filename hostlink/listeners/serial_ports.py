"""A serial port's side of the hub: opened, served, and found again when it has vanished, as long as the daemon runs."""

import asyncio
import dataclasses
import itertools

import structlog

from hostlink.config import LinkConfig, SerialConfig
from hostlink.hub.hub import Hub
from hostlink.link.link import Link
from hostlink.transport.serial import SerialTransport, open_serial

log = structlog.get_logger()

BITS_A_BYTE = 10  # 8N1
RETRY_S = 1.0  # a port that vanished is searched this often


async def serve_serial(hub: Hub, config: SerialConfig, *, retry_s: float = RETRY_S) -> None:
    """Serve until cancelled."""
    logged = ""
    while True:
        with hub.isolation.around("task", task=f"serial port {config.name}"):
            reason = await _serve_once(hub, config)
            if reason and reason != logged:
                log.warning("serial.waiting", port=config.name, reason=reason)
            logged = reason
        await asyncio.sleep(retry_s)


async def _serve_once(hub: Hub, config: SerialConfig) -> str:
    """Serve the port to the end of its link; the reason when it cannot be opened."""
    try:
        transport = await open_serial(config)
    except OSError as error:
        hub.diagnoses.observe_port(config.name, error)
        return error.strerror or str(error)
    hub.diagnoses.observe_port(config.name, None)
    link = hub.links.open(transport, _link_config(hub, config))
    hub.diagnoses.observe_baud(link, config.bauds[0])
    async with asyncio.TaskGroup() as tasks:
        trying = tasks.create_task(_try_bauds(hub, transport, link, config), name=f"baud rate of {config.name}")
        await hub.links.serve(link)
        trying.cancel()
    return ""


def _link_config(hub: Hub, config: SerialConfig) -> LinkConfig:
    """Silence ends no link here: a port that is gone raises an error, and opening one may reset a board."""
    uart_bytes_s = hub.config.link.uart_bytes_s or min(config.bauds) // BITS_A_BYTE
    return dataclasses.replace(hub.config.link, idle_timeout_s=None, silence_timeout_s=None, uart_bytes_s=uart_bytes_s)


async def _try_bauds(hub: Hub, transport: SerialTransport, link: Link, config: SerialConfig) -> None:
    """One rate after the other, until a frame has come whole."""
    if len(config.bauds) == 1:
        return
    for baud in itertools.cycle(config.bauds):
        log.debug("serial.baud_tried", port=config.name, baud=baud)
        try:
            transport.set_baud(baud)
        except OSError:  # the port has vanished; the link finds that by itself
            return
        hub.diagnoses.observe_baud(link, baud)
        await asyncio.sleep(config.baud_try_s)
        if link.session.counts.frames_from_device:
            log.info("serial.baud_found", port=config.name, baud=baud)
            return

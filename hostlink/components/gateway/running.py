"""Gateway: component that serves rosbridge, Foxglove, the REST API, the page and the metrics on one port."""

import asyncio
from collections.abc import Iterable, Iterator, Mapping
from typing import ClassVar

from hostlink.components.gateway.access import Access, is_loopback, tls_context
from hostlink.components.gateway.server import serve_api, url_of
from hostlink.components.gateway.settings import KEPT_FOR_REQUESTS, ApiAddress, ApiConfig, GatewaySettings, is_origin
from hostlink.core.host import Component, Connections, Host


class Gateway(Component[GatewaySettings]):
    """The port for programs and people. It offers its `ApiAddress` to other components."""

    name = "gateway"
    settings_type = GatewaySettings
    tables = ("api",)
    begins_first = True  # so that a port in use is known before a device connects, and programs see the last stop
    uses = ("recorder",)
    connections: ClassVar[Mapping[str, Connections]] = {"api": Connections(least=KEPT_FOR_REQUESTS + 1)}

    def listens(self) -> Mapping[str, tuple[str, int]]:
        """Return the address of the port."""
        return {"api": (self.settings.api.host, self.settings.api.port)}

    def check(self) -> Iterable[str]:
        """Check tokens, certificate and limits."""
        Access(self.settings.api)
        tls_context(self.settings.api)
        return tuple(_suspicious(self.settings.api))

    def describe(self) -> str:
        """Return one line for --check-config."""
        api = self.settings.api
        return f"programs on {url_of(api.host, api.port, has_tls=api.certificate is not None)}"

    async def run(self, host: Host) -> None:
        """Serve until cancelled."""
        async with serve_api(host, self.settings) as url:
            host.offer(ApiAddress(url))
            host.ready()
            await asyncio.Event().wait()


_LEAST = {  # setting -> the smallest value that works, and the reason
    "max_message_bytes": (1024, "a message of a program is a few hundred bytes of JSON"),
    "max_requests_s": (10, "a program that drives sends ten commands a second"),
    "request_timeout_s": (0.1, "a radio link takes longer"),
}


def _suspicious(api: ApiConfig) -> Iterator[str]:
    for name, (least, reason) in _LEAST.items():
        if (value := getattr(api, name)) < least:
            yield f"api.{name} {value:g} is very small: {reason}"
    if api.certificate is None and not is_loopback(api.host):
        yield f"api.host {api.host} without a certificate: others on the network can read the tokens"
    if api.max_clients > api.max_connections - KEPT_FOR_REQUESTS:
        yield (
            f"api.max_clients {api.max_clients} is too large: api.max_connections {api.max_connections} leaves "
            f"{api.max_connections - KEPT_FOR_REQUESTS} connections for clients"
        )
    for origin in api.origins:
        if not is_origin(origin):
            yield f'api.origins {origin} is not an origin; write the scheme and the host, for example "https://panel.example"'

"""The route that reads the configuration again."""

from http import HTTPStatus
from typing import TypedDict

from aiohttp import web

from hostlink.api.replies import reply
from hostlink.api.routes import Route
from hostlink.hub.node import Role
from hostlink.hub.reloader import Reloader


class ReloadView(TypedDict):
    """Settings that were changed, settings that differ but need a restart, and robots' new names by their old ones."""

    changed: list[str]
    needs_restart: list[str]
    renamed: dict[str, str]


class ReloadRoute:
    """`POST /api/reload`."""

    def __init__(self, reloader: Reloader) -> None:
        self._reloader = reloader

    def routes(self) -> list[Route]:
        """The path of this file."""
        return [
            Route(
                "/api/reload",
                self._reload,
                "Read the configuration again: names and limits of robots, tokens and origins; all of it or nothing",
                ReloadView,
                method="POST",
                role=Role.DRIVE,
                fails=(HTTPStatus.CONFLICT, HTTPStatus.INTERNAL_SERVER_ERROR),
            )
        ]

    async def _reload(self, _: web.Request) -> web.Response:
        reloaded = await self._reloader.reload()
        return reply(
            {
                "changed": list(reloaded.changed),
                "needs_restart": list(reloaded.needs_restart),
                "renamed": reloaded.renamed,
            }
        )

"""The files of the page in the browser."""

import mimetypes
from importlib.resources import files

from aiohttp import web

PAGE = files("hostlink.api") / "web" / "built"  # by Vite, from the sources beside it: make web
PAGE_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "img-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


async def page_file(request: web.Request) -> web.StreamResponse:
    """A file of the page: it needs no token, because no robot is named in it."""
    name = request.match_info.get("file")
    folder = PAGE if name is None else PAGE / "web"
    found = next((each for each in folder.iterdir() if each.name == (name or "index.html")), None)
    if found is None:  # also for ..%2F..: a name is one of the folder's, not a way out of it
        raise web.HTTPNotFound
    kind, _ = mimetypes.guess_type(found.name)
    return web.Response(body=found.read_bytes(), headers=PAGE_HEADERS | {"Content-Type": kind or "text/plain"})

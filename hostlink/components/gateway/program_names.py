"""Names of programs for people: who drives, from what a program says of itself or from its User-Agent. Pure."""

import re

from hostlink.core.runtime.logs import printable

CLIENT = "client"  # of a program that does not say what it is
MAX_NAME = 40
# In this order: Edge calls itself Chrome, too, and Chrome calls itself Safari.
_BROWSERS = (("Firefox/", "Firefox"), ("Edg/", "Edge"), ("OPR/", "Opera"), ("Chrome/", "Chrome"), ("Safari/", "Safari"))
_PROGRAMS = (("AutobahnPython", "roslibpy"), ("curl/", "curl"), ("Wget/", "wget"))


def browser_of(user_agent: str) -> str:
    """Return the name of a browser; empty for another program."""
    if not user_agent.startswith("Mozilla/"):
        return ""
    return next((name for mark, name in _BROWSERS if mark in user_agent), "browser")


def program_of(user_agent: str, *, asked: str = "", is_page: bool = False) -> str:
    """Return the name of a program: the one that it asks for, or what its User-Agent tells.

    `is_page`: it is a page of this daemon.
    """
    if asked:
        return re.sub(r"\s+", " ", printable(asked, MAX_NAME)).strip() or CLIENT
    if browser := browser_of(user_agent):
        return "page" if is_page else browser
    return next((name for mark, name in _PROGRAMS if user_agent.startswith(mark)), CLIENT)


def client_name(number: int, user_agent: str, *, who: str, asked: str = "", is_page: bool = False) -> str:
    """Return the name of a connection: `teleop 3`, `page 4 (Firefox, phone)`; `who` is the name of its token."""
    program = program_of(user_agent, asked=asked, is_page=is_page)
    details = ", ".join(filter(None, (browser_of(user_agent) if program == "page" else "", who)))
    return f"{program} {number}" + (f" ({details})" if details else "")

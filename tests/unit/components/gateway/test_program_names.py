"""program_names: who drives, in words of users."""

import pytest

from hostlink.components.gateway.program_names import MAX_NAME, client_name

FIREFOX = "Mozilla/5.0 (X11; Linux x86_64; rv:140.0) Gecko/20100101 Firefox/140.0"
CHROME = "Mozilla/5.0 (X11; Linux x86_64) AppleWebKit/537.36 (KHTML, like Gecko) Chrome/141.0.0.0 Safari/537.36"
EDGE = f"{CHROME} Edg/141.0.0.0"
SAFARI = "Mozilla/5.0 (iPhone; CPU iPhone OS 18_0 like Mac OS X) AppleWebKit/605.1.15 Version/18.0 Safari/604.1"


@pytest.mark.parametrize(
    ("user_agent", "name"),
    [(FIREFOX, "page 3 (Firefox)"), (CHROME, "page 3 (Chrome)"), (EDGE, "page 3 (Edge)"), (SAFARI, "page 3 (Safari)")],
)
def test_page_has_the_name_of_its_browser(user_agent: str, name: str) -> None:
    assert client_name(3, user_agent, who="", is_page=True) == name


@pytest.mark.parametrize(
    ("user_agent", "name"),
    [
        ("AutobahnPython/26.10.2", "roslibpy 3 (phone)"),
        ("curl/8.5.0", "curl 3 (phone)"),
        (FIREFOX, "Firefox 3 (phone)"),
        ("", "client 3 (phone)"),
        ("Python/3.11 aiohttp/3.12", "client 3 (phone)"),
    ],
)
def test_program_has_the_name_that_its_user_agent_tells(user_agent: str, name: str) -> None:
    assert client_name(3, user_agent, who="phone") == name


def test_program_may_choose_its_name() -> None:
    assert client_name(3, "AutobahnPython/26", who="", asked="line follower") == "line follower 3"
    assert client_name(3, FIREFOX, who="", asked="\x1b[31m\n") != "\x1b[31m\n 3"
    assert len(client_name(3, "", who="", asked="x" * 1000)) == MAX_NAME + 2

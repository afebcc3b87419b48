"""Access to the API: tokens, roles, and pages of other origins."""

from pathlib import Path

import pytest
from aiohttp import web
from structlog.testing import capture_logs

from hostlink.api.access import Access, Grant, Role, check_role, tls_context
from hostlink.config import ApiConfig, TokenConfig
from hostlink.errors import ConfigError

DRIVER = TokenConfig(name="phone", role="drive", token="a-token-of-a-driver")
WATCHER = TokenConfig(name="wall", role="read", token="a-token-of-a-watcher")
GUARDED = ApiConfig(tokens=(DRIVER, WATCHER))


def refused(access: Access, origin: str | None, host: str) -> str:
    try:
        access.check_place(origin=origin, host=host)
    except web.HTTPForbidden as error:
        return error.reason
    return ""


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        (None, "localhost:9090"),
        (None, "127.0.0.1:9090"),
        (None, "[::1]:9090"),
        (None, "192.168.4.1"),
        ("http://localhost:9090", "localhost:9090"),
        ("http://127.0.0.1:9090", "127.0.0.1:9090"),
        ("http://[::1]:9090", "[::1]:9090"),
    ],
)
def test_check_place_own_page_and_programs_are_allowed(origin: str | None, host: str) -> None:
    assert refused(Access(ApiConfig()), origin, host) == ""


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        ("http://evil.example", "localhost:9090"),
        ("http://localhost", "localhost:9090"),  # another port is another origin
        ("http://localhost:9090.evil.example", "localhost:9090"),
        ("null", "localhost:9090"),
        ("", "localhost:9090"),
        ("http://[", "localhost:9090"),
        ("http://evil.example:9090", "evil.example:9090"),  # DNS rebinding
        (None, "evil.example"),
        (None, ""),
        (None, "[::1"),
    ],
)
def test_check_place_page_of_another_origin_is_refused(origin: str | None, host: str) -> None:
    assert refused(Access(ApiConfig()), origin, host)


def test_check_place_listed_origin_is_allowed() -> None:
    access = Access(ApiConfig(origins=("https://app.example/", "null")))
    assert refused(access, "https://app.example", "localhost") == ""
    assert refused(access, "null", "localhost") == ""
    assert 'add "https://other.example" to api.origins' in refused(access, "https://other.example", "localhost")


def test_check_place_with_tokens_allows_names_and_every_origin() -> None:
    access = Access(ApiConfig(host="0.0.0.0", tokens=(DRIVER,), origins=("*",)))
    assert refused(access, "https://anywhere.example", "robot.local:9090") == ""
    assert refused(Access(GUARDED), "http://robot.local:9090", "robot.local:9090") == ""
    assert refused(Access(GUARDED), "https://anywhere.example", "robot.local:9090")


def test_grant_without_tokens_may_drive() -> None:
    assert Access(ApiConfig()).grant(None) == Grant("", Role.DRIVE)


def test_grant_of_a_token_has_name_and_role() -> None:
    access = Access(GUARDED)
    assert access.grant("a-token-of-a-driver") == Grant("phone", Role.DRIVE)
    assert access.grant("a-token-of-a-watcher") == Grant("wall", Role.READ)


@pytest.mark.parametrize("token", [None, "", "a-token-of-a-drive", "a-token-of-a-driver ", "ü", "\udcff"])
def test_grant_of_missing_or_unknown_token_is_refused(token: str | None) -> None:
    with pytest.raises(web.HTTPUnauthorized) as refusal:
        Access(GUARDED).grant(token)
    assert refusal.value.headers["WWW-Authenticate"].startswith("Bearer")
    assert "a-token-of" not in refusal.value.reason


def test_check_role_read_may_not_drive() -> None:
    check_role(Grant("wall", Role.READ), Role.READ)
    check_role(Grant("phone", Role.DRIVE), Role.READ)
    with pytest.raises(web.HTTPForbidden, match="wall may only read"):
        check_role(Grant("wall", Role.READ), Role.DRIVE)


def test_token_is_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("a-token-in-a-file\n")
    access = Access(ApiConfig(tokens=(TokenConfig(name="page", token_file=file),)))
    assert access.grant("a-token-in-a-file") == Grant("page", Role.READ)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.4.1", "::", "robot.local", ""])
def test_address_outside_loopback_needs_tokens(host: str) -> None:
    with pytest.raises(ConfigError, match="every program on the network could drive"):
        Access(ApiConfig(host=host))
    Access(ApiConfig(host=host, tokens=(DRIVER,)))


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        (ApiConfig(origins=("*",)), "every web page"),
        (ApiConfig(tokens=(TokenConfig(name="a"),)), "needs either token or token_file"),
        (ApiConfig(tokens=(TokenConfig(name="a", token="short"),)), "at least 16 characters"),
        (ApiConfig(tokens=(TokenConfig(name="a", token_file=Path("/no/such")),)), "No such file"),
        (ApiConfig(tokens=(DRIVER, TokenConfig(name="b", token=DRIVER.token))), "same token"),
        (ApiConfig(max_clients=0), "1 or more"),
        (ApiConfig(max_requests_s=float("nan")), "1 or more"),
    ],
)
def test_invalid_settings_are_refused(config: ApiConfig, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        Access(config)


def test_token_is_not_shown() -> None:
    assert "a-token-of-a-driver" not in repr(GUARDED)


def test_tls_needs_valid_certificate_and_key(tmp_path: Path) -> None:
    assert tls_context(ApiConfig()) is None
    with pytest.raises(ConfigError, match="both certificate and key"):
        tls_context(ApiConfig(key=tmp_path / "key.pem"))
    with pytest.raises(ConfigError, match="No such file"):
        tls_context(ApiConfig(certificate=tmp_path / "cert.pem", key=tmp_path / "key.pem"))
    (tmp_path / "cert.pem").write_text("no certificate")
    with pytest.raises(ConfigError, match=r"cert\.pem"):
        tls_context(ApiConfig(certificate=tmp_path / "cert.pem", key=tmp_path / "cert.pem"))


def test_limits_of_one_are_accepted() -> None:
    Access(ApiConfig(max_clients=1, max_message_bytes=1, max_requests_s=1.0))


def test_refused_origin_of_a_browser_is_logged_once() -> None:
    access = Access(ApiConfig())
    with capture_logs() as logs:
        for origin in ("http://evil.example", "http://evil.example", "null", "not-a-browser"):
            with pytest.raises(web.HTTPForbidden):
                access.check_place(origin=origin, host="localhost")
    assert [(each["event"], each["origin"]) for each in logs] == [
        ("client.origin_refused", "http://evil.example"),
        ("client.origin_refused", "null"),
    ]

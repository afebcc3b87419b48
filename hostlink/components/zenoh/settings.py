"""Settings for Zenoh: those of [zenoh] over those of its file; access rules; and who can reach the session.

Zenoh's own defaults trust the network: a peer listens on every address in plain TCP, answers and follows multicast,
connects to all addresses that its neighbours name, and requests no certificate. A fleet without certificates keeps
these defaults, and every program that reaches it can drive. With an authority (`ca`) TLS is
the only protocol, in both directions.
"""

import contextlib
import json
import re
import ssl
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from hostlink.core.runtime.logs import printable
from hostlink.errors import ConfigError, LibraryMissing

MAX_ROS_DOMAIN_ID = 232
ZENOH_NAME = r"[A-Za-z0-9_.-]{1,64}"  # part of a Zenoh key

PREFIX = "hostlink "  # of the ids of these rules

DEFAULTS: dict[str, object] = {
    "transport/link/tx/lease": 1000,  # ms; a neighbour that is silent for so long is gone, and its tokens with it
    "transport/link/tx/keep_alive": 4,  # in each lease
    "transport/shared_memory/enabled": False,  # 65 MiB for what never is large
}
BLOCKED_US = 100_000  # a neighbour for whom a declaration or a query has to wait longer is cut off; a fifth of a lease
TLS = "transport/link/tls"
TLS_ONLY: dict[str, object] = {  # with an authority; a file that says otherwise is refused
    "transport/link/protocols": ["tls"],  # Zenoh itself refuses every other one, in both directions
    "scouting/multicast/enabled": False,
    f"{TLS}/enable_mtls": True,  # who connects here shows a certificate, too
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohSettings:
    """The table [zenoh]: session of the daemon, for the fleet and for ROS 2 over rmw_zenoh's protocol."""

    fleet: bool = True  # share robots with other daemons: show and drive theirs, and offer one's own
    ros2: bool = False  # join a ROS 2 graph whose nodes use rmw_zenoh
    ros_domain_id: int = 0
    ros_distribution: Literal["humble", "iron", "jazzy", "kilted", "lyrical"] = "kilted"  # distribution of those nodes
    name: str = ""  # name of this daemon in the fleet; empty: the computer's name
    fleet_name: str = "hostlink"  # first part of every key; daemons with another name form another fleet
    drivers: tuple[str, ...] = ("*",)  # daemons whose programs may drive this daemon's robots; others may read and stop
    mode: Literal["peer", "client", "router"] = "peer"
    connect: tuple[str, ...] = ()  # "tls/10.0.0.2:7447"; without `ca` peers in the local network also find each other
    # "tls/0.0.0.0:7447"; empty: with `ca` not at all, otherwise a free port on every address.
    listen: tuple[str, ...] = ()
    multicast: bool | None = None  # discovery in the local network, never with `ca`; None: only without `ca`
    gossip: bool | None = None  # connect to daemons that neighbours announce; None: only without `ca`
    ca: Path | None = None  # PEM; with `certificate` and `key`: only mutual TLS
    certificate: Path | None = None
    key: Path | None = None
    file: Path | None = None  # JSON5 configuration of Zenoh for all other settings: access rules, leases

    def __post_init__(self) -> None:
        for setting, name in (("name", self.name), ("fleet_name", self.fleet_name)):
            if name and not re.fullmatch(ZENOH_NAME, name):
                raise ValueError(f"zenoh.{setting} {name!r} must be made of letters, digits, _, - and .")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("set zenoh.certificate and zenoh.key together")
        if self.certificate is not None and self.ca is None:
            raise ValueError(
                "zenoh.certificate needs zenoh.ca; without it other daemons are not asked for a certificate"
            )
        if not 0 <= self.ros_domain_id <= MAX_ROS_DOMAIN_ID:
            raise ValueError(f"zenoh.ros_domain_id must be 0 to {MAX_ROS_DOMAIN_ID}")
        if not self.fleet_name:
            raise ValueError("zenoh.fleet_name must not be empty")


_SHOWS = ("alive", "state", "live", "out", "stop", "answer")  # what every member of the fleet puts
_MOVES = ("drive", "publish")
_PUT = ("put", "delete")
_DECLARES = (
    "declare_subscriber",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
_MESSAGES = (*_PUT, "query", *_DECLARES)
_EVERY_KEY = ("**", "@ros2_lv/**", "**/@adv/**")  # `**` alone matches no part that begins with @


def access_rules(config: ZenohSettings) -> dict[str, Any]:
    """Return the access rules: what a driver's certificate may send, and what other certificates may.

    A driver sends velocities and messages for devices under its own name alone. Other daemons read, stop and
    lock. In a ROS 2 graph they only read and call no service, because its keys do not name the sender.

    Raises:
        ConfigError: a driver is a pattern.
    """
    patterns = [name for name in config.drivers if set(name) & set("*?[")]
    if patterns:
        raise ConfigError(
            "zenoh.drivers", f'{patterns[0]}: with certificates each name is written out, or "*" is all of them'
        )
    fleet, domain = config.fleet_name, config.ros_domain_id
    rules = [
        _rule("send", _MESSAGES, _EVERY_KEY, flow="egress"),
        _rule("declare", _DECLARES, _EVERY_KEY),
        _rule("show", _PUT, [f"{fleet}/{verb}/**" for verb in _SHOWS]),
        _rule("ask", ["query"], [f"{fleet}/topics/**", "**/@adv/**"]),
        _rule("drive in ROS 2", [*_PUT, "query"], [f"{domain}/**"]),
    ]
    subjects: list[dict[str, Any]] = [{"id": "everybody"}]
    policies = [{"rules": [rule["id"] for rule in rules[:4]], "subjects": ["everybody"]}]
    for name in config.drivers:
        own = _rule(f"drive as {name}", _PUT, [f"{fleet}/{verb}/*/{name}/**" for verb in _MOVES])
        rules.append(own)
        subjects.append({"id": name, "cert_common_names": [name]})
        driven = [own["id"], *[rules[4]["id"]] * config.ros2]
        policies.append({"rules": driven, "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, messages: Any, keys: Any, *, flow: str = "ingress") -> dict[str, Any]:
    return {
        "id": f"{PREFIX}{name}",
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(keys),
    }


GOSSIP, EXPIRATION = "scouting/gossip/enabled", f"{TLS}/close_link_on_expiration"


def library() -> Any:
    """The module of eclipse-zenoh.

    Raises:
        LibraryMissing: it is not installed.
    """
    try:
        import zenoh  # noqa: PLC0415 - an optional dependency
    except ImportError as error:
        raise LibraryMissing("zenoh", "eclipse-zenoh", "zenoh") from error
    return zenoh


def settings_of(config: ZenohSettings) -> Any:
    """Zenoh's settings: those of the file, and [zenoh] over them; this project's defaults where the file has Zenoh's.

    Raises:
        ConfigError: the file cannot be read, Zenoh refuses a value, or one of them opens what certificates close.
    """
    zenoh = library()
    try:
        usual = zenoh.Config()
        settings = zenoh.Config() if config.file is None else zenoh.Config.from_file(str(config.file))
        for key, value in DEFAULTS.items():
            if settings.get_json(key) == usual.get_json(key):
                settings.insert_json5(key, json.dumps(value))
        for key, value in _values(config).items():
            settings.insert_json5(key, json.dumps(value))
    except (zenoh.ZError, ValueError) as error:
        raise ConfigError("zenoh", f"Zenoh refuses the settings: {reason_of(error)}") from error
    if is_secured(settings):
        _secure(settings, usual, config)
    return settings


def reason_of(error: Exception) -> str:
    """Return the part of Zenoh's text that concerns the user, without the places in its sources."""
    text = str(error)
    found = re.search(r'msg: "(.*)"', text)
    return printable((found[1] if found else text).split(" at /")[0], 300)


def is_secured(settings: Any) -> bool:
    """Whether there is an authority: TLS alone, in both directions."""
    return any(_value(settings, f"{TLS}/root_ca_certificate{kind}") is not None for kind in ("", "_base64"))


def reach_of(settings: Any, config: ZenohSettings) -> Iterator[str]:
    """Yield the addresses of a session with these settings, and who can reach it and drive by it."""
    places, others = _endpoints(settings, "listen"), _endpoints(settings, "connect")
    yield f"listens on {', '.join(places) or 'nothing'}"
    if others:
        yield f"connects to {', '.join(others)}"
    if not is_secured(settings):
        yield f"no TLS{_scouting(settings)}: everybody who reaches it can drive"
        return
    yield f"TLS alone{_scouting(settings)}: reached by certificates of {_authority(settings)}"
    if _has_rules_of_file(settings, config):
        yield f"who may drive: the access rules of {config.file}"
    elif "*" in config.drivers:
        yield "all of them may drive"
    else:
        yield f"of them {', '.join(config.drivers) or 'none'} may drive, by the name in the certificate"


def warnings_of(settings: Any, config: ZenohSettings) -> Iterator[str]:
    """Yield the settings that may not be intended."""
    if not is_secured(settings):
        where = ", ".join((*_endpoints(settings, "listen"), *_endpoints(settings, "connect")))
        yield (
            f"no certificates ({where}{_scouting(settings)}): everybody who reaches its port can drive the "
            "robots; set ca, certificate and key (docs/fleet.md)"
        )
        if "*" not in config.drivers:
            yield "drivers without certificates keeps out nobody: a daemon has the name that it gives itself"
    trouble = certificate_trouble(config)
    if trouble:
        yield f"certificate {config.certificate}: {trouble}; no daemon of the fleet lets this one in"
    if _value(settings, "adminspace/enabled") and _value(settings, "adminspace/permissions/write"):
        yield f"file {config.file}: adminspace lets whoever is connected change the settings of this session"


def certificate_trouble(config: ZenohSettings) -> str:
    """Return why other daemons do not let this one in by its certificate; empty if they do.

    It is shown to itself, in memory: the key must be its own, the authority the one of `ca`, and the time right.
    """
    if config.ca is None or config.certificate is None or config.key is None:
        return ""
    ends = [(ssl.MemoryBIO(), ssl.MemoryBIO()) for _ in range(2)]
    try:
        server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        server.load_cert_chain(config.certificate, config.key)
        client = ssl.create_default_context(cafile=str(config.ca))
        client.check_hostname = False
        shown = server.wrap_bio(ends[0][0], ends[0][1], server_side=True)
        seen = client.wrap_bio(ends[1][0], ends[1][1])
        for _ in range(4):  # flights of a handshake
            for one, (_, sent), (received, _) in ((seen, ends[1], ends[0]), (shown, ends[0], ends[1])):
                with contextlib.suppress(ssl.SSLWantReadError):
                    one.do_handshake()
                received.write(sent.read())
    except ssl.SSLCertVerificationError as error:
        return error.verify_message
    except FileNotFoundError:  # Zenoh says so when it opens the session
        return ""
    except (OSError, ValueError) as error:
        return printable(str(error), 200)
    return ""


def _secure(settings: Any, usual: Any, config: ZenohSettings) -> None:
    """Allow TLS only.

    Raises:
        ConfigError: a setting wants it open.
    """
    if config.multicast:
        raise ConfigError("zenoh.multicast", "must not be true with certificates: who is found by it proves nothing")
    has_certificate = any(_value(settings, f"{TLS}/listen_certificate{kind}") for kind in ("", "_base64"))
    for key, value in TLS_ONLY.items():
        chosen = _value(settings, key)
        if chosen not in (value, _value(usual, key)):
            raise ConfigError(
                "zenoh.file", f"{key} is {json.dumps(chosen)}; with certificates {json.dumps(value)} alone"
            )
        if has_certificate or not key.startswith(TLS):
            settings.insert_json5(key, json.dumps(value))
    for key, value in {GOSSIP: False, EXPIRATION: True, "listen/endpoints": []}.items():
        if settings.get_json(key) == usual.get_json(key):
            settings.insert_json5(key, json.dumps(value))
    _check_endpoints(settings, has_certificate=has_certificate)
    if "*" not in config.drivers and not _has_rules_of_file(settings, config):
        settings.insert_json5("access_control", json.dumps(access_rules(config)))


def _check_endpoints(settings: Any, *, has_certificate: bool) -> None:
    listens = _endpoints(settings, "listen")
    for part, endpoints in (("listen", listens), ("connect", _endpoints(settings, "connect"))):
        for endpoint in endpoints:
            if not endpoint.startswith("tls/") or "enable_mtls=false" in endpoint:
                advice = "with certificates each address begins with tls/, and asks for a certificate"
                raise ConfigError(f"zenoh.{part}", f"{endpoint} is open to everybody: {advice}")
    if listens and not has_certificate:
        raise ConfigError("zenoh.listen", "needs zenoh.certificate and zenoh.key: who connects wants to see one")


def _values(config: ZenohSettings) -> dict[str, Any]:
    values: dict[str, Any] = {
        "mode": config.mode,
        "connect/exit_on_failure": False,
        "timestamping/enabled": True,  # what is kept for later subscribers needs it
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,  # the loop waits for no neighbour
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 0,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": BLOCKED_US,
    }
    if config.connect:
        values["connect/endpoints"] = list(config.connect)
    if config.listen:
        values["listen/endpoints"] = list(config.listen)
    chosen = {"scouting/multicast/enabled": config.multicast, GOSSIP: config.gossip}
    values |= {key: value for key, value in chosen.items() if value is not None}
    files: dict[str, Path | None] = {
        "root_ca_certificate": config.ca,
        "listen_certificate": config.certificate,
        "listen_private_key": config.key,
        "connect_certificate": config.certificate,
        "connect_private_key": config.key,
    }
    return values | {f"{TLS}/{name}": str(path) for name, path in files.items() if path is not None}


def _endpoints(settings: Any, part: str) -> list[str]:
    """Return the addresses that Zenoh listens on, or connects to, in its mode."""
    if part == "listen" and _value(settings, "mode") == "client":
        return []
    found = _value(settings, f"{part}/endpoints")
    if isinstance(found, Mapping):
        found = found.get(_value(settings, "mode"))
    return [each if isinstance(each, str) else str(each.get("endpoint", each)) for each in found or ()]


def _scouting(settings: Any) -> str:
    ways = ("multicast", "gossip")
    found = [way for way in ways if _value(settings, f"scouting/{way}/enabled") is not False]
    return f", found by {' and '.join(found)}" if found else ""


def _authority(settings: Any) -> str:
    return str(_value(settings, f"{TLS}/root_ca_certificate") or "the authority in the file")


def _has_rules_of_file(settings: Any, config: ZenohSettings) -> bool:
    rules = _value(settings, "access_control/rules") or ()
    is_own = any(rule["id"].startswith(PREFIX) for rule in rules)
    return config.file is not None and bool(_value(settings, "access_control/enabled")) and not is_own


def _value(settings: Any, key: str) -> Any:
    return json.loads(settings.get_json(key))

"""Zenoh's access rules for `drivers`: who moves robots here, by the common name in a link's certificate. Pure."""

from typing import Any

from hostlink.config import ZenohConfig
from hostlink.errors import ConfigError

PREFIX = "hostlink "  # of the ids of these rules
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


def access_rules(config: ZenohConfig) -> dict[str, Any]:
    """What certificates that are not among the drivers' may send, and what each driver's may.

    A driver sends velocities and messages for devices under its own name alone. Whoever is no driver reads, stops and
    locks. In a ROS 2 graph it reads, for there a key does not say whose it is: not even a service is called.

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

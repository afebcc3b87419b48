"""The files that come along for those who run hostlink as a service."""

from importlib.resources import files

from hostlink.errors import ConfigError

EXAMPLES = {"config": "hostlink.toml", "systemd": "hostlink.service", "udev": "70-hostlink.rules"}


def read_example(name: str) -> str:
    """The text of one of EXAMPLES.

    Raises:
        ConfigError: there is none of that name.
    """
    if name not in EXAMPLES:
        raise ConfigError("--example", f"{name} is none of {', '.join(EXAMPLES)}")
    return (files("hostlink") / "data" / EXAMPLES[name]).read_text()

"""Names of topics, services and devices as boards and people write them."""


def plain_name(name: str) -> str:
    """Return a name without the slash in front, which means nothing here: both write it with or without one."""
    return name.lstrip("/")

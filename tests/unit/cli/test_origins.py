"""`--origin` of serve and demo."""

import pytest

from hostlink.cli.serve_command import allow_origins
from hostlink.components.gateway.settings import ApiConfig, is_origin
from hostlink.core.config import Config
from hostlink.errors import ConfigError


def test_origins_are_added_to_those_of_the_configuration() -> None:
    config = Config().with_tables(api=ApiConfig(origins=("https://one.example",)))
    allowed = allow_origins(config, ["https://app.foxglove.dev", "file://"])
    assert allowed.table("api", ApiConfig).origins == ("https://one.example", "https://app.foxglove.dev", "file://")
    assert allow_origins(config, None) == config


@pytest.mark.parametrize(
    "text", ["https://app.foxglove.dev", "http://localhost:8080", "http://[::1]:80/", "file://", "*"]
)
def test_origins_that_browsers_send_are_accepted(text: str) -> None:
    assert is_origin(text)


@pytest.mark.parametrize(
    "text", ["", "app.foxglove.dev", "https:", "https://app.foxglove.dev/view", "http://[::1", "//a"]
)
def test_text_that_is_not_an_origin_is_refused_with_an_example(text: str) -> None:
    assert not is_origin(text)
    with pytest.raises(ConfigError, match=r"--origin.*is not an origin; .* https://app\.foxglove\.dev"):
        allow_origins(Config(), [text])

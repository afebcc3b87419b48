"""Start of the program: imports without the certificates of the system."""

import os

import pytest

from hostlink.cli.start import import_fast


@pytest.mark.parametrize("before", [None, "/etc/own.pem"])
def test_import_fast_keeps_the_certificates_of_the_environment(
    monkeypatch: pytest.MonkeyPatch, before: str | None
) -> None:
    monkeypatch.delenv("SSL_CERT_DIR", raising=False)
    monkeypatch.delenv("SSL_CERT_FILE", raising=False)
    if before is not None:
        monkeypatch.setenv("SSL_CERT_FILE", before)
    assert import_fast("aiohttp").__name__ == "aiohttp"
    assert (os.environ.get("SSL_CERT_FILE"), os.environ.get("SSL_CERT_DIR")) == (before, None)

"""`hostlink serve --check-config` and `hostlink serve --config` of one file: the same word on it."""

from pathlib import Path

import pytest

from tests.support.process import run

FREE = '[tcp]\nhost = "127.0.0.1"\nport = 0\n[api]\nport = 0\n'


@pytest.mark.parametrize(
    "text",
    [
        FREE + 'host = "0.0.0.0"\n',
        FREE + "[robots.a]\nmax_linear_m_s = -1.0\n",
        FREE + "[link]\nidle_timeout_s = -1.0\n",
        FREE + 'certificate = "none.pem"\nkey = "none.key"\n',
    ],
    ids=["open", "limit", "timeout", "certificate"],
)
async def test_serve_and_check_refuse_a_wrong_file_with_the_same_sentence(tmp_path: Path, text: str) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text(text)
    checked = await run("serve", "--check-config", str(file))
    assert checked[0] == 2
    assert checked[1] == ""
    assert checked[2].startswith("hostlink: ")
    assert await run("serve", "--config", str(file)) == checked


async def test_check_config_with_a_suspicious_setting_warns(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text(FREE + '[robots.a]\naddress = "192.168.4"\n')
    status, out, err = await run("serve", "--check-config", str(file))
    assert (status, out.splitlines()[0]) == (0, "devices on TCP 127.0.0.1:0, from any address, at most 256")
    assert err == ("warning: robots.a.address 192.168.4 is neither an IP address nor the name of a [[serial]] port\n")

"""`hostlink export` and `hostlink info` of what other programs recorded."""

import json
import shutil
from pathlib import Path

import pytest

from tests.support.foreign_recordings import COUNT, PROTOBUF, TEXT, UNKNOWN, mcap_file, ros2_sqlite
from tests.support.process import run

FORMATS = ("csv", "ros1", "ros2", "rosbag2")


def names_in(folder: Path) -> list[str]:
    return [each.name for each in folder.iterdir()]


@pytest.mark.parametrize(
    "unknown",
    [
        each if each in ("cbor", "cdr with a part missing") else pytest.param(each, marks=pytest.mark.long)
        for each in UNKNOWN
    ],
)
async def test_export_of_a_channel_that_is_unknown_fails_with_its_name_and_writes_nothing(
    tmp_path: Path, unknown: str
) -> None:
    path = mcap_file(tmp_path / "theirs.mcap", TEXT, UNKNOWN[unknown])
    await check_refusal(path, UNKNOWN[unknown][2], "csv")


@pytest.mark.parametrize(
    "format_", [each if each in ("csv", "rosbag2") else pytest.param(each, marks=pytest.mark.long) for each in FORMATS]
)
async def test_export_to_each_format_fails_at_an_unknown_channel_unless_it_is_left_out(
    tmp_path: Path, format_: str
) -> None:
    path, target = mcap_file(tmp_path / "theirs.mcap", TEXT, PROTOBUF), tmp_path / "out"
    await check_refusal(path, PROTOBUF[2], format_)
    for options in (["/te*"], ["--skip-unknown"]):
        status, out, err = await run("export", str(path), *options, "--to", format_, "-o", str(target), "--json")
        assert status == 0, err
        facts = json.loads(out)
        assert (facts["messages"], list(facts["left_out"])) == (1, ["/camera"] if "--skip-unknown" in options else [])
        target.unlink() if target.is_file() else shutil.rmtree(target)


async def check_refusal(path: Path, schema: str, format_: str) -> None:
    """Check that an export names the channel and writes nothing."""
    target = path.parent / "out"
    status, out, err = await run("export", str(path), "--to", format_, "-o", str(target))
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert f"cannot convert /camera ({schema}: " in err
    assert not target.exists()


async def test_info_says_which_topics_can_be_converted_and_why_others_cannot(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "theirs.mcap", TEXT, PROTOBUF)
    status, out, _ = await run("info", str(path))
    lines = {line.split()[0]: line for line in out.splitlines() if line.startswith("/")}
    assert (status, lines["/text"].split()[-1]) == (0, "yes")
    assert "its message encoding is 'protobuf'" in lines["/camera"]
    _, out, _ = await run("info", str(path), "--json")
    found = {topic["topic"]: topic["not_exported"] for topic in json.loads(out)["topics"]}
    assert (found["/text"], "'protobuf'" in found["/camera"]) == ("", True)


async def test_info_shows_a_folder_of_rosbag2(tmp_path: Path) -> None:
    status, out, err = await run("info", str(ros2_sqlite(tmp_path)))
    assert (status, err) == (0, "")
    assert f"{COUNT} messages" in out


@pytest.mark.parametrize(
    "name",
    ["theirs.mcap", "theirs", *(pytest.param(each, marks=pytest.mark.long) for each in ("theirs.bag", "theirs.db3"))],
)
async def test_export_of_what_is_not_a_recording_is_one_line_and_leaves_nothing(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "theirs":
        path.mkdir()
    else:
        path.write_bytes(b"")
    for format_ in FORMATS:
        status, out, err = await run("export", str(path), "--to", format_, "-o", str(tmp_path / "out"))
        assert (status, out, err.count("\n")) == (1, "", 1)
    assert names_in(tmp_path) == [name]

"""Captures and diagnoses of live and ended links in the API."""

from pathlib import Path
from typing import Any

import msgspec
from structlog.testing import capture_logs

from hostlink.cli.inspect import Inspection
from hostlink.cli.probe import probe_capture
from hostlink.core.link.capture_buffer import CAPTURE_BYTES
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.runtime.capture_file import Read, load_reads
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.waiting import expect


async def capture(host: Daemon, number: int = 1) -> bytes:
    async with host.session.get(f"{host.url}/api/links/{number}/capture") as response:
        assert (response.status, response.content_type) == (200, "application/x-ndjson")
        return await response.read()


def inspected(lines: bytes, folder: Path) -> dict[str, Any]:
    path = folder / "capture.jsonl"
    path.write_bytes(lines)
    inspection = Inspection(Catalog())
    inspection.add_all(load_reads(path))
    return inspection.view()


async def test_the_bytes_of_a_live_link_are_what_inspect_reads(tmp_path: Path) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(pose(1.0, 2.0, 0.5))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
        report = inspected(await capture(host), tmp_path)
    assert [each["name"] for each in report["topics"]] == [info.name for info in robot_topics()]
    assert report["messages"]["/robot_0/odometry"]["last"] == {"x": 1.0, "y": 2.0, "theta": 0.5}
    assert report["to_device"]["/robot_0/velocity_commands"]["last"]["linear"]["x"] == 0.0


async def test_a_link_that_ended_can_still_be_saved(tmp_path: Path) -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, robot_topics()) as device:
            await device.send(pose(1.0))
            assert await device.velocity() == (0.0, 0.0)  # closing what was not read is a reset
        await expect(lambda: not host.hub.links.all())
        ended = (await host.get("/api/links"))["ended"]
        reads = [msgspec.json.decode(line, type=Read) for line in (await capture(host)).splitlines()]
        assert inspected(await capture(host), tmp_path)["messages"]["/robot_0/odometry"]["count"] == 1
    assert (ended[0]["number"], ended[0]["end"]) == (1, "peer_closed")
    assert [read.event for read in reads if read.event] == ["open", "close"]
    assert [read.t for read in reads] == sorted(read.t for read in reads)


async def capture_without_beginning(host: Daemon, device: FakeDevice) -> bytes:
    """Return the capture of a link that was open for 702 s, so that its buffer no longer has the topics."""
    count = 2 * CAPTURE_BYTES // len(pose(0.0))
    await device.send(pose(1.0, 2.0, 0.5) * count)
    await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == count)
    (link,) = host.hub.links.all()
    link.opened_at_s -= 702.0
    return await capture(host)


async def test_a_capture_that_begins_late_begins_with_the_topics(tmp_path: Path) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        lines = await capture_without_beginning(host, device)
    path = tmp_path / "capture.jsonl"
    path.write_bytes(lines)
    reads = list(load_reads(path))
    report = inspected(lines, tmp_path)
    assert [read.event for read in reads[:2]] == ["open", "topics"]
    assert [read.t for read in reads] == sorted(read.t for read in reads)
    assert {each["name"] for each in report["topics"]} == {info.name for info in robot_topics()}
    assert report["messages"]["/robot_0/odometry"]["last"] == {"x": 1.0, "y": 2.0, "theta": 0.5}
    assert report["skipped_bytes"] == 0  # of the frame that was cut where the capture begins
    (link,) = probe_capture(path, ())["links"]
    assert (link["diagnosis"], link["topics"]) == ([], 3)


async def test_a_capture_that_begins_late_shows_what_was_refused_too(tmp_path: Path) -> None:
    wrong = topic(EndpointKind.PUBLISHER, 126, "/odd", "std_msgs/Bool")._replace(md5="0" * 32)
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), wrong]) as device:
        lines = await capture_without_beginning(host, device)
    path = tmp_path / "capture.jsonl"
    path.write_bytes(lines)
    (link,) = probe_capture(path, ())["links"]
    assert [each["code"] for each in link["diagnosis"]] == ["wrong_md5"]


async def test_a_device_that_is_silent_after_a_late_beginning_is_still_found(tmp_path: Path) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        lines = await capture_without_beginning(host, device)
    path = tmp_path / "capture.jsonl"
    path.write_bytes(lines)
    last_s = max(read.t for read in load_reads(path))
    line = {"t": last_s + 60.0, "dir": "device", "hex": "", "conn": 1, "event": "close"}
    path.write_bytes(lines + msgspec.json.encode(line) + b"\n")
    (link,) = probe_capture(path, ())["links"]
    assert [each["code"] for each in link["diagnosis"]] == ["went_silent"]


async def test_frames_before_new_topics_are_read_by_the_old_topics(tmp_path: Path) -> None:
    """A device that begins anew gives the id of its odometry to another topic."""
    again = [
        topic(EndpointKind.PUBLISHER, 125, "/bumper", "std_msgs/Bool"),
        topic(EndpointKind.SUBSCRIBER, 100, "/led", "std_msgs/Bool"),
    ]
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await capture_without_beginning(host, device)
        infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in again)
        await device.send(infos + encode(Id.TIME, bytes(8)))
        await device.frame(Id.TIME)
        await device.send(encode(125, b"\x01") + encode(Id.TIME, bytes(8)))
        await device.frame(Id.TIME)
        report = inspected(await capture(host), tmp_path)
    assert report["messages"]["/robot_0/odometry"]["count"] > 1000
    assert report["messages"]["/bumper"]["last"] == {"data": True}
    assert report["skipped_bytes"] == 0


async def test_a_topic_with_another_md5_is_diagnosed_in_api_and_log_in_the_same_words() -> None:
    wrong = topic(EndpointKind.PUBLISHER, 126, "/odd", "std_msgs/Bool")._replace(md5="0" * 32)
    with capture_logs() as lines:
        async with daemon() as host:
            for _ in range(2):  # the second time within a minute is not told again
                async with fake_device(host.tcp, [*robot_topics(), wrong]):
                    await expect(lambda: host.hub.links.all() and host.hub.diagnoses.of(host.hub.links.all()[-1]))
                    found = (await host.get("/api/links"))["links"][-1]["diagnosis"]
    diagnosis = [each for each in found if each["code"] == "wrong_md5"]  # of a busy machine there may be others
    assert diagnosis[0]["detail"].startswith("/odd: wanted std_msgs/Bool")
    reported = [line for line in lines if line["event"] == "link.diagnosed" and line["code"] == "wrong_md5"]
    assert len(diagnosis) == len(reported) == 1
    assert {key: reported[0][key] for key in ("code", "cause", "next_step")} == {
        key: diagnosis[0][key] for key in ("code", "cause", "next_step")
    }

"""Views of a micro-ROS board: its protocol, and findings by rules of its own."""

from tests.integration.test_micro_ros import CONFIG, address_of, robot_of
from tests.support.daemon import Daemon, daemon
from tests.support.waiting import expect
from tests.support.xrce_device import stock, udp_board


def codes(host: Daemon) -> set[str]:
    (link,) = host.hub.links.all()
    return {each.code for each in host.hub.diagnoses.of(link)}


async def test_protocol_and_findings_of_a_board_are_in_the_views() -> None:
    async with daemon(CONFIG) as host, udp_board(address_of(host, "udp"), stock(is_reliable=False)):
        name = await robot_of(host)
        await expect(lambda: "best_effort_too_long" in codes(host))
        (link,) = (await host.get("/api/links"))["links"]
        assert (link["robot"], link["transport"], link["protocol"]) == (name, "udp", "micro-ROS")
        (found,) = [each for each in link["diagnosis"] if each["code"] == "best_effort_too_long"]
        assert found["detail"] == "/odom/unfiltered: a message of at least 700 bytes, best effort takes 496"
        (device,) = (await host.get("/api/devices"))["devices"]
        assert device["protocol"] == "micro-ROS"
        assert not {"time_stopped", "unknown_ids", "buffer_too_small", "wrong_md5"} & codes(host)

"""A robot whose protocol hostlink does not bring: the hub drives it by what `DeviceSession` names, and by no more."""

from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.memory_transport import memory_pair
from tests.support.text_protocol import TEXT


def test_robot_of_a_foreign_protocol_is_driven_and_stops_when_the_lease_ends() -> None:
    async def test(memory: MemoryHub) -> None:
        host_end, car = memory_pair(address="10.0.0.2")
        memory.hub.spawn(memory.hub.links.serve(memory.hub.links.open(host_end, TEXT)), name="link")
        assert await car.receive() == b"HELLO?\n"
        await car.send(b"HELLO car\nPOSE 0.5 0 1.57\n")
        assert await car.receive() == b"VEL 0 0\n"
        memory.hub.join("program").drive(memory.robot("car"), PlanarVelocity(0.25))
        heard = [await car.receive()]
        while heard[-1] == b"VEL 0.25 0\n":
            heard.append(await car.receive())
        assert set(heard[:-1]) == {b"VEL 0.25 0\n"}
        assert (heard[-1], memory.now_s < 1.0) == (b"VEL 0 0\n", True)
        assert memory.robot("car").odometry.count == 1

    in_hub(test)

"""HubSource: a subscription in the hub that follows the readers of another graph."""

import asyncio

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.graphs.hub_source import HubSource
from hostlink.core.hub.message import Message
from hostlink.core.hub.participant import Participant
from hostlink.errors import HostlinkError
from tests.support.participants import TEXT, TEXT_TYPE, Scene, play, text
from tests.support.virtual_loop import inside


class Made:
    """A source of a topic, and what it did."""

    def __init__(self, scene: Scene, type_name: str = TEXT_TYPE) -> None:
        self.scene = scene
        self.joined: list[Participant] = []
        self.received: list[bytes] = []
        self.refusals: list[HostlinkError] = []
        self.source = HubSource(self._join, TEXT, self._receive, self.refusals.append, type_name=type_name)

    def _join(self) -> Participant:
        self.joined.append(self.scene.hub.join("other graph", group="other"))
        return self.joined[-1]

    def _receive(self, message: Message) -> None:
        self.received.append(message.payload)


@given(st.lists(st.booleans(), max_size=8))
@inside(play)
async def test_source_receives_while_it_is_read_and_has_one_participant_then(scene: Scene, readers: list[bool]) -> None:
    made = Made(scene)
    scene.neighbour.advertise(TEXT, TEXT_TYPE)
    for number, is_read in enumerate(readers):
        made.source.set_read(is_read)
        scene.neighbour.publish(TEXT, text(str(number)))
        assert made.source.is_read is is_read
        assert sum(not each.has_left for each in made.joined) == is_read
    assert made.received == [text(str(number)) for number, is_read in enumerate(readers) if is_read]
    made.source.set_read(False)


@inside(play)
async def test_source_that_is_refused_leaves_and_is_tried_again(scene: Scene) -> None:
    made = Made(scene, "std_msgs/Int32")
    scene.neighbour.advertise(TEXT, TEXT_TYPE)
    made.source.set_read(True)
    assert (made.source.is_read, made.joined[0].has_left, len(made.refusals)) == (False, True, 1)
    scene.neighbour.unadvertise(TEXT)
    await asyncio.sleep(0.1)
    made.source.set_read(True)
    assert (made.source.is_read, len(made.joined), len(made.refusals)) == (True, 2, 1)
    made.source.set_read(False)

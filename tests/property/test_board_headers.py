"""Generated C++ codec compared with the Python codec: every type, drawn definitions, damage, small buffers."""

import struct
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from hostlink.board.library import TypeSelection, select
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.fields import COUNT_BYTES, SCALAR, SIZES, VARIABLE, Field, Layout
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import BadPayload
from tests.support import board_codec
from tests.support.board_codec import NARROW, NOT_READ, NOT_WRITTEN, WRITTEN, Answer, Request
from tests.support.random_messages import damaged, random_message, random_package

seeds = st.integers(0, 2**32 - 1)
BATCHES = settings(deadline=None, max_examples=max(5, settings().max_examples // 10))


class Codec:
    """Compiled program, and the types that it knows."""

    def __init__(self, selection: TypeSelection, folder: Path) -> None:
        names = board_codec.write_headers(selection, folder)
        parts = [part for service in selection.services for part in (service.request, service.response)]
        self.types: list[MessageType] = [*selection.messages, *parts]
        self.numbers = board_codec.numbers_of(names)
        self._program = board_codec.compile_codec(folder)

    def run(self, requests: list[Request]) -> list[Answer]:
        return board_codec.run(self._program, requests)

    def request(self, type_: MessageType, payload: bytes, **limits: int) -> Request:
        return Request(self.numbers[type_.name], payload, **limits)


@pytest.fixture(scope="module")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Codec:
    """Return the codec of all types of the catalogue."""
    return Codec(select(Catalog(), None), tmp_path_factory.mktemp("headers"))


class Damage(Exception):
    """Payload that ends before a field does."""


class Rewritten:
    """Payload as a board writes it back: a bool is 0 or 1, and a string ends at its first zero."""

    def __init__(self, payload: bytes) -> None:
        self.left = payload
        self.bytes = b""

    def message(self, layout: Layout) -> None:
        for field in layout.fields:
            count = 1 if field.array_length == SCALAR else field.array_length
            if field.array_length == VARIABLE:
                count = self._count()
                self.bytes += struct.pack("<I", count)
                if count * layout.element_minimum_bytes(field) > len(self.left):
                    raise Damage
            for _ in range(count):
                self._one(layout, field)

    def _one(self, layout: Layout, field: Field) -> None:
        if field.type == "string":
            text = self._pop(self._count()).split(b"\0")[0]
            self.bytes += struct.pack("<I", len(text)) + text
        elif field.type == "bool":
            self.bytes += bytes([self._pop(1) != b"\0"])
        elif field.type in SIZES:
            self.bytes += self._pop(SIZES[field.type])
        else:
            self.message(layout.nested[field.type])

    def _count(self) -> int:
        return int.from_bytes(self._pop(COUNT_BYTES), "little")

    def _pop(self, size: int) -> bytes:
        if size > len(self.left):
            raise Damage
        popped, self.left = self.left[:size], self.left[size:]
        return popped


def expected(type_: MessageType, payload: bytes) -> bytes | None:
    """Return what a board writes back; None if it refuses the payload. The Python codec accepts the same payloads."""
    try:
        type_.decode(payload)
    except BadPayload:
        return None
    rewritten = Rewritten(payload)
    rewritten.message(type_.layout)
    assert rewritten.left == b""
    return rewritten.bytes


def check(codec: Codec, payloads: list[tuple[MessageType, bytes]]) -> list[bytes | None]:
    """Check that every payload is read and written back, or refused, as expected."""
    answers = codec.run([codec.request(type_, payload) for type_, payload in payloads])
    wanted = [expected(type_, payload) for type_, payload in payloads]
    for (type_, payload), answer, rewritten in zip(payloads, answers, wanted, strict=True):
        outcome = NOT_READ if rewritten is None else WRITTEN
        assert answer == Answer(outcome, rewritten or b""), f"{type_.name} {payload.hex()}"
    return wanted


@BATCHES
@given(seed=seeds)
def test_board_reads_and_writes_each_type_as_the_host_does(codec: Codec, seed: int) -> None:
    random = Random(seed)
    payloads = [(type_, type_.encode(random_message(random, type_.layout))) for type_ in codec.types]
    assert len(payloads) > 240
    assert check(codec, payloads) == [payload for _, payload in payloads]


@BATCHES
@given(seed=seeds)
def test_damaged_payload_is_refused_where_the_host_refuses_it(codec: Codec, seed: int) -> None:
    random = Random(seed)
    payloads = [(type_, damaged(random, type_.encode(random_message(random, type_.layout)))) for type_ in codec.types]
    assert None in check(codec, payloads)


@BATCHES
@given(seed=seeds)
def test_board_without_room_refuses_and_stays_within_its_buffer(codec: Codec, seed: int) -> None:
    random = Random(seed)
    requests = []
    for type_ in codec.types:
        payload = type_.encode(random_message(random, type_.layout))
        room_bytes = random.randint(0, len(payload))
        requests.append(codec.request(type_, payload, room_bytes=room_bytes))
        requests.append(codec.request(type_, payload, storage_bytes=random.randint(0, 64)))
        requests.append(codec.request(type_, damaged(random, payload), storage_bytes=random.randint(0, 512)))
    answers = codec.run(requests)
    for request, answer in zip(requests, answers, strict=True):
        if request.room_bytes < board_codec.AMPLE:
            assert answer.outcome == (WRITTEN if request.room_bytes == len(request.payload) else NOT_WRITTEN)
    assert {answer.outcome for answer in answers} == {WRITTEN, NOT_READ, NOT_WRITTEN}


def test_every_cut_of_a_long_message_is_refused(codec: Codec) -> None:
    catalog = Catalog()
    for name in ("nav_msgs/Odometry", "sensor_msgs/JointState", "diagnostic_msgs/DiagnosticArray", "tf/tfMessage"):
        type_ = catalog.message(name)
        payload = type_.encode(random_message(Random(1), type_.layout))
        cuts = codec.run([codec.request(type_, payload[:end]) for end in range(len(payload))])
        assert {answer.outcome for answer in cuts} == {NOT_READ}


DRAWN = settings(deadline=None, max_examples=max(1, settings().max_examples // 100), phases=[Phase.generate])


@DRAWN
@given(seed=seeds)
def test_drawn_definitions_compile_and_are_read_as_the_host_does(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    """Not shrunk, because each try is a compilation. The seed repeats it."""
    random, folder = Random(seed), tmp_path_factory.mktemp("drawn")
    definitions = {}
    for number in range(8):
        definitions |= random_package(random, f"drawn{number}")
    for name, text in definitions.items():
        path = folder / f"{name}.msg"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    packages = {name.partition("/")[0] for name in definitions}
    drawn = Codec(select(Catalog([folder]), packages), tmp_path_factory.mktemp("headers"))
    payloads = []
    for type_ in drawn.types * 5:
        payload = type_.encode(random_message(random, type_.layout))
        payloads += [(type_, payload), (type_, damaged(random, payload))]
    wanted = check(drawn, payloads)
    assert wanted[::2] == [payload for _, payload in payloads[::2]]


halves = st.builds(  # exactly between two floats
    lambda fraction, exponent: (2 * fraction + 1) * 2.0**exponent, st.integers(2**23, 2**24 - 1), st.integers(-140, 102)
)


@BATCHES
@given(st.lists(st.floats(width=64) | st.floats(width=32) | halves, min_size=200, max_size=200))
def test_double_of_four_bytes_is_the_nearest_float(codec: Codec, values: list[float]) -> None:
    answers = codec.run([Request(NARROW, struct.pack("<d", value)) for value in values])
    for value, answer in zip(values, answers, strict=True):
        narrow, again = struct.unpack("<fd", answer.payload)
        with np.errstate(over="ignore", under="ignore"):
            nearest = float(np.float32(value))
        if abs(nearest) < 2.0**-126 or abs(value) < 2.0**-126:  # subnormal floats
            nearest = 0.0
        assert narrow == again == nearest or (np.isnan(narrow) and np.isnan(again) and np.isnan(value))

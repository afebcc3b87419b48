"""Bounds of WebSocket frames, in all pieces in which they may be read."""

import itertools

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.components.gateway.frames import FINAL_BINARY, FINAL_TEXT, PING, ClientFrames, frame_head

MASK = b"\x81\x05\xfe\x00"
PART_TEXT, PART_MORE, PART_END = 0x01, 0x00, 0x80


def masked(payload: bytes) -> bytes:
    return bytes(byte ^ MASK[index % 4] for index, byte in enumerate(payload))


def client_frame(first: int, payload: bytes, *, code: int | None = None) -> bytes:
    """Encode a frame of a client. `code`: the form of its size; None: the shortest."""
    size = len(payload)
    code = (size if size < 126 else 126 if size < 0x10000 else 127) if code is None else code
    extra = b"" if code < 126 else size.to_bytes(2 if code == 126 else 8, "big")
    return bytes((first, 0x80 | code)) + extra + MASK + masked(payload)


@pytest.mark.parametrize(
    ("size_bytes", "head"),
    [
        (0, bytes((FINAL_TEXT, 0))),
        (125, bytes((FINAL_TEXT, 125))),
        (126, bytes((FINAL_TEXT, 126, 0, 126))),
        (0xFFFF, bytes((FINAL_TEXT, 126, 255, 255))),
        (0x10000, bytes((FINAL_TEXT, 127, 0, 0, 0, 0, 0, 1, 0, 0))),
    ],
)
def test_frame_head_has_the_shortest_length_field(size_bytes: int, head: bytes) -> None:
    assert frame_head(size_bytes, is_binary=False) == head
    assert frame_head(size_bytes, is_binary=True) == bytes((FINAL_BINARY,)) + head[1:]


@pytest.mark.parametrize("size_bytes", [1, 3, 4, 5, 125, 126, 127, 128, 4000])
def test_read_of_one_text_message_is_its_payload(size_bytes: int) -> None:
    payload = bytes(number % 251 for number in range(size_bytes))
    assert ClientFrames().text_of(client_frame(FINAL_TEXT, payload)) == payload


@pytest.mark.parametrize(
    "data",
    [
        client_frame(FINAL_TEXT, b""),
        client_frame(FINAL_TEXT, b"long", code=127),
        client_frame(FINAL_BINARY, b"binary"),
        client_frame(PING, b"ping"),
        client_frame(PART_TEXT, b"part"),
        client_frame(FINAL_TEXT | 0x40, b"compressed"),
        client_frame(FINAL_TEXT, b"cut")[:-1],
        client_frame(FINAL_TEXT, b"one") + client_frame(FINAL_TEXT, b"two"),
        bytes((FINAL_TEXT, 3)) + b"not masked",
        b"\x81",
        b"\x81\xfe\x00",
    ],
)
def test_any_other_read_has_no_text(data: bytes) -> None:
    assert ClientFrames().text_of(data) is None


FRAMES = st.one_of(
    st.builds(client_frame, st.sampled_from([FINAL_TEXT, FINAL_BINARY]), st.binary(max_size=300)),
    st.builds(client_frame, st.just(FINAL_TEXT), st.binary(max_size=40), code=st.sampled_from([126, 127])),
    st.builds(client_frame, st.just(PING), st.binary(max_size=125)),
    # A message of several frames, with a control frame between them, each of which alone may look like a whole message
    st.builds(
        lambda begin, between, end: (
            client_frame(PART_TEXT, begin) + client_frame(PING, between) + client_frame(PART_END, end)
        ),
        st.binary(max_size=9),
        st.binary(max_size=9),
        st.binary(max_size=9),
    ),
)


@example([client_frame(FINAL_BINARY, masked(client_frame(FINAL_TEXT, b"hidden")))], [6])
@given(st.lists(FRAMES, min_size=1, max_size=6), st.lists(st.integers(1, 3000), max_size=12))
def test_message_is_found_only_between_the_bounds_of_frames(frames: list[bytes], cuts: list[int]) -> None:
    data = b"".join(frames)
    bounds, end = {0}, 0
    for frame in frames:
        end += len(frame)
        bounds.add(end)
    places = sorted({0, *(cut for cut in cuts if cut < len(data)), len(data)})
    reader = ClientFrames()
    for begin, finish in itertools.pairwise(places):
        read = data[begin:finish]
        text = reader.text_of(read)
        is_alone = begin in bounds and finish in bounds and not any(begin < bound < finish for bound in bounds)
        if text is None:
            is_text = read[0] == FINAL_TEXT and read[1:2] != b"\xff"  # with a size of up to two bytes
            assert not (is_alone and is_text and len(read) > len(client_frame(FINAL_TEXT, b"", code=126)))
            reader.skip(read)
        else:
            assert is_alone
            assert client_frame(FINAL_TEXT, text, code=read[1] & 0x7F if read[1] & 0x7F >= 126 else None) == read


def test_frame_inside_a_message_of_several_frames_has_no_text() -> None:
    reader = ClientFrames()
    reader.skip(client_frame(PART_TEXT, b"part"))
    assert reader.text_of(client_frame(FINAL_TEXT, b"text")) is None
    reader.skip(client_frame(PART_MORE, b"more"))
    assert reader.text_of(client_frame(FINAL_TEXT, b"text")) is None
    reader.skip(client_frame(PING, b""))
    reader.skip(client_frame(PART_END, b"end"))
    assert reader.text_of(client_frame(FINAL_TEXT, b"text")) == b"text"

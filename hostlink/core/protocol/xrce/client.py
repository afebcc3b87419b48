"""XrceClient: one client of a connection, host side: its objects, what it wants to read, its streams and times."""

from collections import deque
from typing import Final

from hostlink.core.protocol.xrce.evidence import STORED_BITS, STORED_PAUSE_S, Evidence, sent_step
from hostlink.core.protocol.xrce.objects import ObjectTable
from hostlink.core.protocol.xrce.resume import ClientState
from hostlink.core.protocol.xrce.streams import WINDOW, BestEffortInput, ReliableInput, ReliableOutput
from hostlink.core.protocol.xrce.wire import (
    BEST_EFFORT,
    KEYLESS,
    LAST_FRAGMENT,
    LITTLE,
    NO_STREAM,
    NUMBERS,
    RELIABLE,
    SUBHEADER_BYTES,
    UNLIMITED,
    ClientInfo,
    Kind,
    Range,
    ReadRequest,
    distance,
    encode_acknack,
    encode_heartbeat,
    encode_message,
    encode_submessage,
    header_bytes,
    join_submessages,
    number_after,
)

STREAMS_MAX: Final = 4  # of each kind that a client sends on; micro-ROS has one
WAITING_MAX: Final = 64  # answers and fragments that wait for room in the client's history
FIRST_ROUND_TRIP_S: Final = 0.02  # until it is measured: a turn of a board's loop
ROUND_TRIP_MAX_S: Final = 0.5
SMOOTHING: Final = 0.2
SLOW_S: Final = 0.06  # a board that answers later reads commands of 20 Hz later and later
PROVOKED_MAX: Final = 32
AGAIN_MAX_S: Final = 0.25  # before a message is sent again
ANSWER_S: Final = 1.0  # what is not answered until then was lost
PROMPT_S: Final = 0.02  # an answer so shortly after the newest question is most likely one to it
PROMPTS: Final = 2  # so many of them in a row show that those before were lost
BEHIND_MAX_S: Final = 2.0  # between two velocities to a board that does not answer
PROBE_S: Final = 0.25
REPEAT_S: Final = 0.05  # between two zeros
REPEAT_UNTIL_S: Final = 3.0  # a board that blocks in two publishes takes a zero after 2.0 s
LISTENING_S: Final = 0.25  # a client that gets nothing sends its HEARTBEAT after 0.1 s, and again after 0.4 s
LISTENING_PAUSE_S: Final = 1.0  # from the first such time to the next; each is twice as long
REPEATS_AFTER: Final = 12  # zeros after the answer to one
REPEAT_GROWTH: Final = 1.3  # of the pause between these, so that they last for 3.7 s at least
SILENT_S: Final = 0.15  # a board that publishes was silent for longer: it hung, and has not read meanwhile
STALE_S: Final = 1.0  # a velocity may wait for so long on a board that reads
IN_FLIGHT_S: Final = 0.5  # a velocity that is not answered until then was lost, at the latest
LOST_MIN_S: Final = 0.15  # the same at the earliest, and after two of the slowest round trips
SLOWEST_DECAY: Final = 0.8  # of the slowest of the last round trips, with each one
LOOP_SHARE: Final = 0.15  # of the period of a publisher: a slower round trip shows that its loop has this period
PACE: Final = 1.15  # periods between two velocities: the places of the middleware that are taken become free
PERIOD_MAX_S: Final = 0.5  # of a publisher that tells the period of the loop
SILENCE_GAPS: Final = 1.5  # a client that publishes is silent for longer only when it waits for an acknowledgement
SILENCE_S: Final = 0.03
SILENCE_MAX_S: Final = 0.15
UNANSWERED_MAX: Final = 5  # HEARTBEATs: the client has no reliable stream from the host
TRIED_MAX: Final = 10  # of a client that has one: at a loss of 20 % each way, one in 76,000 is never answered
HEARTBEAT_S: Final = 0.05
ASK_AGAIN_S: Final = 0.05
CREATING_S: Final = 1.0  # a board waits for so long for the status of an object, and then for ever in an error loop
CREATING_SILENCE_S: Final = 0.06
HEARTBEAT_MAX_S: Final = 1.0


EMPTY: Final = encode_heartbeat(0, 0, BEST_EFFORT)  # about a stream that has none: a client ignores it
_DATA: Final = bytes((Kind.DATA,))


def is_data_for(body: bytes, object_id: int) -> bool:
    """Whether the first submessage of a body is a message for this reader."""
    return body[:1] == _DATA and body[SUBHEADER_BYTES + 2 : SUBHEADER_BYTES + 4] == object_id.to_bytes(2, "big")


class Reading:
    """Request of a client for messages to a reader, replier or requester, and what it has had of them."""

    __slots__ = ("_bytes_s", "_due_s", "_left", "_pace_s", "_until_s", "request", "stream")

    def __init__(self, wanted: ReadRequest, now_s: float) -> None:
        self.request, self.stream = wanted.request, wanted.stream
        self._left = -1 if wanted.samples == UNLIMITED else wanted.samples
        self._until_s = now_s + wanted.seconds if wanted.seconds else float("inf")
        self._bytes_s, self._pace_s = wanted.bytes_s, wanted.pace_ms / 1000
        self._due_s = now_s

    def is_over(self, now_s: float) -> bool:
        """Whether the client wants no more."""
        return self._left == 0 or now_s >= self._until_s

    def due_s(self) -> float:
        """Time from which on the next sample may be sent."""
        return self._due_s

    def note_sent(self, size_bytes: int, now_s: float) -> None:
        """Note that a sample was sent."""
        if self._left > 0:
            self._left -= 1
        pause_s = self._pace_s
        if self._bytes_s:
            pause_s = max(pause_s, size_bytes / self._bytes_s)
        self._due_s = now_s + pause_s


class Zero:
    """A zero that is repeated until the board has answered it, and REPEATS_AFTER times more.

    The answer is that of the client library, which has read the message. The stock middleware has four places for
    messages that the program has not taken, and drops the newest one when velocities fill them. A turn of the board's
    loop frees one place. So zeros follow the answer, for as many turns of a slow loop.
    """

    __slots__ = ("due_s", "left", "mark", "message", "pause_s", "until_s")

    def __init__(self, message: bytes, now_s: float) -> None:
        self.message = message
        self.mark = 0  # of the first HEARTBEAT in the same message
        self.left: int | None = None  # how often it is repeated after its answer; None: it is not answered
        self.pause_s = REPEAT_S
        self.due_s, self.until_s = now_s + REPEAT_S, now_s + REPEAT_UNTIL_S

    def note_answered(self, now_s: float, pause_s: float) -> None:
        """Note its answer. `pause_s`: a turn of the board's loop, as far as it is known."""
        if self.left is None:
            self.left, self.pause_s = REPEATS_AFTER, max(REPEAT_S, pause_s)
            self.due_s = now_s + self.pause_s

    def note_repeated(self, now_s: float) -> None:
        """Plan the next one: later when it is sent, if it was not answered."""
        if self.left is not None:
            self.left -= 1
            self.pause_s *= REPEAT_GROWTH
        self.due_s = now_s + self.pause_s

    def is_over(self, now_s: float) -> bool:
        """Whether it is repeated no more."""
        return now_s >= self.until_s if self.left is None else self.left <= 0


class XrceClient:
    """One client. `slot` numbers it among those of its connection."""

    def __init__(self, info: ClientInfo, slot: int, *, max_endpoints: int, limit_bytes: int, now_s: float) -> None:
        """`limit_bytes`: longest message of the transport."""
        self.info, self.slot = info, slot
        self.session = info.session
        self.id_key = info.key if info.session < KEYLESS else b""
        self.header_bytes = header_bytes(info.session)
        self.mtu = min(info.mtu, limit_bytes)
        self.is_announced = False  # the hub knows its endpoints; only zeros are sent before
        self.objects = ObjectTable(max_endpoints)
        self.readings: dict[int, Reading] = {}
        self.reads: dict[int, bytes] = {}  # payload of each READ_DATA that counts
        self.calls: dict[int, set[bytes]] = {}  # identities of requests that wait for a response, by requester
        self.samples: dict[int, deque[bytes]] = {}  # messages that wait, by the id of their reader
        self.waiting: deque[bytes] = deque()  # bodies for the reliable stream, in order
        self.tried_sample: tuple[int, bytes] | None = None  # reader and message, while its history is tried
        self.zeros: dict[int, Zero] = {}  # by the id of their endpoint, as the next
        self.rests: dict[int, bytes] = {}  # the zero that was the last velocity of its endpoint
        self.moved_s = float("-inf")  # last velocity other than zero that was commanded
        self.held: dict[
            int, tuple[bytes, bool]
        ] = {}  # velocities that wait for the one in flight, and if they are kept
        self.flying_until_s = float("-inf")  # a velocity is on its way to a slow or silent board
        self.velocity_s = float("-inf")  # last velocity other than zero that was sent
        self.flying_mark = 0
        self.behind_s = SLOW_S  # pause between two velocities to a board that does not answer
        self.is_confirmed = True  # after a restart of the host: it is the client that the state tells of
        self.is_over = False  # it was removed or is about to be, and nothing of it counts
        self.leaves_s = float("inf")  # time at which it is removed: it takes its last zeros before
        self.unfit: set[int] = set()  # objects whose messages are not of their type
        self.put_s = float("-inf")  # last reliable message to it
        self._stored_sent = 0
        self.created_s = self.asked_s = self.heard_s = now_s  # asked_s: of its last CREATE_CLIENT
        self.round_trip_s = FIRST_ROUND_TRIP_S
        self.least_round_trip_s = float("inf")
        self.slow_round_trip_s = 0.0  # slowest of the last ones
        self.round_trips = 0
        self.acknacks = 0
        self.has_answered = False  # a HEARTBEAT
        self.is_reset_due = False  # it was created again, or a datagram came twice: its next number tells
        self.mark = 0  # of the last thing that the client answers
        self.reset_streams(now_s)

    def reset_streams(self, now_s: float) -> None:
        """Begin all streams at their first number. The objects stay, also those that the program no longer has."""
        self.objects.begin_anew()
        self.is_resumed = False  # the streams began before the host did
        self.evidence: Evidence | None = None  # that it is the client of a stored state
        self.inputs: dict[int, ReliableInput] = {}
        self.lossy_inputs: dict[int, BestEffortInput] = {}
        self.output = ReliableOutput()
        self.numbers: dict[int, int] = {}  # next number of each best-effort stream to the client
        self.waiting.clear()
        self.provoked: deque[tuple[int, float]] = deque()  # what the client answers with an ACKNACK: mark, time
        self.told_s = float("-inf")  # last ACKNACK to the client
        self.probed_s = float("-inf")  # last HEARTBEAT to it
        self.message_s = now_s  # last reliable message from the client
        self._prompts = 0  # answers in a row that came shortly after the newest question
        self.published_s = float("-inf")  # last message of a topic that it publishes reliably
        self.gap_s = 0.0  # longest of the last pauses between two
        self.heartbeat_s = float("inf")  # next HEARTBEAT
        self.ack_s = float("inf")  # when an ACKNACK that may wait is due
        self.repair_s = float("inf")  # when a client that creates objects is asked whether something was lost
        self._creating_until_s = float("-inf")
        self._listen_s = self._listening_until_s = float("-inf")
        self._listen_pause_s = LISTENING_PAUSE_S / 2
        self.heartbeats = 0  # since the last ACKNACK
        self.is_reset_due = False
        self.heard_s = now_s
        self.periods: dict[int, tuple[float, float]] = {}  # of each publisher: last message, and period
        self.drop_velocities()

    def drop_velocities(self) -> None:
        """Forget velocities that wait and zeros that are repeated."""
        self.zeros.clear()
        self.rests.clear()
        self.held.clear()
        self.flying_until_s = float("-inf")

    def drop_velocity(self, endpoint_id: int) -> None:
        """Forget the velocity of one endpoint that waits, and its zero that is repeated."""
        self.zeros.pop(endpoint_id, None)
        self.rests.pop(endpoint_id, None)
        self.held.pop(endpoint_id, None)

    # -- what is stored -----------------------------------------------------------------------------------------------

    def stored(self) -> ClientState:
        """Return what a later session needs to go on. Numbers that are not known are those of the state before."""
        output, inputs, sent = self.output, dict[int, int](), self.output.next
        if self.evidence is not None:
            inputs |= self.evidence.stored.inputs
            sent = sent if output.is_known else self.evidence.stored.sent
        inputs |= {stream: each.next for stream, each in self.inputs.items() if each.is_known}
        return ClientState(
            self.info,
            output.first,
            sent,
            inputs,
            tuple(sorted(self.unfit)),
            tuple(each.payload for each in self.objects.by_id.values()),
            tuple(payload for id_, payload in self.reads.items() if id_ in self.objects.by_id),
        )

    def passed(self, now_s: float) -> int:
        """Return a number that changes when those of the streams are worth storing again."""
        sent = self.output.next
        is_far = abs(distance(self._stored_sent, sent)) >= sent_step(self._stored_sent)
        if is_far or now_s - self.put_s >= STORED_PAUSE_S:
            self._stored_sent = sent
        return self._stored_sent + sum(each.next >> STORED_BITS for each in self.inputs.values())

    def is_refuted_by(self, stream: int, *numbers: int) -> bool:
        """Whether the first numbers of a reliable stream show that this is not the client of the stored state."""
        evidence, reliable = self.evidence, self.inputs.get(stream)
        if evidence is None or not self.is_resumed or (reliable is not None and reliable.is_known):
            return False
        return not all(evidence.fits_input(stream, each) for each in numbers)

    def is_doubted(self, now_s: float) -> bool:
        """Whether a message that does not fit shows that this is not the client of the stored state."""
        return self.is_resumed and self.evidence is not None and now_s < self.evidence.doubted_until_s

    @property
    def settled_s(self) -> float:
        """Time at which silence is evidence enough; infinite if it is not waited for."""
        return float("inf") if self.is_confirmed or self.evidence is None else self.evidence.settled_s

    @property
    def planned_s(self) -> float:
        """Time at which something of it is due; infinite if only its silence is waited for."""
        return min(self.heartbeat_s, self.ack_s, self.repair_s, self.leaves_s, self.settled_s)

    def begin(self, now_s: float) -> None:
        """Begin a new connection. A client whose number is unknown is asked for it."""
        self.heard_s = self.created_s = now_s
        if not self.output.is_known:
            self.heartbeat_s = now_s

    def silent_at_s(self, after_s: float) -> float:
        """Time at which the client has been silent for so long, and was not asked meanwhile."""
        return max(self.heard_s, self.probed_s) + after_s if self.is_confirmed else float("inf")

    def delete(self, object_id: int) -> int:
        """Delete an object, those below it, and what belongs to them. Return the Status."""
        status = self.objects.delete(object_id)
        self.periods = {id_: each for id_, each in self.periods.items() if id_ in self.objects.by_id}
        for id_ in [*(self.readings.keys() | self.calls.keys()) - self.objects.by_id.keys()]:
            self.readings.pop(id_, None)
            self.reads.pop(id_, None)
            self.calls.pop(id_, None)
            self.samples.pop(id_, None)
        return status

    def drop_calls(self) -> None:
        """Forget the requests of the session before, and what waits for a reader: the board has begun anew."""
        self.calls.clear()
        self.samples.clear()

    def drop_samples(self, object_id: int) -> int:
        """Drop what waits for a reader, and blank what was sent and may be sent again. Return how many were dropped."""
        count = len(self.samples.pop(object_id, ()))
        waiting = len(self.waiting)
        self.waiting = deque(each for each in self.waiting if not is_data_for(each, object_id))
        return count + waiting - len(self.waiting) + self.output.blank(lambda body: is_data_for(body, object_id), EMPTY)

    # -- from the client ----------------------------------------------------------------------------------------------

    def input(self, stream: int) -> ReliableInput | None:
        """Return a reliable stream from the client; None if it has too many."""
        found = self.inputs.get(stream)
        if found is None and len(self.inputs) < STREAMS_MAX:
            found = self.inputs[stream] = ReliableInput(stream, is_resumed=self.is_resumed)
        return found

    def lossy_input(self, stream: int) -> BestEffortInput | None:
        """Return a best-effort stream from the client; None if it has too many."""
        found = self.lossy_inputs.get(stream)
        if found is None and len(self.lossy_inputs) < STREAMS_MAX:
            found = self.lossy_inputs[stream] = BestEffortInput(is_resumed=self.is_resumed)
        return found

    def acknowledge(self, told: Range, now_s: float) -> tuple[list[bytes], int]:
        """Note an ACKNACK. Return the messages to send again, and the mark of what it most likely answers."""
        self.acknacks += 1
        self.has_answered = True
        self.heartbeats = 0
        answered = self._answered(now_s)
        again = self.output.acknowledge(told, now_s, older_than_s=min(self.round_trip_s, AGAIN_MAX_S))
        self.waiting.extendleft(reversed(self.output.passed))
        self.output.passed = []
        self.plan_heartbeat(now_s)
        return [self.message(RELIABLE, body, number) for number, body in again], answered

    def _answered(self, now_s: float) -> int:
        """Take what an ACKNACK answers: the oldest that is not too old. Return its mark; 0 if there is none.

        When one was lost, the next answer counts for it: what is said to be answered is, at most too little.
        """
        self._forget_lost(now_s)
        if not self.provoked:
            return 0
        self._prompts = self._prompts + 1 if now_s - self.provoked[-1][1] <= PROMPT_S else 0
        if self._prompts >= PROMPTS:
            while len(self.provoked) > 1:
                self.provoked.popleft()
        is_alone = len(self.provoked) == 1
        mark, at_s = self.provoked.popleft()
        if is_alone:
            self._note_round_trip(now_s - at_s)
            self.behind_s = SLOW_S
        return mark

    def _forget_lost(self, now_s: float) -> None:
        lost_s = now_s - max(ANSWER_S, 2 * self.behind_s)
        while self.provoked and self.provoked[0][1] < lost_s:
            self.provoked.popleft()

    def is_probe_due(self, now_s: float) -> bool:
        """Whether a HEARTBEAT in the same message would measure the round trip."""
        self._forget_lost(now_s)
        return not self.provoked and (self.is_slow or now_s - self.probed_s >= PROBE_S)

    def _note_round_trip(self, taken_s: float) -> None:
        self.round_trips += 1
        self.least_round_trip_s = min(self.least_round_trip_s, taken_s)
        self.slow_round_trip_s = max(SLOWEST_DECAY * self.slow_round_trip_s, taken_s)
        smoothed = taken_s if self.round_trips == 1 else self.round_trip_s + SMOOTHING * (taken_s - self.round_trip_s)
        self.round_trip_s = min(smoothed, ROUND_TRIP_MAX_S)

    @property
    def is_slow(self) -> bool:
        """Whether the board reads commands more slowly than they come. It reads at several places of its loop."""
        return self.round_trips > 0 and self.slow_round_trip_s > SLOW_S

    def is_behind(self, now_s: float) -> bool:
        """Whether the board has not answered for long: its loop may hang, or read less than it is sent.

        One that publishes reliably reads in each publish. The messages of others do not tell whether they read.
        """
        self._forget_lost(now_s)
        if not self.provoked:
            return False
        asked_s = self.provoked[0][1]
        return now_s - asked_s > SLOW_S and self.published_s < asked_s

    def is_paced(self, now_s: float) -> bool:
        """Whether a velocity waits for the answer to the one before it, so that few of them wait on the board."""
        return self.is_slow or self.is_behind(now_s)

    # -- to the client ------------------------------------------------------------------------------------------------

    @property
    def has_room(self) -> bool:
        """Whether one more reliable message may be sent: there is room, and the client's session is known."""
        return self.output.has_room and not self.is_reset_due

    def request_of(self, object_id: int) -> int:
        """Return the id of the request that messages for a reader answer; 0 before it has made one."""
        reading = self.readings.get(object_id)
        return 0 if reading is None else reading.request

    def message(self, stream: int, body: bytes, number: int = 0) -> bytes:
        """Return a message to the client."""
        return encode_message(self.session, self.info.key, stream, number, body)

    def note_provoked(self, now_s: float) -> int:
        """Note that something is sent that the client answers with an ACKNACK. Return its mark."""
        self.mark += 1
        self.provoked.append((self.mark, now_s))
        if len(self.provoked) > PROVOKED_MAX:
            self.provoked.popleft()
        return self.mark

    def stamped(self, message: bytes) -> bytes:
        """Return a message of a best-effort stream with its number."""
        stream = message[1]
        number = self.numbers.get(stream, 0)
        self.numbers[stream] = number_after(number)
        return message[:2] + number.to_bytes(2, "little") + message[4:]

    def may_acknowledge(self, stream: ReliableInput) -> bool:
        """Whether the next number of a stream is surely one of the client's present session."""
        return stream.fits and not self.is_reset_due

    def repair(self, now_s: float) -> bytes:
        """Return an ACKNACK that may repair a loss and repeats no other; empty if none is due.

        The client sends again what it has when it gets a bit of the bitmap. It postpones its own HEARTBEAT with each
        message that it gets, and waits for up to a second without this.
        """
        main = self.inputs.get(RELIABLE)
        if main is None or not self.may_acknowledge(main) or now_s - self.told_s <= self.round_trip_s:
            return b""
        blocked_s = min(max(SILENCE_S, 3 * self.round_trip_s), SILENCE_MAX_S)
        is_due = now_s - self.message_s > min(SILENCE_GAPS * self.gap_s, blocked_s)
        return self.acknack(main, now_s, is_repair=True) if is_due else b""

    def note_creating(self, now_s: float) -> None:
        """Note that the client creates objects. For a while it is asked for what was lost whenever it is silent."""
        self._creating_until_s = now_s + CREATING_S
        self.repair_s = now_s + CREATING_SILENCE_S

    @property
    def has_begun(self) -> bool:
        """Whether a stream of its session has had a message. One that is only waited for has had none."""
        return bool(self.lossy_inputs or self.output.next or any(each.has_begun for each in self.inputs.values()))

    def was_creating(self, now_s: float) -> bool:
        """Whether the client has created objects lately: it was asked for more than was lost."""
        return now_s < self._creating_until_s + CREATING_S

    def note_heard(self, now_s: float) -> None:
        """Note that a message came. After a silence the board reads at once what it was sent meanwhile."""
        if now_s - self.heard_s > SILENT_S and self.moved_s > self.heard_s - STALE_S:
            self.zeros |= {each: Zero(message, now_s) for each, message in self.rests.items()}
        self.heard_s = now_s
        if self.repair_s < float("inf"):
            self.repair_s = now_s + CREATING_SILENCE_S

    def due_repair(self, now_s: float) -> bytes:
        """Return the ACKNACK that is due at `repair_s`; empty if its number does not fit. Plan the next one.

        A HEARTBEAT follows while a status is not acknowledged: the board waits for each one for a second at most.
        """
        pause_s = max(CREATING_SILENCE_S, 2 * self.round_trip_s)
        self.repair_s = now_s + pause_s if now_s < self._creating_until_s else float("inf")
        main = self.input(RELIABLE)
        if main is None or not self.may_acknowledge(main):
            return b""
        if now_s < self.flying_until_s:  # a velocity has asked: more questions would take turns of a slow loop
            return b""
        repair = self.acknack(main, now_s, is_repair=True)
        has_status = self.output.is_known and self.output.is_waiting and self.output.trial() is None
        return join_submessages(repair, self.heartbeat(now_s)) if has_status else repair

    def note_message(self, now_s: float) -> None:
        """Note that a reliable message came."""
        self.gap_s = max(now_s - self.message_s, (1 - SMOOTHING / 4) * self.gap_s)
        self.message_s = now_s

    @property
    def is_creating(self) -> bool:
        """Whether the client most likely creates more: it waits for the status of what it has created."""
        return self.output.is_waiting and self.heartbeats < UNANSWERED_MAX

    def acknack(self, stream: ReliableInput, now_s: float, *, is_repair: bool = False) -> bytes:
        """Return an ACKNACK of a stream, which fits. What is known to be missing is asked for again."""
        self.told_s = now_s
        missing = stream.missing()
        self.ack_s = float("inf")
        if missing and stream.note_asked(now_s):
            self.ack_s = now_s + max(ASK_AGAIN_S, 2 * self.round_trip_s)
        return encode_acknack(stream.next, missing or int(is_repair), stream.stream)

    def heartbeat(self, now_s: float) -> bytes:
        """Return a HEARTBEAT, which the client answers."""
        self.note_provoked(now_s)
        self.probed_s = now_s
        output = self.output
        return encode_heartbeat(output.announced, (output.next - 1) % NUMBERS, output.stream)

    def plan_heartbeat(self, now_s: float) -> None:
        """Plan the next HEARTBEAT, if something waits for an acknowledgement."""
        if not self.output.is_waiting:
            self.heartbeat_s = float("inf")
            return
        pause_s = max(HEARTBEAT_S, 2 * self.round_trip_s) * 2 ** min(self.heartbeats, 8)
        self.heartbeat_s = now_s + min(pause_s, HEARTBEAT_MAX_S)

    def due_heartbeat(self, now_s: float) -> bytes:
        """Return the message that makes the client tell what it has, and plan the next one; empty: none may be sent.

        Where its expected number is unknown, it is an earlier one, which the client drops and answers. Another client
        that expects just this one takes it, and must not expect the stored number then.
        """
        self.heartbeats += 1
        if self.heartbeats > (TRIED_MAX if self.has_answered else UNANSWERED_MAX):
            self.output.end_trial(is_kept=False, is_told=not self.has_answered)
        self.plan_heartbeat(now_s)
        if self.is_reset_due:
            return b""  # another session would count from what it tells
        if self.output.trial() is not None:
            return self.tried(now_s)
        if self.output.is_known:
            return self.message(NO_STREAM, self.heartbeat(now_s))
        self.note_provoked(now_s)
        return self.message(RELIABLE, EMPTY, (self.output.first - WINDOW) % NUMBERS)

    def tried(self, now_s: float) -> bytes:
        """Return the message that tries whether the client keeps a long one."""
        trial = self.output.trial()
        number, body = (0, b"") if trial is None else trial
        self.note_provoked(now_s)
        return self.message(RELIABLE, body, number)

    def bodies(self, submessage: bytes) -> list[bytes]:
        """Return the bodies of the messages that have a submessage: one, or its fragments."""
        room_bytes = self.mtu - self.header_bytes
        if len(submessage) <= room_bytes:
            return [submessage]
        size = room_bytes - SUBHEADER_BYTES
        parts = [submessage[at : at + size] for at in range(0, len(submessage), size)]
        flags = [LITTLE] * (len(parts) - 1) + [LITTLE | LAST_FRAGMENT]
        return [encode_submessage(Kind.FRAGMENT, part, flag) for part, flag in zip(parts, flags, strict=True)]

    def room_bytes(self, object_id: int) -> int:
        """Longest payload for a reader, replier or requester, with what is before it."""
        reading = self.readings.get(object_id)
        room_bytes = self.mtu - self.header_bytes
        if (reading is None or reading.stream >= RELIABLE) and self.output.limit > 1:
            room_bytes = self.output.limit * (room_bytes - SUBHEADER_BYTES)
        return min(room_bytes - SUBHEADER_BYTES, NUMBERS - 1)

    def is_listening(self, now_s: float) -> bool:
        """Whether the client gets no velocity now, so that it tells its number after a restart of the host.

        Its HEARTBEAT tells it, and is postponed with every message that it gets. It publishes nothing while its history
        is full of what the host before has not acknowledged.
        """
        if not self.is_resumed or self.inputs:
            return False
        if now_s >= self._listen_s and self.objects.has_reliable_writer:
            self._listen_pause_s *= 2
            self._listen_s, self._listening_until_s = now_s + self._listen_pause_s, now_s + LISTENING_S
        return now_s < self._listening_until_s

    def note_velocity(self, endpoint_id: int, now_s: float) -> None:
        """Note that a velocity other than zero is sent."""
        self.zeros.pop(endpoint_id, None)
        self.rests.pop(endpoint_id, None)
        self.moved_s = now_s

    def note_zero(self, endpoint_id: int, message: bytes, now_s: float) -> None:
        """Note that a zero is sent."""
        self.zeros[endpoint_id], self.rests[endpoint_id] = Zero(message, now_s), message

    def note_published(self, object_id: int, now_s: float) -> None:
        """Note that a publisher has sent a message. A turn of the board's loop sends one of each at most."""
        if self.objects.by_id[object_id].is_reliable:
            self.published_s = now_s
            self.behind_s = SLOW_S
        last_s, period_s = self.periods.get(object_id, (now_s, 0.0))
        taken_s = min(now_s - last_s, 2 * PERIOD_MAX_S)
        self.periods[object_id] = now_s, period_s + SMOOTHING * (taken_s - period_s) if period_s else taken_s

    @property
    def pace_s(self) -> float:
        """Time between two velocities that the board's loop can take; 0 if it is not known to be slow."""
        period_s = min((each for _, each in self.periods.values() if each), default=float("inf"))
        is_loop = period_s < PERIOD_MAX_S and self.slow_round_trip_s > LOOP_SHARE * period_s
        return PACE * period_s if is_loop else 0.0

    def free_s(self, now_s: float) -> float:
        """Time from which on a velocity may be sent, so that few of them wait on the board."""
        free_s = self.velocity_s + self.pace_s
        if self.is_paced(now_s):
            free_s = max(free_s, self.flying_until_s)
        if self.is_resumed and not self.inputs:
            free_s = max(free_s, self._listening_until_s)
        return free_s

    def note_velocity_sent(self, now_s: float) -> None:
        """Note that a velocity other than zero was sent."""
        self.velocity_s = now_s
        if self.is_behind(now_s):
            self.flying_until_s = now_s + self.behind_s
            self.behind_s = min(2 * self.behind_s, BEHIND_MAX_S)

    def note_flying(self, mark: int, now_s: float) -> None:
        """Note that a velocity with a HEARTBEAT was sent, and that the next one waits for its answer."""
        lost_s = min(max(2 * self.slow_round_trip_s, LOST_MIN_S), IN_FLIGHT_S)
        self.flying_mark, self.flying_until_s = mark, max(self.flying_until_s, now_s + lost_s)

    def note_answered(self, mark: int, now_s: float) -> None:
        """Note that the client has read what was sent with this mark, and before."""
        if mark >= self.flying_mark:  # the loop takes one velocity a turn, also if it reads more
            self.flying_until_s = min(self.flying_until_s, self.velocity_s + self.slow_round_trip_s)
        for zero in self.zeros.values():
            if 0 < zero.mark <= mark:
                zero.note_answered(now_s, self.slow_round_trip_s)

    def due_messages(self, now_s: float) -> list[bytes]:
        """Return the reliable messages that may be sent now."""
        found: list[bytes] = []
        while self.waiting and self.has_room:
            body = self.waiting.popleft()
            found.append(self.message(RELIABLE, body, self.output.put(body, now_s)))
            self.note_provoked(now_s)
        if found:
            self.put_s = now_s
            self.heartbeats = 0
            self.plan_heartbeat(now_s)
        return found

"""A key that host and device share, proven by both at the start of a connection, before the first byte of rosserial.

    host -> device   "HLK1", 16 random bytes
    device -> host   "HLK1", 16 random bytes, HMAC-SHA256(key, "device", both randoms)
    host -> device   HMAC-SHA256(key, "host", both randoms)

It proves who is there at the start: what comes later is neither encrypted nor protected.
"""

import asyncio
import hmac
import secrets
from collections.abc import Callable
from pathlib import Path

from hostlink.errors import ConfigError
from hostlink.transport.base import Transport

MAGIC = b"HLK1"
RANDOM_BYTES = 16
PROOF_BYTES = 32
HELLO = MAGIC + bytes(RANDOM_BYTES)  # by which a device begins over UDP, where nothing connects
ANSWER_BYTES = len(MAGIC) + RANDOM_BYTES + PROOF_BYTES
PROOF_TIMEOUT_S = 3.0  # two ways over a bad radio; less than a link waits for its first write
SHORTEST_KEY_BYTES = 16


def read_key(file: Path, where: str) -> bytes:
    """The key, without the white space around it; `where`: the setting that names the file.

    Raises:
        ConfigError: the file cannot be read, or the key is too short.
    """
    try:
        key = file.read_bytes().strip()
    except OSError as error:
        raise ConfigError(where, f"{file}: {error.strerror}") from error
    if len(key) < SHORTEST_KEY_BYTES:
        raise ConfigError(
            where, f"{file}: a key has at least {SHORTEST_KEY_BYTES} bytes; make one: openssl rand -hex 16"
        )
    return key


def proof(key: bytes, side: bytes, host_random: bytes, device_random: bytes) -> bytes:
    """What only an owner of the key can compute; `side` keeps one end from repeating the other's."""
    return hmac.digest(key, side + host_random + device_random, "sha256")


class KeyProof:
    """Proves the key at the start of a connection."""

    def __init__(
        self,
        transport: Transport,
        key: bytes,
        *,
        on_refused: Callable[[str], None],
        on_proven: Callable[[], None] = lambda: None,
    ) -> None:
        """`on_refused`: called with the reason, "no_key" or "wrong_key", before `authenticate` raises.

        `on_proven`: called when the device has proven the key, and so that it is where it seems to be.
        """
        self._transport = transport
        self._key = key
        self._on_refused, self._on_proven = on_refused, on_proven

    async def authenticate(self) -> None:
        """Returns when both ends have proven the key.

        Raises:
            ConnectionRefusedError: the device cannot prove it.
        """
        refusal = await self._prove()
        if refusal is not None:
            self._on_refused(refusal)
            raise ConnectionRefusedError(refusal)

    async def _prove(self) -> str | None:
        host_random = secrets.token_bytes(RANDOM_BYTES)
        answer = b""
        try:
            async with asyncio.timeout(PROOF_TIMEOUT_S):
                await self._transport.send(MAGIC + host_random)
                while len(answer) < ANSWER_BYTES and (data := await self._transport.receive()):
                    answer += data
                    while self._transport.kind == "udp" and answer.startswith(HELLO):
                        answer = answer[len(HELLO) :]  # again, before this end's random came
        except TimeoutError:
            return "no_key"
        if len(answer) != ANSWER_BYTES or not answer.startswith(MAGIC):  # a device waits for the host's proof
            return "no_key"
        device_random, claimed = answer[len(MAGIC) : -PROOF_BYTES], answer[-PROOF_BYTES:]
        if not hmac.compare_digest(claimed, proof(self._key, b"device", host_random, device_random)):
            return "wrong_key"
        self._on_proven()
        await self._transport.send(proof(self._key, b"host", host_random, device_random))
        return None

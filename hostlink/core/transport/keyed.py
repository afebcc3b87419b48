"""Pre-shared key of host and device. Both prove it at the start of a connection, before the first byte of the protocol.

    host -> device   "HLK1", 16 random bytes
    device -> host   "HLK1", 16 random bytes, HMAC-SHA256(key, "device", both randoms)
    host -> device   HMAC-SHA256(key, "host", both randoms)

The proof covers only the start of the connection: later bytes are neither encrypted nor authenticated.
"""

import asyncio
import hmac
import secrets
from collections.abc import Callable
from pathlib import Path

from hostlink.core.runtime.text_file import read_bytes
from hostlink.core.transport.base import Transport
from hostlink.core.transport.connection import ignore
from hostlink.errors import ConfigError

MAGIC = b"HLK1"
RANDOM_BYTES = 16
PROOF_BYTES = 32
HELLO = MAGIC + bytes(RANDOM_BYTES)  # first datagram of a device over UDP, which has no connection setup
ANSWER_BYTES = len(MAGIC) + RANDOM_BYTES + PROOF_BYTES
PROOF_TIMEOUT_S = 3.0  # two round trips over a bad radio; less than a link waits for its first write
SHORTEST_KEY_BYTES = 16


def read_key(file: Path, where: str) -> bytes:
    """Read the key without surrounding white space. `where` is the setting that names the file.

    Raises:
        ConfigError: the file cannot be read, or the key is too short.
    """
    try:
        key = read_bytes(file).strip()
    except OSError as error:
        raise ConfigError(where, f"{file}: {error.strerror}") from error
    if len(key) < SHORTEST_KEY_BYTES:
        raise ConfigError(
            where, f"{file}: a key has at least {SHORTEST_KEY_BYTES} bytes; make one: openssl rand -hex 16"
        )
    return key


def proof(key: bytes, side: bytes, host_random: bytes, device_random: bytes) -> bytes:
    """Compute the proof of the key. `side` prevents that one end repeats the other's proof."""
    return hmac.digest(key, side + host_random + device_random, "sha256")


async def exchange_proofs(
    transport: Transport, key: bytes, *, on_refused: Callable[[str], None], on_proven: Callable[[], None] = ignore
) -> None:
    """Prove the key to the device and check the device's proof, at the start of a connection.

    `on_refused` is called with "no_key" or "wrong_key". `on_proven` is called when the device has proven the key, which
    also verifies its address.

    Raises:
        ConnectionRefusedError: the device cannot prove the key.
    """
    refusal = await _refusal(transport, key, on_proven)
    if refusal is not None:
        on_refused(refusal)
        raise ConnectionRefusedError(refusal)


async def _refusal(transport: Transport, key: bytes, on_proven: Callable[[], None]) -> str | None:
    host_random = secrets.token_bytes(RANDOM_BYTES)
    answer = b""
    try:
        async with asyncio.timeout(PROOF_TIMEOUT_S):
            await transport.send(MAGIC + host_random)
            while len(answer) < ANSWER_BYTES and (data := await transport.receive()):
                answer += data
                while transport.kind == "udp" and answer.startswith(HELLO):
                    answer = answer[len(HELLO) :]  # a repeated hello, sent before the host's random arrived
    except TimeoutError:
        return "no_key"
    # A device sends nothing more before the host's proof.
    if len(answer) != ANSWER_BYTES or not answer.startswith(MAGIC):
        return "no_key"
    device_random, claimed = answer[len(MAGIC) : -PROOF_BYTES], answer[-PROOF_BYTES:]
    if not hmac.compare_digest(claimed, proof(key, b"device", host_random, device_random)):
        return "wrong_key"
    on_proven()
    await transport.send(proof(key, b"host", host_random, device_random))
    return None

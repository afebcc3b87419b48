"""The device's side of the key, in the standard library's own functions."""

import asyncio
import hmac

MAGIC = b"HLK1"


async def prove_key(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, key: bytes) -> bool:
    """Whether the host has proven the key too."""
    challenge = await reader.readexactly(20)
    assert challenge.startswith(MAGIC)
    randoms = challenge[4:] + bytes(range(16))
    writer.write(MAGIC + bytes(range(16)) + hmac.new(key, b"device" + randoms, "sha256").digest())
    return await reader.readexactly(32) == hmac.new(key, b"host" + randoms, "sha256").digest()

"""StopFrames: what is written to a device to stop it when its host cannot. Without imports, for the guardian."""

INTERVAL_S = 0.05


class StopFrames:  # noqa: PLW1641 - compared by value, and in no set
    """Bytes of one device, and what its protocol says about writing them. A session makes it."""

    __slots__ = ("acknowledger", "claim_bytes", "end", "interval_s", "lead", "separator", "zeros")

    def __init__(
        self,
        zeros: tuple[bytes, ...] = (),
        end: bytes = b"",
        *,
        claim_bytes: int = 0,
        lead: bytes = b"",
        separator: bytes = b"",
        interval_s: float = INTERVAL_S,
        acknowledger: str = "",
    ) -> None:
        """`zeros` stop the device, each a whole message. `end` requests it to stop sending; it may be empty.

        `claim_bytes`: the longest frame that may have been sent in part, and takes the next bytes for its rest; 0 where
        each write is a whole message. `lead` is written before the zeros that such a frame may hide.

        `separator`: bytes that may stand between two zeros of one write. Empty: each zero is a write of its own, which
        a datagram protocol reads as one message.

        `interval_s`: time between two repetitions of the zeros.

        `acknowledger`: module and argument of the class `Acknowledger`, as `package.module:argument`. It answers what
        the device sends and waits for. Empty: the device waits for nothing.
        """
        self.zeros, self.end, self.claim_bytes = zeros, end, claim_bytes
        self.lead, self.separator, self.interval_s = lead, separator, interval_s
        self.acknowledger = acknowledger

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StopFrames) and all(
            getattr(self, name) == getattr(other, name) for name in self.__slots__
        )

    def __repr__(self) -> str:
        return f"StopFrames({', '.join(f'{name}={getattr(self, name)!r}' for name in self.__slots__)})"

    def replace(self, zeros: tuple[bytes, ...], end: bytes) -> "StopFrames":
        """Return the same with other zeros and another end."""
        return StopFrames(
            zeros,
            end,
            claim_bytes=self.claim_bytes,
            lead=self.lead,
            separator=self.separator,
            interval_s=self.interval_s,
            acknowledger=self.acknowledger,
        )

    @property
    def last_writes(self) -> tuple[bytes, ...]:
        """The writes that stop a device after whole messages: one, or one for each zero."""
        return (b"".join(self.zeros),) if self.separator and self.zeros else self.zeros

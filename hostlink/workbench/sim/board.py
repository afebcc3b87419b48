"""SimulatedBoard: interface of a robot's board in real time, without its line. Pure: time is an argument."""

from abc import ABC, abstractmethod


class SimulatedBoard(ABC):
    """Board that speaks rosserial. `advance` runs it up to a time; `quiet_s` may pass between two calls."""

    name: str

    @property
    @abstractmethod
    def is_configured(self) -> bool:
        """Whether the board is connected to a host."""

    @property
    @abstractmethod
    def quiet_s(self) -> float:
        """Time in which the board sends nothing unless it receives bytes; 0 while bytes are on the line."""

    @abstractmethod
    def advance(self, now_s: float) -> bytes:
        """Run the board up to `now_s`. Return the bytes that it sent since the last call."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Pass bytes from the host to the board."""

    @abstractmethod
    def cut(self) -> None:
        """Drop the bytes on the line in both directions."""

    @abstractmethod
    def reboot(self) -> None:
        """Switch the board off and on. The world stays."""
